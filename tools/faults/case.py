"""One case: a row of the matrix, on one device, at one phase of the limit cycle."""

from __future__ import annotations

import copy
import csv
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
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NoReturn
from unittest.mock import patch

import yaml
from click.testing import CliRunner

import rig.bench
import rig.session
from faults.backends import Backend
from faults.bounds import Times
from faults.fork import fork
from faults.language import ASKED
from faults.rows import Row
from faults.stand import Stand
from rig import experiment as script
from rig.cli import main
from rig.config import check
from rig.config.schema import Experiment
from rig.faults import Fault
from rig.recording.errors import RecordingError

FIRST_CYCLE = 4  # the fault comes in the one after it: the amplitude is that of the limit cycle by then
SETTLE_S = 1.5  # after the run: the watchdog acts, the shaft stops
START_RAD = 0.5  # farthest from the centre that a run starts at where there is no cycle yet


@dataclass(frozen=True)
class Found:
    """What came of a case.

    off_s      from the fault until the drive was at 0 for good, or was the host's again where the run goes on
    bound_s    that it must be within
    beyond_rad farthest of the shaft beyond a hard limit
    code       of the fault that the run shows; empty: none
    status     exit status
    stage      that the run was in when it ended
    lost       samples that the device has told of and the record has not
    restart    what the next run does, in words; empty where it was not tried
    trouble    what should not be; empty where all is well
    """

    row: str
    backend: str
    phase: float
    off_s: float
    bound_s: float
    beyond_rad: float
    code: str
    status: int
    stage: str
    lost: int
    restart: str = ""
    trouble: tuple[str, ...] = ()


@dataclass
class Run:
    """A finished run: how it ended, and its record."""

    status: int
    output: str
    rows: list[dict[str, str]]
    events: list[dict[str, Any]]

    @property
    def fault(self) -> dict[str, Any] | None:
        """The event of the fault that ended it, if one did."""
        return next((event for event in self.events if event["kind"] == "fault"), None)

    @property
    def stages(self) -> list[str]:
        """That it came to."""
        return [str(event["name"]) for event in self.events if event["kind"] == "stage"]


@dataclass(frozen=True)
class Undisturbed:
    """The run in which nothing goes wrong.

    cycle_s  device time at which the cycle after FIRST_CYCLE begins; period_s: its length
    times    that bounds are made of
    rows     of its record
    """

    cycle_s: float
    period_s: float
    times: Times
    rows: list[dict[str, str]]


@contextmanager
def patched(stand: Stand, backend: Backend) -> Iterator[None]:
    """Rig connects to the stand instead of a new device; no figures are drawn."""
    with ExitStack() as patches:
        for name, place in backend.places(stand).items():
            patches.enter_context(patch.object(rig.bench, name, place))
        patches.enter_context(patch.object(rig.session, "write_report", lambda *_: None))
        yield


def merged(config: dict[str, Any], emulated: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The config with changes of its section ``emulated``."""
    new = copy.deepcopy(config)
    for name, changes in emulated.items():
        new["emulated"][name] = new["emulated"].get(name, {}) | changes
    return new


def new_stand(backend: Backend, config: dict[str, Any], folder: Path, seed: int) -> tuple[Stand, Experiment]:
    """The device, powered on; its config is written to ``folder``."""
    path = folder / "fault.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    experiment = check(path)[0]
    limits, timeout_s = experiment.limits, experiment.daq.timeout_s
    device, language = backend.device(experiment), backend.language(experiment)
    return Stand(device, language, limits.hard_rad, timeout_s, folder, seed), experiment


def relay_run(stand: Stand, backend: Backend) -> Run:
    """`rig relay`, to its end."""
    folder = stand.folder
    with patched(stand, backend):
        result = CliRunner().invoke(main, ["relay", str(folder / "fault.yaml"), "--out", str(folder / "runs")])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return finished(folder, result.exit_code, result.output)


def finished(folder: Path, status: int, output: str) -> Run:
    """What there is of the run below ``folder / "runs"``."""
    rows, events = [], []
    for run_folder in (folder / "runs").glob("*/"):
        with (run_folder / "samples.csv").open(encoding="ascii") as file:
            rows = list(csv.DictReader(file))
        events = [json.loads(line) for line in (run_folder / "events.jsonl").read_text(encoding="ascii").splitlines()]
    return Run(status, output, rows, events)


@lru_cache
def undisturbed(backend: Backend) -> Undisturbed:
    """The run in which nothing goes wrong. Raises RuntimeError where something does."""
    with tempfile.TemporaryDirectory() as name:
        stand, experiment = new_stand(backend, backend.config(), Path(name), 1)
        run = relay_run(stand, backend)
        if run.status or missing(stand, run):
            raise RuntimeError(f"{backend.key}: the run fails where nothing goes wrong: {run.output}")
        if len(stand.readings) < len(run.rows):
            raise RuntimeError(f"{backend.key}: {len(run.rows)} rows, and only {len(stand.readings)} seen on the wire")
        asked_s = dict(stand.read_at)
        row = run.rows[0]
        offset_s = asked_s[int(row["seq"])] - float(row["t_s"])
        ends = [float(e["t_s"]) for e in run.events if e["kind"] == "cycle"]
        period_s = ends[FIRST_CYCLE] - ends[FIRST_CYCLE - 1]
        times = backend.times(experiment, period_s)
        return Undisturbed(ends[FIRST_CYCLE - 1] + offset_s, period_s, times, run.rows)


def measure(row: Row, backend: Backend, phase: float, restarts: bool = False) -> Found:
    """Run it. ``phase`` 0 to 1 of the limit cycle, or of where an early one starts; restarts: try the next run, too."""
    undisturbed(backend)
    row = row.on(backend.traits)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if not row.alone:
            return _measure(row, backend, phase, restarts, folder, None)
        return _in_own_process(lambda done: _measure(row, backend, phase, restarts, folder, done))


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


def _measure(row: Row, backend: Backend, phase: float, restarts: bool, folder: Path, done: Done | None) -> Found:
    plain = undisturbed(backend)
    rng = random.Random(f"{row.name} {backend.key} {phase}")
    config = merged(backend.config(), row.emulated)
    if row.early:
        config["emulated"]["motor"]["start_rad"] = START_RAD * (2.0 * phase - 1.0)
    stand, experiment = new_stand(backend, config, folder, rng.randrange(2**32))
    stand.spare_s = backend.spare_s(experiment)
    if row.early:
        row.act(stand)
        stand.schedule(0.0, lambda _: None)
    else:
        # within the loop's tick, too, it comes at any time
        stand.schedule(plain.cycle_s + phase * plain.period_s + rng.uniform(0.0, experiment.period_s), row.act)
    if row.prepare is not None:
        row.prepare(folder)

    def conclude(run: Run) -> Found:
        stand.watch(SETTLE_S)
        found = judged(row, backend, phase, stand, plain.times, run)
        return _restarted(found, row, backend, stand, experiment) if restarts else found

    if done is not None:

        def after_death() -> None:
            _await_last_words(folder)
            done(conclude(finished(folder, -signal.SIGKILL, "")))

        stand.after_death = after_death
    return conclude(relay_run(stand, backend))


def _await_last_words(folder: Path) -> None:
    """Until the recorder has written what a killed host has left."""
    deadline_s = time.monotonic() + 20.0
    events = next((folder / "runs").iterdir()) / "events.jsonl"
    while "loop_died" not in events.read_text(encoding="ascii"):
        if time.monotonic() > deadline_s:
            raise RuntimeError("the recorder does not say that the loop died")
        time.sleep(0.005)


def judged(row: Row, backend: Backend, phase: float, stand: Stand, times: Times, run: Run) -> Found:
    """What was measured, and what of it should not be."""
    truth = stand.device.truth()
    code = "" if run.fault is None else str(run.fault["code"])
    runs_on = code == "" and run.status in (0, 1)
    if runs_on:
        off_s = max(stand.stale_s, stand.astray_s)
    else:
        began_s = stand.first_drive_s if row.early else stand.fault_s
        off_s = math.inf if truth.pin_V != 0.0 else max(truth.pin_changed_s - began_s, 0.0)
        off_s = 0.0 if math.isnan(began_s) else off_s  # it never drove
    found = Found(
        row.name,
        backend.key,
        phase,
        off_s,
        row.bound.seconds(times),
        stand.beyond_rad,
        code,
        run.status,
        run.stages[-1] if run.stages else "",
        len(missing(stand, run)),
    )
    return replace(found, trouble=tuple(_trouble(found, row, backend, run)))


def _trouble(found: Found, row: Row, backend: Backend, run: Run) -> Iterator[str]:
    shown = found.code or "no fault"
    if not found.off_s <= found.bound_s:
        yield f"drive on for {1e3 * found.off_s:.2f} ms, bound {1e3 * found.bound_s:.2f} ms"
    if found.code not in row.codes:
        yield f"{shown} ({'' if run.fault is None else run.fault['detail']})"
    if found.status not in (row.status or (int(found.code != ""),)):
        yield f"exit status {found.status} with {shown}: {run.output[-300:]}"
    if row.early and any(stage.startswith("relay") for stage in run.stages):
        yield "a relay ran"
    if row.same and _decided(run.rows) != _decided(undisturbed(backend).rows):
        yield "the record is another"
    if found.lost > row.may_lose:
        yield f"{found.lost} samples lost"
    if "Traceback" in run.output or any(e["kind"] == "traceback" for e in run.events):
        yield "a traceback"


def _decided(rows: list[dict[str, str]]) -> list[tuple[str, ...]]:
    """Of a record, what does not depend on how fast this machine is."""
    return [tuple(row[name] for name in ("tick", "seq", "t_s", "t_u_s", "y_counts", "u_V", "stage")) for row in rows]


def recorded_keys(rows: list[dict[str, str]]) -> set[tuple[int, int]]:
    """Key of each sample in a record, and its row in a block of the relay in the device, else ASKED."""
    in_block: Counter[int] = Counter()
    keys = set()
    for row in rows:
        key, unasked = int(row["seq"]), row["io_us"] == ""
        keys.add((key, in_block[key] if unasked else ASKED))
        in_block[key] += unasked
    return keys


def missing(stand: Stand, run: Run) -> list[int]:
    """Keys of samples that the device has told of, in time, and that the record has not.

    The one that ended the run is in the record, too, where the fault's event has its counts, or its reply. The last
    exchange before a stop without a fault is none: it only asks what came of the last drive; so does that before a
    relay in the device.
    """
    recorded = recorded_keys(run.rows)
    detail = "" if run.fault is None else str(run.fault["detail"])
    lost = []
    for reading in stand.readings:
        in_detail = f"{reading.counts} counts" in detail or reading.reply.hex(" ") in detail
        only_asks = reading.row == ASKED and (
            reading.key in stand.handing_over or (reading.key in stand.closing and run.fault is None)
        )
        if (
            (reading.key, reading.row) not in recorded
            and not only_asks
            and not (in_detail and reading is stand.readings[-1])
        ):
            lost.append(reading.key)
    return lost


def _restarted(found: Found, row: Row, backend: Backend, stand: Stand, experiment: Experiment) -> Found:
    words, trouble = [], list(found.trouble)
    if row.lasting:
        code = restart(stand, backend, experiment)
        words.append(f"refused: {code}" if code else "moves")
        if code not in row.refused:
            trouble.append(f"the next run, not mended: {code or 'moves'}")
        stand = _mended(stand, row, backend)
    stand.cure()
    code = restart(stand, backend, experiment)
    words.append(("mended: " if row.lasting else "") + (f"refused: {code}" if code else "moves"))
    if code:
        trouble.append(f"the next run, mended: {code}")
    return replace(found, restart="; ".join(words), trouble=tuple(trouble))


def _mended(stand: Stand, row: Row, backend: Backend) -> Stand:
    if row.emulated:
        return new_stand(backend, backend.config(), stand.folder, 1)[0]  # another motor
    stand.bring_home()
    (stand.folder / "runs").chmod(0o755)
    (stand.folder / "runs" / "filler").unlink(missing_ok=True)
    return stand


def restart(stand: Stand, backend: Backend, experiment: Experiment) -> str:
    """The next run, as far as the breakaway check: the code that ends it, or nothing where the shaft moves."""
    stand.forget()
    with patched(stand, backend):
        try:
            outcome = script.run_breakaway(experiment, stand.folder / "runs")
        except Fault as fault:
            return fault.code
        except RecordingError as error:
            return error.cause
    if outcome.fault is None and math.isnan(stand.first_drive_s):
        return "it says that it moves, and has not driven"
    return "" if outcome.fault is None else outcome.fault.code
