"""One recorded run on the bench. Whatever ends it: the drive stops, and recording, result and report are kept."""

from __future__ import annotations

import math
import operator
import os
import platform
import stat
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote

from rig.backends.clock import MonotonicClock, PacedClock
from rig.backends.driver import Clock
from rig.backends.registry import Bench, connect
from rig.config import Experiment, dump
from rig.control.breakaway import BreakawayCheck
from rig.control.excitation import GainSearch, SettledCycle
from rig.control.guard import Guard
from rig.control.loop.device_relay import STOPPING
from rig.control.loop.real_time import RealTimeSettings
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import Gone, StopRequest, stop_on_signals
from rig.control.rising_gains import RisingGains
from rig.core.estimators import ESTIMATORS
from rig.core.faults import Fault, since_the_last_run
from rig.core.package import VERSION as RIG_VERSION
from rig.core.signals import BenchDelay
from rig.identification import Identification, IdentifyError, identify
from rig.identification.departures import DEPARTURES
from rig.model.bench import BenchParameters
from rig.model.real_motor import plain
from rig.model.supply import SupplyReading
from rig.output.report import write_report
from rig.run_folder import results
from rig.run_folder.live.stop_flag import StopFlag
from rig.run_folder.recording.errors import CannotWriteError, RecordingError
from rig.run_folder.recording.folder import CONFIG, META, RESULT, create_run, json_text, write_whole
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recorder import Recorder
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.sink import JsonScalar, RowSink
from rig.run_folder.recording.stage import Stage, StageKind
from rig.run_folder.results.answer_words import NOTHING_TO_IDENTIFY
from rig.run_folder.results.identification import Answered
from rig.run_folder.results.meta import REHEARSAL
from rig.run_folder.results.part import VERSION, Part
from rig.running.preflight import notes
from rig.running.preflight.room_to_stop import guard_settings_of

FREE_BRIDGES = ("runs_free", "no_brake", "free_between")  # laws
COASTING = 2.0  # estimated no-load speed over that of the data sheet from which on the bridge is doubted
MOST_TESTS = 40  # designed tests of one run
_LONG_GAP_S = 0.1  # between two readings of a device that latches no e-stop


@dataclass
class Outcome:
    """How a run ended: its folder, its result.json, the fault that ended it, what else failed, how it was paced."""

    folder: Path
    result: results.RunResult
    fault: Fault | None = None
    failures: list[str] = field(default_factory=list)
    paced: str = ""  # in words; empty where no pace was asked for

    @property
    def traceback(self) -> str:
        """Where a law of the user's own raised what ended the run; empty if none did."""
        return "" if self.fault is None else traceback_of(self.fault)

    @property
    def failure(self) -> str:
        """Why the run failed, in words; empty if it did not."""
        why = ([] if self.fault is None else [str(self.fault)]) + self.failures
        # without another relay test the run was for friction alone
        friction_alone = () if self.result.relays else [e.name for e in ESTIMATORS if not e.finds_motor]
        answer = self.result.answer
        of_friction = {name: one for name, one in self.result.estimates.items() if name in friction_alone}
        for method, estimate in ({} if answer is None else {answer.method: answer} | of_friction).items():
            if not why and estimate.is_refused:
                why.append(f"the {method} estimate was refused: " + "; ".join(estimate.reasons))
        return "; ".join(why)

    def fail(self, error: RecordingError) -> None:
        """Note what could not be written, once: the result is written twice."""
        words = f"{error.path.name} {error.cause}; {error.cure}"
        self.failures += [] if words in self.failures else [words]

    def as_json(self) -> results.JsonObject:
        """What `--json` prints: whether all is well, the folder, if not the cause and the cure; then result.json."""
        printed: results.JsonObject = {"ok": not self.failure, "folder": str(self.folder)}
        if self.failure:
            printed |= {"cause": self.failure, "cure": "" if self.fault is None else self.fault.cure}
        return printed | self.result.as_json()


@dataclass
class Findings:
    """What a run has found so far. A field is None or empty until its stage has run.

    real_time       what the machine granted the loop
    gains_V         gains (h1, h2) of the relay tests, V
    further_gains_V gains of a test at a third amplitude, V, if the gains were searched
    cycle           the limit cycle of the last relay test
    identification  of this run's recording
    models          that are driven: of this run, or as they are kept with ``models_from``
    models_from     another run whose models are driven
    tracking        by method
    stopped         why the tests of `relay.until` ended
    notes           what else there is to know, in words
    """

    real_time: results.RealTimeReport | None = None
    breakaway: BreakawayCheck | None = None
    search: GainSearch | RisingGains | None = None
    gains_V: tuple[tuple[float, float], ...] = ()
    further_gains_V: tuple[float, float] | None = None
    cycle: SettledCycle | None = None
    identification: Identification | None = None
    models: Answered | None = None
    models_from: Path | None = None
    jog: results.JogResult | None = None
    tracking: dict[str, results.TrackingResult] = field(default_factory=dict)
    stopped: results.StoppedResult | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def checked(self) -> BreakawayCheck:
        """The breakaway check. Raises ValueError if there was none."""
        if self.breakaway is None:
            raise ValueError("no test begins before the breakaway check")
        return self.breakaway


@dataclass
class Session:
    """One run in progress: the open bench, its loop, the run folder, meta.json, and the findings so far."""

    experiment: Experiment
    folder: Path
    bench: Bench
    recorder: RowSink
    loop: Loop
    meta: results.RunMeta
    found: Findings = field(default_factory=Findings)
    recording: Recording | None = None  # the rows that were read last
    delay: BenchDelay | None = None  # of the bench, once it is known; in a replay from the begin
    reads: Callable[[Path, Recording | None], Recording] = read_run  # the folder's rows, by those that were read last
    paced: str = ""  # at the end: as of ``Outcome``
    made: os.stat_result | None = field(init=False, default=None)  # the folder, as it was made

    def __post_init__(self) -> None:
        with suppress(OSError):
            self.made = self.folder.lstat()

    def require_own_folder(self) -> None:
        """Raise CannotWriteError where another folder stands in the place of the run's: what is there is not rig's."""
        with suppress(OSError):  # there is none: who writes says so
            here = self.folder.lstat()
            if self.made is not None and stat.S_ISDIR(here.st_mode) and not os.path.samestat(here, self.made):
                raise CannotWriteError(
                    self.folder,
                    "is another folder than the one that this run began in: its files stay as they are",
                    "the rows of this run are where somebody has moved its folder: type `rig identify` on that",
                )

    def write(self, name: str, what: Part) -> None:
        """Write a file of the run, strict JSON. Raises CannotWriteError, also where the folder is not the run's."""
        text = json_text(what)
        self.require_own_folder()
        write_whole(self.folder / name, text, follows_links=False)

    def add_to_meta(self, **known: object) -> None:
        """Write keys of meta.json that are known by now. Raises as ``write``."""
        self.meta = self.meta.model_copy(update=known)
        self.write(META, self.meta)

    def read(self) -> Recording:
        """The rows so far. Parses only the rows since the last call. Raises RecordingError."""
        self.require_own_folder()
        self.recording = self.reads(self.folder, self.recording)
        return self.recording

    def note(self, kind: str, **fields: JsonScalar) -> None:
        """Write an event, with the time of now."""
        self.recorder.event(self.loop.now_s, kind, **fields)


def real_time_of(experiment: Experiment) -> RealTimeSettings:
    """What the loop's process asks the machine for."""
    wanted = experiment.loop
    return RealTimeSettings(wanted.priority, wanted.cpu, wanted.lock_memory, wanted.raise_workers)


Script = Callable[[Session], None]
OnStart = Callable[[Path, tuple[str, ...]], None]  # called with the run folder and the first notes


def record(
    experiment: Experiment,
    parent: Path,
    what: results.ScriptCall,
    script: Script,
    on_start: OnStart | None,
    again: Bench | None = None,
    gone: Gone | None = None,
    series: StopFlag | None = None,
) -> Outcome:
    """Run ``script`` on the bench and record it. Whatever ends it, the drive stops and the recording is kept.

    parent    folder in which the run folder is made
    what      name and arguments of the script, for meta.json: a replay needs them
    on_start  called once with the run folder and the first notes
    again     a bench that the same command has opened already; its opener closes it
    gone      who has to be there while it drives, and is not: as of ``StopRequest``
    series    the flag of a series of runs, which goes with it from run to run; None: the run is alone

    result.json is written before signals get their usual meaning back: a second Ctrl-C costs the report, no more.
    Raises Fault if the bench cannot be opened, RecordingError if the run folder cannot be made.
    """
    started = datetime.now(UTC)
    session: Session | None = None
    fault: Fault | None = None
    failures: list[str] = []
    with StopFlag() if series is None else nullcontext(series) as flag:  # until the report is there
        with stop_on_signals(flag, gone) as stop:
            with suppress(OSError):  # then there is no room for a run folder either, which is said
                flag.open(parent, what.name)
            try:
                with connect(experiment.device) if again is None else nullcontext(again) as bench:
                    session, recorder = _begin(experiment, parent, what, bench, stop, started)
                    try:
                        fault = _run_script(script, session, on_start)
                    finally:
                        lost = _close(recorder)
                        if fault is not None and lost is not None and lost.detail not in fault.detail:
                            failures.append(f"{lost.code}: {lost.detail}")
                        fault = fault or lost
            except Exception as error:
                if session is None:
                    raise
                failures.append(f"the bench was not closed well: {_defect(error)}")
            session.found.notes += filter(None, [getattr(session.bench.driver, "end_words", "")])  # once it is closed
            outcome = Outcome(session.folder, results.RunResult(), fault, failures, session.paced)
            _write_result(session, outcome)
            late = stop.look()
            if late is not None and fault is None:
                outcome.failures.append(_came_late(late))
        outcome = _conclude(session, outcome)
        if fault is None and late is None and (by := flag.asked_by()):
            outcome.failures.append(_came_late(f"Stop by {by}"))
        return outcome


def _came_late(reason: str) -> str:
    return f"{reason} came after the experiment had ended"


def _begin(
    experiment: Experiment, parent: Path, what: results.ScriptCall, bench: Bench, stop: StopRequest, started: datetime
) -> tuple[Session, Recorder]:
    """Make the run folder, its recorder and the loop."""
    info, drive = bench.info, experiment.drive
    tried = info.emulated and experiment.limits.is_endless
    latched = [_latched(code, tried) for code in info.acknowledged]
    supply = SupplyReading(info.supply_V, info.supply_at_least, drive.supply_V, drive.bridge_drop_V).objection
    stages = _stages(experiment)
    meta = run_meta(experiment, bench, what, started)
    settings = guard_settings_of(experiment)
    folder = create_run(parent, f"{'rehearsal' if meta.rehearsal else what.name}-{experiment.name}", started)
    no_flag = _set_up_flag(stop, folder)
    for name, text in ((CONFIG, dump(experiment)), (META, json_text(meta))):
        write_whole(folder / name, text, follows_links=False)
    recorder = Recorder(folder, stages, waits=not isinstance(bench.clock, MonotonicClock))
    loop = Loop(bench.driver, bench.clock, Guard(settings), recorder, experiment.period_s, stop)
    _tell_time(stop, loop, bench.clock, experiment.period_s)
    first_notes = [*no_flag, *info.remarks, *latched, *([] if supply is None else [supply])]
    return Session(experiment, folder, bench, recorder, loop, meta, Findings(notes=first_notes)), recorder


def _set_up_flag(stop: StopRequest, folder: Path) -> list[str]:
    """Make the stop flag in the run folder. Returns a note where that fails: the run goes on without it."""
    try:
        if stop.flag is not None:
            stop.flag.begin(folder)
    except OSError as error:
        return [f"no stop flag in {folder}: {error.strerror}. no panel can stop this run; Ctrl-C can"]
    return []


def _tell_time(stop: StopRequest, loop: Loop, clock: Clock, period_s: float) -> None:
    """Tell who looks on which time of this machine's clock is the run's time 0. Virtual time has none."""
    zero_s = -loop.since_start_s(0.0) if isinstance(clock, MonotonicClock) else math.nan
    with suppress(OSError):  # on a disk that has just become full the age of a row stays unknown
        if stop.flag is not None:
            stop.flag.tell(zero_s, period_s)


def _run_script(script: Script, session: Session, on_start: OnStart | None) -> Fault | None:
    """Run the script to its end. Returns the fault that ended it, or None."""
    fault: Fault | None = None
    try:
        if on_start is not None:
            on_start(session.folder, tuple(session.found.notes))
        script(session)
        session.loop.check_stop()
    except Fault as seen:
        fault = seen
        fault.fit(session.experiment.daq.driver, is_rehearsal=bool(session.meta.rehearsal))
        if text := traceback_of(seen):
            session.note("traceback", text=text[-2000:])
    except IdentifyError as error:
        fault = Fault("NOT_IDENTIFIED", f"{error.cause}; {error.cure}")
    except RecordingError as error:
        fault = Fault("NOT_IDENTIFIED", str(error))
    except KeyboardInterrupt:  # a law has set Python's own handler
        fault = Fault("INTERRUPTED", "SIGINT")
    except BaseException as error:  # noqa: BLE001 - whatever it is, SystemExit too, the run has its record and a result
        fault = Fault("INTERNAL", f"{type(error).__name__}: {error}")
        session.note("traceback", text="".join(traceback.format_exception(error))[-2000:])
    finally:
        session.loop.close()
    if fault is not None:
        session.note("fault", **fault.as_dict())
    session.paced = _told_pace(session)
    session.found.notes += [*_loop_notes(session.loop), *filter(None, (session.paced,))]
    session.note("end")
    return fault


def traceback_of(fault: Fault) -> str:
    """The traceback of the exception that a user's law raised, for the user; empty of any other fault."""
    if fault.code != "LAW_FAILED" or fault.__cause__ is None:
        return ""
    return "".join(traceback.format_exception(fault.__cause__))


def _loop_notes(loop: Loop) -> list[str]:
    """Notes on the loop of a run that is over."""
    notes = []
    braked = loop.guard.braked_ticks
    if braked:
        notes.append(f"the guard braked in {braked} ticks: for this motion the limits leave too little room to stop")
    if loop.unconfirmed_stops:
        notes.append("the device did not confirm the stop: its watchdog sets 0 V; make sure that the shaft stands")
    gap_s = loop.pause_watch.longest_gap_s
    if gap_s > _LONG_GAP_S:
        notes.append(
            f"in a pause nothing read the device for {1e3 * gap_s:.0f} ms: an e-stop that opened for less may have "
            "passed unseen; wire the e-stop so that it cuts the motor's supply"
        )
    return notes


def _told_pace(session: Session) -> str:
    """Whether a paced time kept its pace, in words; also in meta.json, written with the result. Else empty."""
    clock = session.bench.clock
    if not isinstance(clock, PacedClock):
        return ""
    session.meta = session.meta.model_copy(update={"time": run_time(session.bench)})
    stood = "without a stall"
    if clock.stalls:
        times = "once" if clock.stalls == 1 else f"{clock.stalls} times"
        stood = f"it stood {times}, {clock.longest_stall_s:.3g} s at most, for the machine or for sums of rig itself"
    return f"virtual time at pace {clock.pace:g}: {stood}"


def _close(recorder: Recorder) -> Fault | None:
    """Close the recording. Returns the fault if rows could not be written."""
    try:
        recorder.close()
    except Fault as lost:
        return lost
    except Exception as error:  # noqa: BLE001 - what was recorded is there, and gets its result
        return Fault("INTERNAL", f"closing the recording: {type(error).__name__}: {error}")
    return None


def _conclude(session: Session, outcome: Outcome) -> Outcome:
    """Identify what was recorded before a fault, complete result.json, write the report, note what failed."""
    if session.found.identification is None and session.found.models_from is None:
        try:
            recording = session.read()
            if any(Stage.parse(stage).tells_motor for stage in recording.stages()):
                found = session.found.identification = identify([recording])
                session.found.notes += beside_data_sheet(session.experiment, found)
        except (IdentifyError, RecordingError) as error:
            session.found.notes.append(f"{NOTHING_TO_IDENTIFY}: {error.cause}")
        except Exception as error:  # noqa: BLE001 - the result that is written already stays, and says so
            outcome.failures.append(f"the recording was not identified: {_defect(error)}")
        _write_result(session, outcome)
    try:
        session.require_own_folder()
        if session.folder.is_symlink():  # somebody has put it in the folder's place
            raise OSError(f"{session.folder} is a link now, and rig follows none here")
        write_report(session.folder, session.found.identification, session.recording)
    except RecordingError as error:
        outcome.fail(error)
    except OSError as error:
        outcome.failures.append(f"no report: {error}")
    except KeyboardInterrupt:
        outcome.failures.append(f"no report: interrupted; `rig report {quote(str(session.folder))}` draws it")
    except Exception as error:  # noqa: BLE001 - recording and result are there
        outcome.failures.append(f"no report: {_defect(error)}")
    return outcome


def beside_data_sheet(e: Experiment, identification: Identification) -> list[str]:
    """A note if the bridge does not brake, or the motor is faster than the config says: room to stop counts on both.

    By a bridge that lets the motor run free while PWM is low, K and tau come out several times too large where the
    tests do not show it, because its drive brakes for its share of the time only (docs/real-bench.md).
    """
    best, answer = identification.leading, identification.answer
    if answer is not None and any(law.name in FREE_BRIDGES for law in answer.law or ()):
        return [
            "by these tests the bridge lets the motor run free: 0 V does not stop it in the room that `rig check` "
            "counts; docs/real-bench.md names the wires to move"
        ]
    if e.motor is None or best is None or not best.is_motor:
        return []
    expected_rad_s = e.motor.no_load_speed_rad_s
    no_load_rad_s = best.K_rad_s_V * (e.drive.supply_V - best.fc_V)
    if identification.best is not None and 1.1 < no_load_rad_s / expected_rad_s <= COASTING:
        return [
            f"motor.no_load_speed_rad_s is {expected_rad_s:g}, but by this estimate the shaft would reach "
            f"{no_load_rad_s:.3g} rad/s at {e.drive.supply_V:g} V: correct it; the breakaway check's strokes rely on it"
        ]
    if no_load_rad_s > COASTING * expected_rad_s:
        return [
            f"by this estimate the shaft would reach {no_load_rad_s:.3g} rad/s at {e.drive.supply_V:g} V, but "
            f"motor.no_load_speed_rad_s is {expected_rad_s:g}: if that is true, the bridge lets the motor run free "
            "while PWM is low, as an L298 does with PWM on its enable; docs/real-bench.md names the wires to move"
        ]
    return []


def _defect(error: Exception) -> str:
    return f"{type(error).__name__}: {error}; please report this with the run folder"


def _write_result(session: Session, outcome: Outcome) -> None:
    try:
        outcome.result = run_result(session, outcome.fault)
    except Exception as error:  # noqa: BLE001 - a result that says why is better than none
        outcome.failures.append(f"the result is incomplete: {_defect(error)}")
        outcome.result = least_result(session, [*session.found.notes, *outcome.failures], outcome.fault)
    # the result last: a folder that has one is whole
    told: dict[str, Part] = ({META: session.meta} if session.paced else {}) | {RESULT: outcome.result}
    try:
        for name, what in told.items():
            session.write(name, what)
    except RecordingError as error:
        outcome.fail(error)


def _stages(experiment: Experiment) -> list[str]:
    """Every stage that a run can record."""
    relays = [str(Stage.test(StageKind.RELAY, number)) for number in range(1, 5)]
    if experiment.relay.until is not None:
        kinds = (StageKind.RELAY, StageKind.STROKES)
        relays = [str(Stage.test(kind, number)) for number in range(1, MOST_TESTS + 2) for kind in kinds]
    if experiment.relay.hysteretic is not None:
        runs = range(1, len(experiment.relay.hysteretic) + 1)
        relays += [str(StageKind.HOMING), *(str(Stage.test(StageKind.HYSTERETIC, number)) for number in runs)]
    relays.append(str(StageKind.SURVEY))
    tracks = [] if experiment.tracking is None else [str(Stage.track(method)) for method in experiment.tracking.methods]
    return ["rest", "jog", "breakaway", "search", *relays, *tracks, str(StageKind.LAW), STOPPING]


def _latched(code: str, tried: bool) -> str:
    """What a device had latched before the run, in words; ``tried``: an emulated bench tries its e-stop by itself."""
    if tried and code == "DEVICE_ESTOP":
        return "the emulated bench's e-stop was tried before the run, as a bench without travel limits needs"
    return since_the_last_run(code)


# ---------------------------------------------------------------------- meta.json and result.json


def run_meta(experiment: Experiment, bench: Bench, script: results.ScriptCall, started: datetime) -> results.RunMeta:
    """meta.json of a run that begins on an open bench."""
    info = bench.info
    measures_supply = not math.isnan(info.supply_V)
    emulated = experiment.emulated
    is_rehearsal = info.emulated and emulated is not None and emulated.rehearsal is not None
    return results.RunMeta(
        version=VERSION,
        name=experiment.name,
        backend=f"{'rehearsal, nothing real: ' if is_rehearsal else ''}{bench.driver.backend}",
        emulated=info.emulated,
        order=bench.driver.order,
        period_s=experiment.period_s,
        drive_units=info.drive_units,
        times_error_s=bench.times_error_s,
        firmware=results.DeviceSeen.of(
            info,
            supply_V=info.supply_V if measures_supply else None,
            supply_at_least=info.supply_at_least if measures_supply else None,
        ),
        drive=results.SupplyBelieved.of(experiment.drive),
        sensor=results.SensorBelieved.of(
            experiment.sensor, calibration_rad=tuple(sorted(rad for _, rad in experiment.sensor.points))
        ),
        failsafe="none: the device holds its last drive"
        if bench.driver.failsafe is None or bench.watchdog_s is None
        else f"device watchdog, {bench.watchdog_s * 1e3:.0f} ms",
        started_utc=started.isoformat(timespec="milliseconds"),
        versions={"rig": RIG_VERSION, "python": platform.python_version()},
        host={"system": platform.platform(), "machine": platform.machine()},
        command=" ".join(sys.argv),
        truth=true_motor(bench),
        rehearsal=is_rehearsal or None,
        time=run_time(bench),
        script=script,
        identify_without=experiment.identify.without or None,
    )


def run_time(bench: Bench) -> results.RunTime:
    """The time of an open bench, with its stalls so far."""
    clock = bench.clock
    if isinstance(clock, PacedClock):
        return results.RunTime.of(clock, kind="virtual")
    return results.RunTime(kind="real" if isinstance(clock, MonotonicClock) else "virtual")


def run_result(session: Session, fault: Fault | None) -> results.RunResult:
    """result.json of a run that has come to its end or to a fault."""
    experiment, meta, found, own = session.experiment, session.meta, session.found, session.found.identification
    loop = session.loop.summary()
    link, not_counts = _link_counts(session.bench.driver.link_statistics)
    return results.RunResult(
        version=VERSION,
        backend=meta.backend,
        rehearsal=meta.rehearsal,
        answer=_answer(found),
        estimates=_estimates(found),
        relays=() if own is None else tuple(own.relays),
        tracking=dict(found.tracking),
        loop=loop.model_copy(update={"real_time": found.real_time}),
        link=link,
        faults=_faults(fault),
        config_notes=tuple(notes(experiment.device)),
        notes=(*_notes(found), *not_counts),
        hysteretic=None if own is None else _hysteretic(own, experiment),
        models_from=None if found.models_from is None else str(found.models_from),
        breakaway=None if found.breakaway is None else _breakaway(found.breakaway, own),
        friction_map=None if own is None or own.friction_map is None else own.friction_map.as_result(),
        **({} if own is None else own.evidence),
        jog=found.jog,
        search=None
        if found.search is None
        else tuple(results.SearchStepResult(**step._asdict()) for step in found.search.steps),
        stopped=found.stopped,
        truth=meta.truth,
    )


def least_result(session: Session, notes: list[str], fault: Fault | None) -> results.RunResult:
    """result.json of a run whose findings cannot be written: backend, loop, fault and notes."""
    return results.RunResult(
        version=VERSION,
        backend=session.meta.backend,
        rehearsal=session.meta.rehearsal,
        answer=None,
        estimates={},
        relays=(),
        tracking={},
        loop=session.loop.summary(),
        link={},
        faults=_faults(fault),
        config_notes=(),
        notes=tuple(notes),
    )


def true_motor(bench: Bench) -> results.TrueMotor | None:
    """The emulated motor's parameters, under an estimate's names; None if the motor is real.

    With viscous friction, tau_s and K_rad_s_V include it, as the motion shows them. The values without it stand beside.
    """
    if bench.truth is None:
        return None
    motor = bench.truth.motor
    friction = motor.friction
    has_viscous = friction.viscous_V_s_rad > 0.0
    return results.TrueMotor(
        tau_s=motor.tau_eff_s,
        K_rad_s_V=motor.K_eff_rad_s_V,
        fc_V=friction.fc_V,
        asym_V=motor.asym_V,
        static_plus_V=friction.static_plus_V - motor.bias_V,
        static_minus_V=friction.static_minus_V + motor.bias_V,
        stribeck_rad_s=friction.stribeck_rad_s if friction.stribeck_rad_s > 0.0 else None,
        viscous_V_s_rad=friction.viscous_V_s_rad if has_viscous else None,
        tau_without_viscous_s=motor.tau_s if has_viscous else None,
        K_without_viscous_rad_s_V=motor.K_rad_s_V if has_viscous else None,
        law=true_laws(bench.truth),
    )


def true_laws(bench: BenchParameters) -> tuple[results.TrueLaw, ...] | None:
    """What the bench's motor has beyond tau, K and Coulomb friction, as the laws that `rig identify` finds.

    None where its static friction or Stribeck effect differs by direction: no law has that.
    """
    try:
        motor = plain(bench.motor) if bench.real is None else bench.real
    except ValueError:
        return None
    found = []
    for law in DEPARTURES:
        values = [getattr(motor, name) for name in law.numbers]
        if any(values):
            size = values[0] if len(values) == 1 else math.hypot(*values)
            numbers = {name: getattr(motor, name) for name in law.fields}
            found.append(results.TrueLaw(name=law.name, value=size, unit=law.unit, numbers=numbers))
    return tuple(found)


def _estimates(found: Findings) -> dict[str, results.EstimateResult]:
    """The estimates; those of another run have no rows in this one."""
    if found.identification is not None:
        return {method: estimate.as_result() for method, estimate in found.identification.estimates.items()}
    others = {} if found.models is None else found.models.estimates
    return {method: estimate.model_copy(update={"rows": None}) for method, estimate in others.items()}


def _answer(found: Findings) -> results.Answer | None:
    """The answer; that of another run has no rows in this one."""
    if found.identification is not None:
        return found.identification.answer
    answer = None if found.models is None else found.models.answer
    return None if answer is None else answer.model_copy(update={"rows": None})


def _faults(fault: Fault | None) -> tuple[results.FaultReport, ...]:
    return () if fault is None else (results.FaultReport(**fault.as_dict()),)


def _link_counts(told: Mapping[str, object]) -> tuple[dict[str, int], list[str]]:
    """The driver's counts, and a note on each that is no whole number: other packages may give any value."""
    counts, notes = {}, []
    for name, value in told.items():
        try:
            counts[str(name)] = operator.index(int(value) if isinstance(value, float) and value.is_integer() else value)  # type: ignore[arg-type]  # refused below
        except TypeError:
            notes.append(f"the driver counts {name!r} as {value!r}, which is no whole number: left out of `link`")
    return counts, notes


def _notes(found: Findings) -> tuple[str, ...]:
    if found.models_from is not None:
        made_up = getattr(found.models, "rehearsal", None)
        words = f"the models come from {found.models_from}{f', {REHEARSAL}' if made_up else ''}"
        return (*found.notes, words)
    return (*found.notes, *([] if found.identification is None else found.identification.notes))


def _hysteretic(own: Identification, experiment: Experiment) -> tuple[results.HystereticResult, ...] | None:
    """The hysteretic runs, with the hysteresis that the config asked for; None if there are none."""
    asked = enumerate(experiment.relay.hysteretic or (), 1)
    eps_rad = {str(Stage.test(StageKind.HYSTERETIC, number)): run.eps_rad for number, run in asked}
    runs = tuple(run.model_copy(update={"eps_rad": eps_rad.get(run.stage)}) for run in own.hysteretic)
    return runs or None


def _breakaway(check: BreakawayCheck, own: Identification | None) -> results.BreakawayResult:
    """What the breakaway check saw, and what was identified from it."""
    seen = results.BreakawayResult(seen_plus_V=check.plus_V, seen_minus_V=check.minus_V, noise_rad=check.noise_rad)
    if own is None or own.breakaway is None:
        return seen
    static = own.breakaway
    return seen.model_copy(update={name: getattr(static, name) for name in type(static).model_fields})
