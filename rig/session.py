"""One run on the bench, recorded: whatever ends it, the drive is stopped, and record, result and report are kept."""

from __future__ import annotations

import math
import platform
import sys
import traceback
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import rig
from rig.bench import Bench, connect, guard_settings_of
from rig.config import Experiment, dump, notes
from rig.config.link_budget import times_error_s
from rig.config.room_to_stop import device_watchdog_s
from rig.control.breakaway import BreakawayLaw
from rig.control.excitation import GainSearch
from rig.control.guard import Guard
from rig.control.tracking import tracking_error
from rig.faults import Fault, since_the_last_run
from rig.identify import Identification, IdentifyError, identify
from rig.loop.real_time import RealTime
from rig.loop.runner import STOPPING, Loop
from rig.loop.stop_request import StopRequest, stop_on_signals
from rig.model.supply import SupplyReading
from rig.recording.errors import RecordingError
from rig.recording.folder import create_run, write_config, write_meta, write_result
from rig.recording.reader import Recording, read_run
from rig.recording.record import Record
from rig.recording.recorder import Recorder
from rig.recording.stage import Stage, StageKind
from rig.report import write_report
from rig.report.words import NOTHING_TO_IDENTIFY

FADE_S = 1.5  # of the tracking reference; errors count after it
_LONG_GAP_S = 0.1  # between two readings of a device that latches no e-stop


@dataclass
class Outcome:
    """What a run came to: its folder, its result.json, the fault that ended it, and what else failed."""

    folder: Path
    result: dict[str, Any]
    fault: Fault | None = None
    failures: list[str] = field(default_factory=list)

    @property
    def failure(self) -> str:
        """Why the run is not a success, in words; empty if it is."""
        why = ([] if self.fault is None else [str(self.fault)]) + self.failures
        estimates = self.result.get("estimates", {})
        # least squares is what the run was for where it had no other relay test
        for method in ("sampled-data", *(() if self.result.get("relays") else ("least-squares",))):
            estimate = estimates.get(method)
            if not why and estimate is not None and estimate["verdict"] == "refused":
                why.append(f"the {method} estimate was refused: " + "; ".join(estimate["reasons"]))
        return "; ".join(why)

    def as_json(self) -> dict[str, Any]:
        """What `--json` prints: result.json, where it is, whether all is well, and if not why and what to do."""
        said = (
            {} if not self.failure else {"cause": self.failure, "cure": "" if self.fault is None else self.fault.cure}
        )
        return {"ok": not self.failure, "folder": str(self.folder), **said, **self.result}


@dataclass
class Session:
    """One run in progress: the open bench, the loop on it, and what is known so far."""

    experiment: Experiment
    folder: Path
    bench: Bench
    recorder: Record
    loop: Loop
    meta: dict[str, Any]
    real_time: RealTime | None = None  # what the machine granted the loop, once it was asked
    breakaway: BreakawayLaw | None = None
    search: GainSearch | None = None
    identification: Identification | None = None
    recording: Recording | None = None  # the rows as they were last read
    models_from: Path | None = None  # the run that identified them, where it is another
    jog: dict[str, float] | None = None
    notes: list[str] = field(default_factory=list)
    tracking: dict[str, dict[str, Any]] = field(default_factory=dict)

    def read(self) -> Recording:
        """The rows so far; those that were read before are not parsed again. Raises RecordingError."""
        self.recording = read_run(self.folder, self.recording)
        return self.recording

    def note(self, kind: str, **fields: str | float | int | bool) -> None:
        """An event of now."""
        self.recorder.event(self.loop.now_s, kind, **fields)


Script = Callable[[Session], None]
OnStart = Callable[[Path, tuple[str, ...]], None]  # told of the run folder, and of what the device had latched


def record(
    experiment: Experiment,
    parent: Path,
    what: dict[str, str | float],
    script: Script,
    on_start: OnStart | None,
    again: Bench | None = None,
) -> Outcome:
    """Run ``script`` on the bench, recorded; whatever ends it, the drive is stopped and the record kept.

    ``what`` names the script in meta.json, with its arguments, so that it can be replayed. ``again`` is a bench that
    the same command has opened already, and closes.
    result.json is written before signals get their usual meaning back: a second Ctrl-C costs the report, no more.
    Raises Fault where the bench cannot be opened, RecordingError where there can be no run folder.
    """
    started = datetime.now(UTC)
    session: Session | None = None
    fault: Fault | None = None
    failures: list[str] = []
    with stop_on_signals() as stop:
        try:
            with connect(experiment) if again is None else nullcontext(again) as bench:
                session, recorder = _begin(experiment, parent, what, bench, stop, started)
                try:
                    fault = _run_script(script, session, on_start)
                finally:
                    lost = _close(recorder)
                    fault = fault or lost
        except Exception as error:
            if session is None:
                raise
            failures.append(f"the bench was not closed well: {_defect(error)}")
        outcome = Outcome(session.folder, {}, fault, failures)
        _measure_tracking(session, outcome)
        _write_result(session, outcome)
        if stop.reason is not None and fault is None:
            outcome.failures.append(f"{stop.reason} came when the experiment had ended")
    return _conclude(session, outcome)


def _begin(
    experiment: Experiment,
    parent: Path,
    what: dict[str, str | float],
    bench: Bench,
    stop: StopRequest,
    started: datetime,
) -> tuple[Session, Recorder]:
    """The run folder, its recorder and the loop."""
    folder = create_run(parent, f"{what['name']}-{experiment.name}", started)
    write_config(folder, dump(experiment))
    meta = _meta(experiment, bench, started) | {"script": what}
    write_meta(folder, meta)
    guard = Guard(guard_settings_of(experiment))
    recorder = Recorder(folder, _stages(experiment))
    loop = Loop(bench.driver, bench.clock, guard, recorder, experiment.period_s, stop)
    said = [since_the_last_run(code) for code in bench.info.acknowledged]
    supply = _supply(experiment, bench).objection
    said += [] if supply is None else [supply]
    return Session(experiment, folder, bench, recorder, loop, meta, notes=said), recorder


def _run_script(script: Script, session: Session, on_start: OnStart | None) -> Fault | None:
    """Run the script to its end; the fault that ended it, if one did."""
    fault: Fault | None = None
    try:
        if on_start is not None:
            on_start(session.folder, tuple(session.notes))
        script(session)
        session.loop.check_stop()
    except Fault as seen:
        fault = seen
    except (IdentifyError, RecordingError) as error:
        fault = Fault("NOT_IDENTIFIED", f"{error.cause}; {error.cure}")
    except Exception as error:  # noqa: BLE001 - whatever it is, the run ends with its record and a result
        fault = Fault("INTERNAL", f"{type(error).__name__}: {error}")
        session.note("traceback", text="".join(traceback.format_exception(error))[-2000:])
    finally:
        session.loop.close()
    if fault is not None:
        session.note("fault", **fault.as_dict())
    braked = session.loop.guard.braked_ticks
    if braked:
        session.notes.append(
            f"the guard braked in {braked} ticks: for this motion the limits leave too little room to stop"
        )
    if session.loop.unconfirmed_stops:
        session.notes.append("the device did not confirm the stop: its watchdog sets 0 V; see that the shaft stands")
    gap_s = session.loop.pause_watch.longest_gap_s
    if gap_s > _LONG_GAP_S:
        session.notes.append(
            f"in a pause the device was not asked for {1e3 * gap_s:.0f} ms: an e-stop opened for less may have passed "
            "unseen; wire the e-stop so that it cuts the motor's supply"
        )
    session.note("end")
    return fault


def _close(recorder: Recorder) -> Fault | None:
    """Close the record; the fault, where rows could not be written."""
    try:
        recorder.close()
    except Fault as lost:
        return lost
    except Exception as error:  # noqa: BLE001 - what was recorded is there, and gets its result
        return Fault("INTERNAL", f"closing the record: {type(error).__name__}: {error}")
    return None


def _conclude(session: Session, outcome: Outcome) -> Outcome:
    """Identify what a fault has left, complete result.json, write the report, say what failed."""
    if session.identification is None:
        try:
            recording = session.read()
            if any(Stage.parse(stage).is_relay_test for stage in recording.stages()):
                session.identification = identify([recording])
        except (IdentifyError, RecordingError) as error:
            session.notes.append(f"{NOTHING_TO_IDENTIFY}: {error.cause}")
        except Exception as error:  # noqa: BLE001 - the result that is written already stays, and says so
            outcome.failures.append(f"the record was not identified: {_defect(error)}")
        _write_result(session, outcome)
    try:
        write_report(session.folder, session.identification, session.recording)
    except RecordingError as error:
        outcome.failures.append(f"{error.path.name} {error.cause}; {error.cure}")
    except OSError as error:
        outcome.failures.append(f"no report: {error}")
    except Exception as error:  # noqa: BLE001 - record and result are there
        outcome.failures.append(f"no report: {_defect(error)}")
    return outcome


def _defect(error: Exception) -> str:
    return f"{type(error).__name__}: {error}; please report this with the run folder"


def _write_result(session: Session, outcome: Outcome) -> None:
    try:
        outcome.result = _result(session, outcome.fault)
    except Exception as error:  # noqa: BLE001 - a result that says why is better than none
        outcome.failures.append(f"the result is incomplete: {_defect(error)}")
        outcome.result = _least_result(session, outcome)
    try:
        write_result(session.folder, outcome.result)
    except RecordingError as error:
        outcome.failures.append(f"{error.path.name} {error.cause}; {error.cure}")


def _least_result(session: Session, outcome: Outcome) -> dict[str, Any]:
    """What can always be said."""
    return {
        "schema": 1,
        "backend": session.bench.driver.backend,
        "relays": [],
        "estimates": {},
        "tracking": {},
        "loop": session.loop.statistics.summary(),
        "link": {},
        "faults": [] if outcome.fault is None else [outcome.fault.as_dict()],
        "notes": [*session.notes, *outcome.failures],
    }


def _measure_tracking(session: Session, outcome: Outcome) -> None:
    """Errors of the tracking runs that came to their end."""
    finished = [method for method, entry in session.tracking.items() if not entry]
    for method in finished:
        try:
            recording = session.read()
            rows = recording.stage_rows(str(Stage.track(method)))
            rms_rad, max_rad = tracking_error(
                recording.t_s[rows], recording.y_rad[rows], recording.yd_rad[rows], after_s=FADE_S
            )
        except Exception as error:  # noqa: BLE001 - whatever it is, the run has its result
            words = error.cause if isinstance(error, RecordingError) else _defect(error)
            session.tracking[method] = {"not_run": f"it ran, but its record cannot be read: {words}"}
            outcome.failures.append(f"no tracking error of {method}: {words}")
        else:
            session.tracking[method] = {"rms_rad": rms_rad, "max_rad": max_rad}


def _result(session: Session, fault: Fault | None) -> dict[str, Any]:
    identification, check, search = session.identification, session.breakaway, session.search
    result: dict[str, Any] = {
        "schema": 1,
        "backend": session.bench.driver.backend,
        "relays": [] if identification is None else identification.relays,
        "estimates": {}
        if identification is None
        else {method: estimate.as_dict() for method, estimate in identification.estimates.items()},
        "tracking": session.tracking,
        "loop": session.loop.statistics.summary()
        | ({} if session.real_time is None else {"real_time": asdict(session.real_time)}),
        "link": dict(session.bench.driver.link_statistics),
        "faults": [] if fault is None else [fault.as_dict()],
        "config_notes": list(notes(session.experiment)),
        "notes": [*session.notes, *([] if identification is None else identification.notes)],
    }
    eps_rad = {
        str(Stage.hysteretic(k)): run.eps_rad for k, run in enumerate(session.experiment.relay.hysteretic or (), 1)
    }
    if identification is not None and identification.hysteretic:
        result["hysteretic"] = [run | {"eps_rad": eps_rad.get(run["stage"])} for run in identification.hysteretic]
    if session.models_from is not None:
        # rows, relays and notes of another run would be taken for this one's
        result.pop("hysteretic", None)
        result |= {"relays": [], "notes": [*session.notes, f"models are those of {session.models_from}"]}
        result["models_from"] = str(session.models_from)
        result["estimates"] = {method: {**e, "rows": None} for method, e in result["estimates"].items()}
    if check is not None:
        result["breakaway"] = {"seen_plus_V": check.plus_V, "seen_minus_V": check.minus_V, "noise_rad": check.noise_rad}
        if identification is not None and identification.breakaway is not None and session.models_from is None:
            result["breakaway"] |= identification.breakaway
    if identification is not None and identification.friction_law is not None and session.models_from is None:
        result["friction_law"] = identification.friction_law.as_dict()
    if session.jog is not None and "to_rad" in session.jog:
        result["jog"] = session.jog
    if search is not None:
        result["search"] = [step._asdict() for step in search.steps]
    truth = _truth(session.bench)
    if truth is not None:
        result["truth"] = truth
    return result


def _truth(bench: Bench) -> dict[str, float] | None:
    """The emulated motor's parameters, as an estimate would name them.

    With viscous friction tau_s and K_rad_s_V are those that the motion shows; what they are without it is beside them.
    """
    if bench.truth is None:
        return None
    motor = bench.truth.motor
    truth = {
        "tau_s": motor.tau_eff_s,
        "K_rad_s_V": motor.K_eff_rad_s_V,
        "fc_V": motor.friction.fc_V,
        "asym_V": motor.asym_V,
        "static_plus_V": motor.friction.static_plus_V - motor.bias_V,
        "static_minus_V": motor.friction.static_minus_V + motor.bias_V,
    }
    if motor.friction.stribeck_rad_s > 0.0:
        truth["stribeck_rad_s"] = motor.friction.stribeck_rad_s
    if motor.friction.viscous_V_s_rad > 0.0:
        truth["viscous_V_s_rad"] = motor.friction.viscous_V_s_rad
        truth["tau_without_viscous_s"] = motor.tau_s
        truth["K_without_viscous_rad_s_V"] = motor.K_rad_s_V
    return truth


def _meta(experiment: Experiment, bench: Bench, started: datetime) -> dict[str, Any]:
    watchdog_s = device_watchdog_s(experiment)
    return {
        "schema": 1,
        "name": experiment.name,
        "backend": bench.driver.backend,
        "emulated": bench.info.emulated,
        "order": bench.driver.order,
        "period_s": experiment.period_s,
        "drive_units": bench.info.drive_units,
        "times_error_s": times_error_s(experiment),
        "firmware": {
            "board": bench.info.board,
            "build": bench.info.build,
            "reset_cause": bench.info.reset_cause,
            "clock_ratio": bench.info.clock_ratio,
            **(
                {}
                if math.isnan(bench.info.supply_V)
                else {"supply_V": bench.info.supply_V, "supply_at_least": bench.info.supply_at_least}
            ),
        },
        "drive": {"supply_V": experiment.drive.supply_V, "bridge_drop_V": experiment.drive.bridge_drop_V},
        "failsafe": "none: the device holds its last drive"
        if bench.driver.failsafe is None or watchdog_s is None
        else f"device watchdog, {watchdog_s * 1e3:.0f} ms",
        "started_utc": started.isoformat(timespec="milliseconds"),
        "versions": {"rig": rig.__version__, "python": platform.python_version()},
        "host": {"system": platform.platform(), "machine": platform.machine()},
        "command": " ".join(sys.argv),
        "truth": _truth(bench),
    }


def _supply(experiment: Experiment, bench: Bench) -> SupplyReading:
    """The motor supply as the device measures it, against the config's."""
    info, drive = bench.info, experiment.drive
    return SupplyReading(info.supply_V, info.supply_at_least, drive.supply_V, drive.bridge_drop_V)


def _stages(experiment: Experiment) -> list[str]:
    """Every stage that a run can record."""
    relays = [str(Stage.relay(number)) for number in range(1, 5)]
    if experiment.relay.hysteretic is not None:
        runs = range(1, len(experiment.relay.hysteretic) + 1)
        relays += [str(StageKind.HOMING), *(str(Stage.hysteretic(number)) for number in runs)]
    tracks = [] if experiment.tracking is None else [str(Stage.track(method)) for method in experiment.tracking.methods]
    return ["rest", "jog", "breakaway", "search", *relays, *tracks, STOPPING]
