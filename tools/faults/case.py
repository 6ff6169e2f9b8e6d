"""One case: a row of the matrix, on one device, in one stage of the experiment, at one phase of that."""

from __future__ import annotations

import copy
import csv
import itertools
import json
import math
import os
import pickle
import random
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NoReturn
from unittest.mock import patch

import yaml
from click.testing import CliRunner

import rig.backends.serial.opening
import rig.running.experiment.stages
import rig.running.experiment.until
import rig.running.session
from faults.backends import Backend
from faults.bounds import Times
from faults.fixed_advice import fixed_advice
from faults.fork import fork
from faults.injector import FaultInjector
from faults.language import ASKED
from faults.patient import PatientRecorder
from faults.rows import RUNS_ON, Row
from faults.stages import ARMING, CYCLE, PAUSE, REST, SEARCH, START, TRACKING, Course, Stage
from rig.cli import main
from rig.config.schema import Experiment, HomeSwitch
from rig.core.faults import Fault
from rig.identification import Identification, IdentifyError, identify
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.stage import StageKind, kind_of
from rig.running.experiment import script, zero
from rig.running.preflight import check
from rig.testing.line import lines_opened_by

FIRST_CYCLE = 4  # the fault comes in the one after it: the amplitude is that of the limit cycle by then
SETTLE_S = 1.5  # after the run: the watchdog acts, the shaft stops
PAUSE_S = 0.5  # that a pause takes where nothing happens in it, and virtual time would stand still
UNJUDGED_S = 1.5  # of the end of tracking: what goes wrong then need not show any more
TOO_FAST_EDGES_S = 60e3  # half as many again as an Uno counts
WRONG_RAD = 1.2  # an encoder's zero, of before a homing that fails
_HOMING_V = 0.9
START_RAD = 0.5  # farthest from the centre that a run starts at where there is no cycle yet


@dataclass(frozen=True)
class Found:
    """The result of a case.

    off_s      from the fault until the drive is at 0 for good, or is the host's again if the run goes on
    bound_s    longest allowed ``off_s``
    beyond_rad farthest position of the shaft beyond a hard limit
    code       fault code of the run; empty: none
    status     exit status
    stage      stage of the fault
    lost       samples that the device has sent and the recording lacks
    restart    what the next run does, in words; empty if not tried
    trouble    what should not have happened; empty if all is well
    """

    row: str
    backend: str
    stage: str
    phase: float
    off_s: float
    bound_s: float
    beyond_rad: float
    code: str
    status: int
    lost: int
    restart: str = ""
    trouble: tuple[str, ...] = ()

    def in_words(self) -> str:
        """One line."""
        return (
            f"{self.row}, {self.backend}, {self.stage}, phase {self.phase:.2f}: {self.code or 'no fault'}, "
            f"exit status {self.status}, drive on for {1e3 * self.off_s:.2f} of {1e3 * self.bound_s:.2f} ms, "
            f"{self.lost} samples lost"
        )


@dataclass
class Run:
    """A finished run: how it ended, and its recording; the folder is None where there was none."""

    status: int
    output: str
    rows: list[dict[str, str]]
    events: list[dict[str, Any]]
    folder: Path | None
    identification: Identification | None = None  # of its pause

    @property
    def fault(self) -> dict[str, Any] | None:
        """The event of the fault that ended it, if one did."""
        return next((event for event in self.events if event["kind"] == "fault"), None)

    @property
    def reached(self) -> list[str]:
        """The stages that it reached."""
        return [str(event["name"]) for event in self.events if event["kind"] == "stage"]


@dataclass(frozen=True)
class Undisturbed:
    """The run without a fault.

    windows  device time at which each stage begins, and ends, s; the cycle is the one after FIRST_CYCLE
    rows     rows of its samples.csv
    identification   its result, where the run has a pause for that
    """

    windows: Mapping[str, tuple[float, float]]
    rows: list[dict[str, str]]
    identification: Identification | None


@contextmanager
def patched(
    injector: FaultInjector, backend: Backend, known: Identification | None = None
) -> Iterator[list[Identification]]:
    """Rig connects to the injector instead of a new device; draws no figures; no time depends on this machine.

    known  result of the identification in the pause: it depends only on what came before the fault
    Yields the list of identifications made.
    """
    identified: list[Identification] = []

    def identify_in_time(recordings: Any) -> Identification:
        if "serial" in backend.traits:  # a device that is watched in the pause has its time by that
            injector.watch(PAUSE_S)
        identified.append(identify(recordings) if known is None else known)
        return identified[-1]

    with ExitStack() as patches:
        patches.enter_context(_opened(injector, backend))
        if backend.runs_strokes:
            patches.enter_context(patch.object(rig.running.experiment.until, "advisers_of", fixed_advice))
        patches.enter_context(patch.object(rig.running.session, "write_report", lambda *_: None))
        patches.enter_context(patch.object(rig.running.session, "Recorder", partial(PatientRecorder, injector)))
        patches.enter_context(patch.object(rig.running.experiment.stages, "identify", identify_in_time))
        yield identified


@contextmanager
def _opened(injector: FaultInjector, backend: Backend) -> Iterator[None]:
    """Rig connects to the injector. Nobody's hand sets the zero of an encoder in passing: that takes `rig home`."""
    with (
        lines_opened_by(lambda device, e: nullcontext(backend.line(injector))),
        backend.told(injector),
        patch.object(rig.backends.serial.opening, "_by_hand", lambda e, line: None),
    ):
        yield


def home(injector: FaultInjector, backend: Backend, experiment: Experiment) -> None:
    """`rig home`, by hand: tell the device where the shaft stands."""
    with _opened(injector, backend):
        zero.by_hand(experiment, injector.device.truth().y_rad)
    injector.forget()


def _home_in_vain(injector: FaultInjector, backend: Backend, experiment: Experiment) -> None:
    """`rig home` to an end switch, where there is none: it fails. The zero of before is wrong."""
    encoder = experiment.sensor.encoder
    if encoder is None:
        raise ValueError("no encoder")
    end = HomeSwitch(end="high", at_rad=experiment.limits.soft_rad[1], u_V=_HOMING_V)
    driven = experiment.model_copy(
        update={"sensor": experiment.sensor.model_copy(update={"encoder": encoder.model_copy(update={"home": end})})}
    )
    with _opened(injector, backend), tempfile.TemporaryDirectory() as runs:
        zero.by_hand(experiment, injector.device.truth().y_rad - WRONG_RAD)
        try:
            zero.by_switch(driven, Path(runs))
        except Fault as fault:
            if fault.code not in ("NO_MOTION", "NOT_HOME"):
                raise
        else:
            raise RuntimeError("a homing without a switch ended well")
    injector.device.place(START_RAD)
    injector.watch(0.1)
    injector.forget()


def merged(config: dict[str, Any], emulated: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The config with changes of its section ``emulated``."""
    new = copy.deepcopy(config)
    for name, changes in emulated.items():
        new["emulated"][name] = new["emulated"].get(name, {}) | changes
    return new


def new_injector(backend: Backend, config: dict[str, Any], folder: Path, seed: int) -> tuple[FaultInjector, Experiment]:
    """The device, powered on; its config is written to ``folder``."""
    path = folder / "fault.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    experiment = check(path)[0]
    limits, timeout_s = experiment.limits, experiment.daq.timeout_s
    device, language = backend.device(experiment), backend.language(experiment)
    injector = FaultInjector(device, language, limits.hard_rad, timeout_s, folder, seed)
    injector.hangs = backend.hangs
    if backend.has_encoder:
        injector.too_fast_rad_s = TOO_FAST_EDGES_S * abs(experiment.sensor.curve.lsb_rad)
        home(injector, backend, experiment)
        injector.home_in_vain = partial(_home_in_vain, injector, backend, experiment)
    return injector, experiment


def run(
    injector: FaultInjector, backend: Backend, course: Course = "relay", known: Identification | None = None
) -> Run:
    """`rig relay`, or `rig run`, to its end; ``known`` as of ``patched``."""
    folder = injector.folder
    command = "run" if course == "run" else "relay"
    with patched(injector, backend, known) as identified:
        result = CliRunner().invoke(main, [command, str(folder / "fault.yaml"), "--out", str(folder / "runs")])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return replace(finished(folder, result.exit_code, result.output), identification=next(iter(identified), None))


def finished(folder: Path, status: int, output: str) -> Run:
    """What there is of the run below ``folder / "runs"``."""
    rows, events, run_folder = [], [], None
    for run_folder in (folder / "runs").glob("*/"):
        with (run_folder / "samples.csv").open(encoding="ascii") as file:
            rows = list(csv.DictReader(file))
        events = [json.loads(line) for line in (run_folder / "events.jsonl").read_text(encoding="ascii").splitlines()]
    return Run(status, output, rows, events, run_folder)


@lru_cache
def undisturbed(backend: Backend, course: Course) -> Undisturbed:
    """The run in which nothing goes wrong. Raises RuntimeError where something does."""
    with tempfile.TemporaryDirectory() as name:
        injector, _ = new_injector(backend, backend.config(course), Path(name), 1)
        found = run(injector, backend, course)
        if found.status or missing(injector, found):
            raise RuntimeError(f"{backend.key}: the run fails where nothing goes wrong: {found.output}")
        if len(injector.readings) < len(found.rows):
            raise RuntimeError(
                f"{backend.key}: {len(found.rows)} rows, and only {len(injector.readings)} seen on the wire"
            )
        if course == "run" and not any(kind_of(name) is StageKind.TRACK for name in found.reached):
            raise RuntimeError(f"{backend.key}: nothing was tracked: {found.output}")
        return Undisturbed(_windows(injector, found, course), found.rows, found.identification)


def _windows(injector: FaultInjector, run: Run, course: Course) -> dict[str, tuple[float, float]]:
    """When which stage began and ended, in the injector's time, s."""
    moments, names = injector.moments, [name for name, _ in injector.moments]
    if course == "search":
        at = names.index("search")
        return {SEARCH.key: (moments[at][1], moments[at + 1][1])}
    if course == "relay":
        asked_s = dict(injector.read_at)
        row = run.rows[0]
        offset_s = asked_s[int(row["seq"])] - float(row["t_s"])
        ends = [t_s + offset_s for t_s in _ends_of_cycles(run)]
        return {START.key: (0.0, 0.0), CYCLE.key: (ends[FIRST_CYCLE - 1], ends[FIRST_CYCLE])}
    tracking = next(k for k, name in enumerate(names) if kind_of(name) is StageKind.TRACK)
    armed = _last("to arm", names[:tracking])
    arming, stopped = _last("to stop", names[:armed]), _last("stop", names[:armed])
    rest_s = max(t_s for name, t_s in moments[:stopped] if name == "rest")
    first_s = next(t_s for _, t_s in injector.read_at if t_s > moments[armed][1])
    return {
        REST.key: (rest_s, moments[stopped][1]),
        PAUSE.key: (moments[stopped][1], moments[arming][1]),
        ARMING.key: (moments[arming][1], first_s),
        TRACKING.key: (moments[tracking][1], moments[tracking + 1][1] - UNJUDGED_S),
    }


def _ends_of_cycles(run: Run) -> list[float]:
    """When a cycle of the relay test ends, or the drive of a stroke test turns to positive; s, in the run's time."""
    rows = [row for row in run.rows if kind_of(row["stage"]) is StageKind.STROKES]
    if not rows:
        return [float(e["t_s"]) for e in run.events if e["kind"] == "cycle"]
    return [
        float(now["t_s"]) for before, now in itertools.pairwise(rows) if float(before["u_V"]) <= 0.0 < float(now["u_V"])
    ]


def _last(name: str, names: list[str]) -> int:
    """Where it comes for the last time."""
    return len(names) - 1 - names[::-1].index(name)


@lru_cache
def times(backend: Backend, course: Course) -> Times:
    """What bounds are made of on a device, in an experiment."""
    begin_s, end_s = undisturbed(backend, "relay").windows[CYCLE.key]
    with tempfile.TemporaryDirectory() as name:
        return backend.times(new_injector(backend, backend.config(course), Path(name), 1)[1], end_s - begin_s)


def measure(row: Row, backend: Backend, phase: float, stage: Stage | None = None, restarts: bool = False) -> Found:
    """Run it. ``phase`` 0 to 1 of the stage, or of where an early one starts; restarts: try the next run, too.

    stage  default: the one that the row is written for, START where it is early, else CYCLE
    """
    stage = stage or (START if row.early else CYCLE)
    undisturbed(backend, "relay"), undisturbed(backend, stage.course)
    row = row.on(stage.traits(backend.traits))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if not row.alone:
            return _measure(row, backend, stage, phase, restarts, folder, None)
        return _in_own_process(lambda done: _measure(row, backend, stage, phase, restarts, folder, done))


Done = Callable[[Found], NoReturn]


def _in_own_process(work: Callable[[Done], Found]) -> Found:
    """What ``work`` returns in a copy of this process, or hands to the function that it is given, there or in a copy.

    Where the copy is killed, that is the exit status.
    """
    source, sink = os.pipe()

    def done(found: object) -> NoReturn:
        with os.fdopen(sink, "wb") as pipe:
            pickle.dump(found, pipe)
        os._exit(0)

    child = fork()
    if child == 0:
        os.close(source)
        try:
            done(work(done))
        except BaseException as error:  # noqa: BLE001 - it is raised again, in the process that waits for it
            done(error)
    os.close(sink)
    with os.fdopen(source, "rb") as pipe:
        found: Found | BaseException = pickle.load(pipe)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if isinstance(found, BaseException):
        raise found
    return replace(found, status=status) if status < 0 else found


def _measure(
    row: Row, backend: Backend, stage: Stage, phase: float, restarts: bool, folder: Path, done: Done | None
) -> Found:
    plain = undisturbed(backend, stage.course)
    where = "" if stage in (START, CYCLE) else f" {stage.key}"
    rng = random.Random(f"{row.name} {backend.key}{where} {phase}")
    config = merged(backend.config(stage.course), row.emulated)
    if row.early:
        config["emulated"]["motor"]["start_rad"] = START_RAD * (2.0 * phase - 1.0)
    injector, experiment = new_injector(backend, config, folder, rng.randrange(2**32))
    injector.spare_s, injector.too_late_s = backend.spare_s(experiment), backend.too_late_s(experiment)
    if row.early:
        row.act(injector)
        injector.schedule(0.0, lambda _: None)
    else:
        begin_s, end_s = plain.windows[stage.key]
        # within the loop's tick, too, it comes at any time
        jitter_s = rng.uniform(0.0, experiment.period_s) if stage is not ARMING else 0.0
        injector.schedule(begin_s + phase * (end_s - begin_s) + jitter_s, row.act)
    if row.prepare is not None:
        row.prepare(folder)

    def conclude(run: Run) -> Found:
        injector.watch(SETTLE_S)
        found = judged(row, backend, stage, phase, injector, times(backend, stage.course), run)
        return _restarted(found, row, backend, injector, experiment) if restarts else found

    if done is not None:

        def after_death() -> None:
            _await_last_words(folder)
            done(conclude(finished(folder, -signal.SIGKILL, "")))

        injector.after_death = after_death
    return conclude(run(injector, backend, stage.course, plain.identification))


def _await_last_words(folder: Path) -> None:
    """Until the recorder has written what a killed host has left."""
    deadline_s = time.monotonic() + 20.0
    events = next((folder / "runs").iterdir()) / "events.jsonl"
    while "loop_died" not in events.read_text(encoding="ascii"):
        if time.monotonic() > deadline_s:
            raise RuntimeError("the recorder does not say that the loop died")
        time.sleep(0.005)


def judged(
    row: Row, backend: Backend, stage: Stage, phase: float, injector: FaultInjector, times: Times, run: Run
) -> Found:
    """What was measured, and what of it should not be."""
    truth = injector.device.truth()
    code = "" if run.fault is None else str(run.fault["code"])
    runs_on = code == "" and run.status in (0, 1)
    if runs_on:
        off_s = max(injector.stale_s, injector.astray_s)
    else:
        began_s = max(injector.driven_s, injector.fault_s) if stage.at_zero else injector.fault_s
        off_s = math.inf if truth.pin_V != 0.0 else max(truth.pin_changed_s - began_s, 0.0)
        off_s = 0.0 if math.isnan(began_s) else off_s  # it never drove
    found = Found(
        row.name,
        backend.key,
        stage.key,
        phase,
        off_s,
        row.bound.seconds(times),
        injector.beyond_rad,
        code,
        run.status,
        len(missing(injector, run)),
    )
    return replace(found, trouble=tuple(_trouble(found, row, backend, stage, run)))


def _trouble(found: Found, row: Row, backend: Backend, stage: Stage, run: Run) -> Iterator[str]:
    shown = found.code or "no fault"
    if not found.off_s <= found.bound_s:
        yield f"drive on for {1e3 * found.off_s:.2f} ms, bound {1e3 * found.bound_s:.2f} ms"
    if found.code not in row.codes:
        yield f"{shown} ({'' if run.fault is None else run.fault['detail']})"
    if found.status not in (row.status or (int(found.code != ""),)):
        yield f"exit status {found.status} with {shown}: {run.output[-300:]}"
    if row.early and row.codes != (RUNS_ON,) and any(kind_of(name) is StageKind.RELAY for name in run.reached):
        yield "a relay ran"
    if row.same and _decided(run.rows) != _decided(undisturbed(backend, stage.course).rows):
        yield "the recording differs"
    if found.lost > row.may_lose:
        yield f"{found.lost} samples lost"
    if "Traceback" in run.output or any(e["kind"] == "traceback" for e in run.events):
        yield "a traceback"
    if found.status in (0, 1) and row.leaves_result and not (run.folder and (run.folder / "result.json").exists()):
        yield "no result.json"
    if stage.course == "run":
        yield from _unidentified(run)


def _unidentified(run: Run) -> Iterator[str]:
    """Why a recording with a whole relay test cannot be identified."""
    if run.folder is None:
        yield "no recording"
        return
    try:
        estimate = identify([read_run(run.folder)]).estimates["sampled-data"]
    except (IdentifyError, RecordingError) as error:
        yield f"the recording cannot be identified: {error.cause}"
    else:
        if estimate.verdict == "refused":
            yield f"the recording is refused: {'; '.join(estimate.reasons)}"


def _decided(rows: list[dict[str, str]]) -> list[tuple[str, ...]]:
    """The part of a recording that does not depend on the speed of this machine."""
    return [tuple(row[name] for name in ("tick", "seq", "t_s", "t_u_s", "y_counts", "u_V", "stage")) for row in rows]


def recorded_keys(rows: list[dict[str, str]]) -> set[tuple[int, int]]:
    """Key of each recorded sample, and its row in a block of the relay in the device, else ASKED.

    The row at rest after the relay in the device was asked for, too, though the loop had no tick for it.
    """
    in_block: Counter[int] = Counter()
    keys = set()
    for row in rows:
        key, unasked = int(row["seq"]), row["io_us"] == "" and kind_of(row["stage"]) is not StageKind.REST
        keys.add((key, in_block[key] if unasked else ASKED))
        in_block[key] += unasked
    return keys


def missing(injector: FaultInjector, run: Run) -> list[int]:
    """Keys of samples that the device has sent in time, and that the recording lacks.

    The sample that ended the run counts as recorded if the fault's event has its counts, or its reply; the last block
    of a law in the device may come after it. Not counted: the last exchange before a stop without a fault, before a
    relay in the device, or before the loop waits for its recorder. It only asks for the effect of the last drive.
    """
    recorded = recorded_keys(run.rows)
    detail = "" if run.fault is None else str(run.fault["detail"])
    lost = []
    last_asked = next((reading for reading in reversed(injector.readings) if reading.row == ASKED), None)
    for reading in injector.readings:
        in_detail = f"{reading.counts} counts" in detail or reading.reply.hex(" ") in detail
        only_asks = reading.row == ASKED and (
            reading.key in injector.handing_over
            or reading.key in injector.closed
            or (reading.key in injector.closing and (run.fault is None or _waited_for_recorder(run)))
        )
        if (
            (reading.key, reading.row) not in recorded
            and not only_asks
            and not (in_detail and (reading is injector.readings[-1] or reading is last_asked))
        ):
            lost.append(reading.key)
    return lost


def _waited_for_recorder(run: Run) -> bool:
    """Whether the fault came between two stages, from the recorder: each tick of the loop has its row."""
    if run.fault is None or run.fault["code"] != "RECORDER_DEAD" or run.folder is None:
        return False
    result = json.loads((run.folder / "result.json").read_text(encoding="utf-8"))
    return bool(result["loop"]["ticks"] == len(run.rows))


def _restarted(found: Found, row: Row, backend: Backend, injector: FaultInjector, experiment: Experiment) -> Found:
    words, trouble = [], list(found.trouble)
    if row.lasting:
        code = restart(injector, backend, experiment)
        words.append(f"refused: {code}" if code else "moves")
        if code not in row.refused:
            trouble.append(f"the next run, not mended: {code or 'moves'}")
        injector = _mended(injector, row, backend)
    injector.cure()
    if "DEVICE_NO_ZERO" in row.refused:
        home(injector, backend, experiment)
    code = restart(injector, backend, experiment)
    words.append(("mended: " if row.lasting else "") + (f"refused: {code}" if code else "moves"))
    if code:
        trouble.append(f"the next run, mended: {code}")
    return replace(found, restart="; ".join(words), trouble=tuple(trouble))


def _mended(injector: FaultInjector, row: Row, backend: Backend) -> FaultInjector:
    if row.emulated:
        return new_injector(backend, backend.config(), injector.folder, 1)[0]  # another motor
    injector.bring_home()
    (injector.folder / "runs").chmod(0o755)
    (injector.folder / "runs" / "filler").unlink(missing_ok=True)
    return injector


def restart(injector: FaultInjector, backend: Backend, experiment: Experiment) -> str:
    """The next run, as far as the breakaway check: the code that ends it, or nothing where the shaft moves."""
    injector.forget()
    with patched(injector, backend):
        try:
            outcome = script.run_breakaway(experiment, injector.folder / "runs")
        except Fault as fault:
            return fault.code
        except RecordingError as error:
            return error.cause
    if outcome.fault is None and math.isnan(injector.first_drive_s):
        return "it says that it moves, and has not driven"
    return "" if outcome.fault is None else outcome.fault.code
