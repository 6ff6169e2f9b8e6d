"""Replay: the recorded samples of a run go through laws and guard again. Each drive must be the same, tick for tick.

A replay runs the same code as the run: the experiment's stages, the loop, the laws, the guard. Only the bench behind
them is the recording (``rig.control.loop.recorded``). The run folder also holds what the laws cannot derive from the
samples: the config; in meta.json the script and the drive's units; as events the models that tracked.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar

from rig import config
from rig.backends.driver import DeviceInfo
from rig.backends.registry import Bench, backend_of
from rig.config.schema import Experiment, Method
from rig.control.guard import Guard
from rig.control.law import OwnLaw, Timed, named_law
from rig.control.loop.recorded import RecordedClock, RecordedDriver, ReplayLoop, RowComparison
from rig.control.loop.replayed_rows import OF_GUARD, Difference, Diverged, RecordEnds, ReplayedRows
from rig.control.loop.stop_request import StopRequest
from rig.control.strokes import Stroke
from rig.control.sweep_plan import SweepPlan
from rig.control.sweeps import CrudeMotor, SweepLoop, Sweeps
from rig.core.faults import FAULTS, Fault
from rig.core.plug_ins import PlugInError
from rig.core.signals import BenchDelay, Order
from rig.design.advisor import Advice, AdvisorSettings
from rig.design.planned_test import Design, PlannedTest, Reach, RelayGains, Strokes
from rig.model.real_motor import FramedMotor
from rig.run_folder import results
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import CONFIG, META
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.writer import EVENTS
from rig.run_folder.results.salvage import DamagedError, parsed
from rig.running.experiment import stages
from rig.running.experiment.script import BREAKAWAY_LAW, SEARCH_LAW
from rig.running.experiment.survey import survey, sweep, test_once_more
from rig.running.experiment.until import drive_until
from rig.running.preflight.room_to_stop import guard_settings_of
from rig.running.session import Findings, Script, Session

Ending = Literal["its end", "a fault", "no end"]

_P = TypeVar("_P", bound=results.Part)
_T = TypeVar("_T")

_KNOWS_OLDER_LAWS = "599afeb2"  # the last commit of rig that replays breakaway laws of older versions
_KNOWS_OLDER_SEARCH = "0d61cc00"  # and of the gain search that tried the gains of the first test alone
_RECORD_AGAIN = "record the run again with this version"


@dataclass(frozen=True)
class Replay:
    """The result of a replay.

    folder      run folder
    rows        rows of the recording
    replayed    rows up to the first difference
    compared    rows whose drive was compared with the drive that acted
    lost        rows whose drive never reached the device: nothing to compare
    limited     rows in which the device drove less than commanded: nothing to compare
    duration_s  duration of the recording
    difference  the first difference; None: the same drive, tick for tick
    ending      how the recording ends; ``no end``: the run was killed, or its last rows are lost
    fault       the fault that ended the run
    notes       what was wrong with the recording, and was tolerated
    """

    folder: Path
    rows: int
    replayed: int
    compared: int
    lost: int
    limited: int
    duration_s: float
    difference: Difference | None
    ending: Ending
    fault: Fault | None
    notes: tuple[str, ...]

    @property
    def is_same(self) -> bool:
        """Whether the replay gave the drive that was recorded."""
        return self.difference is None

    def as_json(self) -> results.JsonObject:
        """For ``rig replay --json``."""
        return {
            "ok": self.is_same,
            **{name: getattr(self, name) for name in ("rows", "replayed", "compared", "lost", "limited", "duration_s")},
            "folder": str(self.folder),
            "difference": None if self.difference is None else asdict(self.difference),
            "ending": self.ending,
            "fault": None if self.fault is None else self.fault.as_dict(),
            "notes": list(self.notes),
        }


def replay(folder: Path, on_progress: Callable[[int, int], None] | None = None, own: OwnLaw | None = None) -> Replay:
    """Replay a run folder. Writes nothing.

    on_progress  called now and then with (rows done, rows in all)
    own          a new object of the user's law that ran; None: the law that the config names, if it names one
    Raises RecordingError if the folder cannot be read, or lacks what a replay needs; ConfigError for its config.
    """
    recording = read_run(folder, strict=True)
    fault, is_whole = _ending(recording)
    if recording.config_text is None:
        raise RecordingError(folder / CONFIG, "is missing", "a run cannot be replayed without its config")
    for name, kept in ((META, "how it was run"), (EVENTS, "how it ended")):
        if not (folder / name).exists():
            raise RecordingError(
                folder / name, "is missing", f"a run cannot be replayed without {kept}; copy the whole folder"
            )
    e = config.load(folder / CONFIG, follows_links=False)
    script = _script(recording, e, own)

    order, units, clock_ratio = _device(recording)

    stop = StopRequest()
    replayed = ReplayedRows(recording, e.period_s, fault, is_whole, stop, on_progress)
    drive_map = e.drive.map if units is None else replace(e.drive.map, full_units=units)
    relay = backend_of(e.device).relay_rules(e.device, drive_map, clock_ratio)
    if relay is None and replayed.holds_device_relay:
        raise RecordingError(
            folder / CONFIG,
            f"driver {e.daq.driver!r} does not say what its device makes of the gains of a relay in it",
            "its package must offer a backend with `relay_rules` (docs/plug-in-driver.md)",
        )
    driver = RecordedDriver(replayed, order, drive_map, clock_ratio, relay)
    clock, comparison = RecordedClock(replayed), RowComparison(replayed, None if units is None else drive_map.quantised)
    loop = ReplayLoop(driver, clock, Guard(guard_settings_of(e)), comparison, e.period_s, stop)
    loop.replayed = replayed
    session = Session(
        e,
        folder,
        Bench(driver, clock, DeviceInfo("", "record", "", emulated=True, drive_units=units), None),
        comparison,
        loop,
        recording.meta,
        Findings(real_time=results.RealTimeReport()),  # a replay asks the machine for nothing
        delay=recording.delay or BenchDelay(),  # nor does it measure
    )
    comparison.delay_s = session.delay.reported_s if session.delay and loop.waits(session.delay.reported_s) else 0.0
    difference = _compare(script, session, replayed)
    ending: Ending = "no end" if not is_whole else "its end" if fault is None else "a fault"
    return Replay(
        folder,
        rows=len(recording),
        replayed=replayed.next,
        compared=comparison.compared,
        lost=comparison.lost,
        limited=comparison.limited,
        duration_s=float(recording.t_s[-1] - recording.t_s[0]),
        difference=difference,
        ending=ending,
        fault=fault,
        notes=recording.notes,
    )


def _compare(script: Script, session: Session, replayed: ReplayedRows) -> Difference | None:
    """Run the script on the recording. Returns the first difference, or None."""
    seen: Fault | None = None
    try:
        script(session)
        session.loop.check_stop()
    except RecordEnds:
        return None
    except Diverged as diverged:
        difference = diverged.difference
        # raised while the loop recorded the row of a fault: the replay ended with that fault
        cause = diverged.__context__
        return (
            _with_fault(difference, cause) if isinstance(cause, Fault) and cause is not replayed.fault else difference
        )
    except Fault as fault:
        seen = fault
    except Exception as error:  # noqa: BLE001 - as in a run: a law that fails on this recording is a difference
        seen = Fault("INTERNAL", f"{type(error).__name__}: {error}")
    if seen is not None and (not replayed.is_over or replayed.fault is None or replayed.fault.code != seen.code):
        row = max(replayed.next - 1, 0)
        recorded = f"{replayed[row].u_V:+.6f} V, and the run goes on"
        if replayed.is_over and replayed.fault is not None:
            recorded = f"the run ended: {replayed.fault}"
        elif replayed.is_over:
            recorded = "the run went on to its end"
        return _with_fault(replayed.diverged(row, "law", recorded, "", replayed[row].u_V).difference, seen)
    if not replayed.is_over:
        return replayed.diverged(replayed.next, "record", "one more row", "the run is over").difference
    if seen is None and replayed.fault is not None and replayed.must_come_again:
        return replayed.missed_fault().difference
    return None


def _with_fault(difference: Difference, fault: Fault) -> Difference:
    by: Literal["law", "guard"] = "guard" if fault.code in OF_GUARD else "law"
    return replace(difference, by=by, replayed=f"{fault}", replayed_V=None)


def _ending(recording: Recording) -> tuple[Fault | None, bool]:
    """The fault that ended the run, and whether the recording has an end and all rows."""
    fault: Fault | None = None
    kinds = [event.kind for event in recording.events]
    for event in recording.events:
        if event.kind == "fault":
            code = str(event.detail.get("code"))
            if code not in FAULTS:
                raise RecordingError(
                    recording.source / EVENTS,
                    f"this version does not know the fault {code}",
                    "use the version that recorded the run",
                )
            fault = Fault(code, str(event.detail.get("detail", "")))
    torn = any("torn" in note for note in recording.notes)
    return fault, "end" in kinds and not torn and "record_lost" not in kinds


def _script(recording: Recording, e: Experiment, own: OwnLaw | None) -> Script:
    """The stages of the run that drive; a replay leaves out those that only read the recording."""
    what = _meta_with(recording, "script").script
    tracked = _models(recording)
    models = {method: model for method, (model, _) in tracked.items()}
    further_delay_s = max((further_s for _, further_s in tracked.values()), default=0.0)
    further = _events(recording, "further_test", results.FurtherTest)
    sweeps = _sweeps(recording, e)
    if what is None:
        raise _unknown(recording, "script", None)
    drive: Script
    match what.name:
        case "run" | "relay" | "survey" if e.relay.until is not None:
            drive = partial(drive_until, known=_known(recording), advisers=RecordedAdvice(_decisions(recording)))
        case "run" | "relay":
            drive = stages.drive_tests
        case "survey":
            drive = stages.drive_one_test
        case "breakaway" | "track":
            drive = stages.drive_check
        case "jog":
            if what.duration_s is None or (what.u_V is None) != bool(what.leased):
                raise _broken(recording, "script", what.as_json())
            if what.u_V is None:
                drive = partial(stages.drive_by_lease, longest_s=what.duration_s, recorded=_leases(recording))
            else:
                drive = partial(stages.drive_by_hand, u_V=what.u_V, duration_s=what.duration_s)
        case "law":
            drive = partial(stages.drive_law, law=_users_law(recording, what, e, own))
        case _:
            raise _unknown(recording, "script", what.name)
    if what.name != "jog" and what.breakaway != BREAKAWAY_LAW:
        raise RecordingError(
            recording.source / META,
            f"its breakaway check is that of an older version: {what.breakaway or 'ramps one way'}",
            f"to replay it take that version: git checkout {_KNOWS_OLDER_LAWS} in a clone of rig",
        )
    if what.name in ("run", "relay") and e.relay.target is not None and what.search != SEARCH_LAW:
        raise RecordingError(
            recording.source / META,
            "its gain search is that of an older version, which tried the gains of the first test alone",
            f"to replay it take that version: git checkout {_KNOWS_OLDER_SEARCH} in a clone of rig",
        )

    def script(session: Session) -> None:
        drive(session)
        for gains in further:
            test_once_more(session, (gains.h1_V, gains.h2_V))
        if sweeps is not None:
            sweep(session, sweeps)
        elif what.name == "survey" and not further:
            survey(session)  # it had no room for sweeps, or the recording ends before them
        if models:
            stages.track(session, models, further_delay_s)

    return script


class RecordedAdvice:
    """The decisions of a run's advisers, as its events tell them, each after the row at which it took effect."""

    trouble = last_words = ""

    def __init__(self, decisions: Mapping[int, Advice]) -> None:
        self._decisions = decisions

    def begin(self, settings: AdvisorSettings) -> None:
        """As ``Advisers``: there is nothing to know."""

    def advice(self, row: int, t_s: float) -> Advice | None:
        """As ``Advisers``."""
        return self._decisions.get(row)

    def braked(self) -> None:
        """As ``Advisers``: the decisions that follow know it."""


def _decisions(recording: Recording) -> dict[int, Advice]:
    """The decisions by advice, by their rows."""
    found: dict[int, Advice] = {}
    strokes: list[Stroke] = []
    for event in recording.events:
        if event.kind == "stroke":
            one = _parsed(recording, event, results.DrivenStroke)
            strokes.append(Stroke(one.u_V, one.turn_rad))
        elif event.kind == "decided":
            decided = _parsed(recording, event, results.Decided)
            if decided.by == "advice":
                found[decided.row] = _made(recording, event, results.Decided, partial(_advice, strokes=tuple(strokes)))
            strokes.clear()
    return found


def _advice(decided: results.Decided, strokes: tuple[Stroke, ...]) -> Advice:
    """A decision as advice. Raises ValueError where its event lacks a number."""
    test: PlannedTest
    if decided.what == "stop":
        return Advice(None, stop=decided.why)
    if decided.what == "rest" and decided.rest_s is not None:
        return Advice(None, rest_s=decided.rest_s)
    if decided.what == "relay" and decided.h1_V is not None and decided.h2_V is not None:
        test = RelayGains(decided.h1_V, decided.h2_V)
    elif decided.what == "strokes" and decided.longest_stroke_s is not None:
        test = Strokes(strokes, decided.longest_stroke_s)
    else:
        raise ValueError(f"what is decided is {decided.what!r}")
    return Advice(None, Design(test, math.nan, math.nan, Reach(math.nan, math.nan, math.nan)))


def _known(recording: Recording) -> FramedMotor | None:
    """The model that the run began with; None if it knew none."""
    for event in recording.events:
        if event.kind == "known":
            return _made(recording, event, results.KnownModel, lambda known: FramedMotor.of(known.numbers))
    return None


def _users_law(recording: Recording, what: results.ScriptCall, e: Experiment, own: OwnLaw | None) -> Timed:
    """The law of the user's own that ran: the one that is given, or the one that the config names."""
    if own is not None and what.duration_s is not None:
        return Timed(own, what.duration_s, what.law or type(own).__name__)
    if e.law is None:
        raise RecordingError(
            recording.source / META,
            f"the law {what.law!r} was an object of a program, which a run folder does not hold",
            "replay it from Python, with the law made anew: rig.replay(run, law=MyLaw())",
        )
    try:
        return Timed(named_law(e.law.name, e.law.options), e.law.duration_s, e.law.name)
    except (LookupError, ValueError, PlugInError) as error:
        raise RecordingError(
            recording.source / CONFIG, f"its law cannot be made: {error}", "install the package that offers it"
        ) from error


def _unknown(recording: Recording, what: str, name: str | None) -> RecordingError:
    return RecordingError(
        recording.source / META,
        f"this version does not know the {what} {name!r}",
        "use the version that recorded the run",
    )


def _device(recording: Recording) -> tuple[Order, int | None, float]:
    """Order of a tick; units of the drive (None: it has no steps); device seconds in a second of the host."""
    meta = _meta_with(recording, "order", "drive_units", "firmware")
    if meta.order is None:
        raise _broken(recording, "order", None)
    if meta.firmware is None or not meta.firmware.says("clock_ratio"):
        raise _broken(recording, "firmware.clock_ratio", None)
    return meta.order, meta.drive_units, meta.firmware.clock_ratio


def _broken(recording: Recording, name: str, value: object) -> RecordingError:
    return RecordingError(recording.source / META, f"{name} is {value!r}", _RECORD_AGAIN)


def _models(recording: Recording) -> dict[Method, tuple[FramedMotor, float]]:
    """The models that tracked, in order, each with the delay that the device did not report, s."""
    return dict(
        _made(recording, event, results.DrivenModel, _driven) for event in recording.events if event.kind == "model"
    )


def _driven(model: results.DrivenModel) -> tuple[Method, tuple[FramedMotor, float]]:
    """By its method, a model that tracked and its further delay, s. Raises ValueError where its numbers are none."""
    return model.method, (FramedMotor.of(model.numbers), model.further_delay_s)


def _leases(recording: Recording) -> Callable[[int], float | None]:
    """The drive of a jog by leases, V, by its row; None from its end on."""
    leases = _events(recording, "lease", results.JoggedLease)
    rows = [lease.row for lease in leases]

    def drive_V(row: int) -> float | None:
        seen = bisect_right(rows, row)
        return leases[seen - 1].u_V if seen else 0.0

    return drive_V


def _sweeps(recording: Recording, e: Experiment) -> Sweeps | None:
    """The sweeps of the survey that ran; None if none did."""
    planned = _events(recording, "survey", results.DrivenSurvey)
    if not planned:
        return None
    of = planned[0]
    speeds = tuple(one.speed_rad_s for one in _events(recording, "sweep", results.DrivenSweep))
    return Sweeps(
        CrudeMotor(of.tau_s, of.K_rad_s_V, of.plus_V, of.minus_V),
        SweepPlan(of.low_rad, of.high_rad, speeds, of.bandwidth_1_s),
        SweepLoop(e.period_s, of.latency_s, e.drive.max_V, of.lost_rad, e.sensor.curve.lsb_rad),
    )


def _events(recording: Recording, kind: str, part: type[_P]) -> list[_P]:
    """The events of one kind. Raises RecordingError where one is broken."""
    return [_parsed(recording, event, part) for event in recording.events if event.kind == kind]


def _parsed(recording: Recording, event: results.RunEvent, part: type[_P]) -> _P:
    return _made(recording, event, part, lambda found: found)


def _made(recording: Recording, event: results.RunEvent, part: type[_P], of: Callable[[_P], _T]) -> _T:
    """What an event tells. Raises RecordingError where it is broken, or ``of`` finds its numbers impossible."""
    try:
        return of(parsed(part, event.detail))
    except (DamagedError, ValueError) as error:
        raise RecordingError(
            recording.source / EVENTS, f"event {event.kind} is broken ({error})", _RECORD_AGAIN
        ) from error


def _meta_with(recording: Recording, *names: str) -> results.RunMeta:
    """meta.json. Raises RecordingError if it lacks one of the keys ``names``, which a replay needs."""
    for name in names:
        if not recording.meta.says(name):
            raise RecordingError(
                recording.source / META,
                f"does not say {name}: an older version recorded this run, and did not keep what a replay needs",
                _RECORD_AGAIN,
            )
    return recording.meta
