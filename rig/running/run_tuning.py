"""`rig tune`: the motor and the bench of a run, or of a log, the loop tuned for them, and the law for a config."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rig import config
from rig.backends.servo.models import ServoModel
from rig.config import ConfigError, Experiment
from rig.config.schema import LawSection
from rig.control.law import TUNED
from rig.control.state_feedback import Loop
from rig.core.motor_numbers import RealMotor
from rig.design.tune.margins import Margins
from rig.design.tune.prediction import Prediction, predict
from rig.design.tune.program import Room, Trial, whole_trial
from rig.design.tune.result import result_of
from rig.design.tune.servo_loop import PositionMode, ServoLoop, servo_loop
from rig.design.tune.trial import Record, Sensing
from rig.design.tune.tuning import Tuned, TuneError, Wish, motor_of, tune
from rig.design.tune.uncertain import UncertainMotor
from rig.identification.known_model import is_printed, printed
from rig.output.report import write_report
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import CONFIG, RESULT, json_text, write_whole
from rig.run_folder.recording.path_kind import require_run
from rig.run_folder.recording.reader import read_meta, read_result, read_run
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.servo_law import scale_of
from rig.run_folder.recording.stage import StageKind
from rig.run_folder.results import HoldsResult, IdentificationResult, JsonObject, RunResult, known
from rig.run_folder.results.answer_words import beyond_drive
from rig.run_folder.results.tuned import TunedResult

STEP_SHARE = 0.25  # of the travel, or of the largest speed: the step if none is asked for
TOP_SHARE = 0.9  # of limits.max_speed_rad_s: beyond the limit itself the run would end
SMALLER, TIMES = 0.6, 5  # a step of the speed that nobody asked for may be so much smaller, so often, to fit the travel
TURN_RAD = math.pi  # half the travel of a shaft without limits
LEAST_NOISE_RAD = 1e-5  # a sensor without noise and steps has at least this


@dataclass(frozen=True)
class Asked:
    """What the loop shall do; None: as ``rig tune --help`` says.

    bandwidth_1_s   rad/s
    step            rad; of a velocity loop rad/s
    phase_deg, gain_dB   margins of the worst motor
    """

    loop: Loop
    bandwidth_1_s: float | None
    step: float | None
    phase_deg: float
    gain_dB: float


@dataclass(frozen=True)
class TunedRun:
    """A loop for the motor of a run, or of a log.

    folder     of the run; the file with the answer of a log
    latency_s  that the run's device reports, from a sample to the effect of its drive, s
    holds      what the run's answer was measured over; None: not said
    made_up    the run was a rehearsal: nobody measured this motor
    """

    folder: Path
    tuned: Tuned
    trial: Trial
    prediction: Prediction
    latency_s: float
    holds: HoldsResult | None = None
    made_up: bool = False

    def options(self) -> JsonObject:
        """Of the law `tuned`, for the section `law` of a config."""
        motor, sensing, gains = self.tuned.motor, self.tuned.sensing, self.tuned.gains
        return {
            "loop": gains.loop,
            "motor": {**motor.framed.numbers},
            "observer": {
                "period_s": sensing.period_s,
                "noise_rad": sensing.whole_noise_rad,
                "latency_s": self.latency_s,
                "further_s": motor.delay_s - self.latency_s,
            },
            "gains": {"speed_1_s": gains.speed_1_s, "place_1_s2": gains.place_1_s2, "integral": gains.integral},
            "limits": {"largest_V": sensing.largest_V, "shown_rad": sensing.shown_rad},
            "program": [dict(part) for part in self.trial.parts],
        }

    def config_with_law(self, bench: Experiment) -> Experiment:
        """The config of a bench with this law: `rig run` drives it, and `rig replay` replays it."""
        lasts_s = self.trial.program().duration_s
        law = LawSection(name=TUNED, duration_s=lasts_s + bench.period_s, options=self.options())
        return bench.model_copy(update={"law": law})

    def record_of(self, folder: Path) -> Record | None:
        """The trial that a run folder recorded; None if it ended before the trial did."""
        recording = read_run(folder)
        rows = np.flatnonzero(recording.stage == str(StageKind.LAW))
        least_s = self.trial.program().duration_s - 2.0 * self.tuned.sensing.period_s
        if rows.size < 3 or recording.t_s[rows[-1]] - recording.t_s[rows[0]] < least_s:
            return None
        columns = (recording.t_s, recording.y_rad, recording.u_V, recording.yd_rad)
        return Record(*(column[rows] for column in columns))

    def result(self, bench: Record | None = None) -> TunedResult:
        """All of it; ``bench``: the trial that a bench recorded."""
        law: JsonObject = {"name": TUNED, "options": self.options()}
        found = result_of(self.tuned, self.prediction, bench, self.folder.resolve().name, law)
        largest_V = max(float(np.abs(one.u_V).max()) for one in self.prediction.records)
        beyond = beyond_drive(self.holds, largest_V)
        said = [f"the trial has {beyond}"] * bool(beyond) + of_full_drive(self.tuned.motor.framed.motor)
        return found.model_copy(update={"beyond": "; ".join(said) or None})


def of_full_drive(motor: RealMotor) -> list[str]:
    """A sentence where the motor that a loop is designed for, with tau and K, is that of the full drive alone."""
    if motor.free_between <= 0.0:
        return []
    return [
        f"gains, kV and margins are those at a drive of {motor.full_drive_V:.3g} V: the bridge lets the motor run free "
        "between its pulses, so below it K and tau are larger; `rig track` and the trial know that, a loop of your own "
        "may swing or overshoot"
    ]


class _Place(NamedTuple):
    """Where a loop is to drive: how the bench samples, the travel for its trial, and the largest speed, rad/s."""

    sensing: Sensing
    room: Room
    top_rad_s: float

    @classmethod
    def of(cls, e: Experiment, result: RunResult | None) -> _Place:
        """Of a bench. ``result``: of a run with this sensor, whose noise counts; None: only the sensor's steps do."""
        return cls(_sensing(e, result), _room(e), TOP_SHARE * e.limits.max_speed_rad_s)

    @classmethod
    def of_log(cls, path: Path, found: IdentificationResult) -> _Place:
        """As a log shows it: no drive, speed or travel beyond its own. Raises RecordingError where it does not say."""
        holds, sampled = None if found.answer is None else found.answer.holds, found.sampling
        if holds is None or not (sampled and holds.drive_V and holds.speed_rad_s and holds.travel_rad):
            raise RecordingError(
                path, "does not say how its log was sampled", "give --try CONFIG, or identify it anew with --json"
            )
        largest_V, top_rad_s = known(holds.drive_V[1]), known(holds.speed_rad_s[1])
        low_rad, high_rad = map(known, holds.travel_rad)
        period_s, noise_rad, step_rad = map(known, (sampled.period_s, sampled.noise_rad, sampled.step_rad))
        if not (min(largest_V, top_rad_s, high_rad - low_rad, period_s) > 0.0 and min(noise_rad, step_rad) >= 0.0):
            raise RecordingError(path, "says that its log had no drive, speed, travel or period", "identify it anew")
        white_rad = math.sqrt(max(noise_rad**2 - step_rad**2 / 12.0, 0.0))
        sensing = Sensing(period_s, max(white_rad, LEAST_NOISE_RAD), step_rad, largest_V)
        middle_rad, half_rad = 0.5 * (low_rad + high_rad), min(0.5 * (high_rad - low_rad), TURN_RAD)
        middle_rad = math.remainder(middle_rad, 2.0 * math.pi)  # a turn away a shaft is where it was
        return cls(sensing, Room(middle_rad - half_rad, middle_rad + half_rad), top_rad_s)


def tune_run(
    folder: Path,
    asked: Asked,
    draws: int,
    bench: Experiment | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> TunedRun:
    """Tune a loop for the motor of a run folder, or of what `rig identify --json` printed, and predict what it does.

    bench        on which it is to be driven; None: the run's own, or as the log shows it
    on_progress  is called with how many motors are simulated, and how many there are
    Raises RecordingError where the folder has no result or config, ConfigError for a config that cannot be read, and
    TuneError where no such loop is possible, or where its trial would leave the soft limits of ``bench``.
    """
    found: IdentificationResult | RunResult
    if is_printed(folder):
        found, latency_s = printed(folder), 0.0
        place = _Place.of_log(folder, found) if bench is None else _Place.of(bench, None)
    else:
        found = result = _result_of(folder)
        if bench is None and not (folder / CONFIG).exists():
            raise RecordingError(
                folder / CONFIG, "is missing: nothing says the bench's period, sensor and limits", "give --try CONFIG"
            )
        e = config.load(folder / CONFIG, follows_links=False) if bench is None else bench
        place = _Place.of(e, result if bench is None or _same_sensor(folder, bench) else None)
        latency_s = _latency_s(read_run(folder))
    answer = found.answer
    motor = motor_of(answer)
    tuned, trial = _that_fits(place, asked, motor)
    prediction = predict(tuned, trial, draws, on_progress=on_progress)
    if bench is not None:
        _require_inside(bench, prediction)
    holds = None if answer is None else answer.holds
    return TunedRun(folder, tuned, trial, prediction, min(latency_s, motor.delay_s), holds, bool(found.rehearsal))


def _result_of(folder: Path) -> RunResult:
    """The result of a run folder. Raises RecordingError without one."""
    result, _ = read_result(folder)
    if result is None:
        require_run(folder)
        raise RecordingError(folder / RESULT, "is missing", "`rig tune` reads the run folder of an identified motor")
    return result


def servo_loop_of(
    folder: Path, model: ServoModel, least: Margins, p_scale: float | None = None, supply_V: float | None = None
) -> ServoLoop:
    """The gains of a servo's own position loop for the motor of a run folder, or of what `rig identify --json` printed.

    supply_V  of the servo; None: as the run says
    least     margins that every motor of its intervals keeps
    p_scale   share of full duty that a gain of 1 makes of 1 rad, 1/rad; None: as manuals have it
    Raises RecordingError where the folder has no result, does not say its supply, or is of another servo, ConfigError
    for a config that cannot be read; TuneError as ``servo_loop``.
    """
    if is_printed(folder):
        answer = printed(folder).answer
    else:
        answer = _result_of(folder).answer
        own = config.load(folder / CONFIG, follows_links=False).daq.servo if (folder / CONFIG).exists() else None
        if own is not None and own.model != model.name:
            cure = f"type --servo {own.model}"
            raise RecordingError(folder, f"is a run of a {own.model}, not of a {model.name}", cure)
        meta, _ = read_meta(folder)
        supply_V = supply_V or (None if meta is None or meta.drive is None else meta.drive.supply_V)
    if not supply_V:
        raise RecordingError(folder, "does not say the supply: a duty is a share of it", "add --supply-V, in volts")
    return servo_loop(motor_of(answer), position_mode_of(model, p_scale), supply_V, least)


def position_mode_of(model: ServoModel, p_scale: float | None = None) -> PositionMode:
    """The position mode of a servo: what a step of P means by manuals, or as ``p_scale`` says, 1/rad."""
    P = model["position_p_gain"]
    known_P = {} if P.shipped is None else {"as shipped": P.shipped}
    scale = scale_of(model.protocol, p_scale)
    if model.protocol == "feetech":
        known_P["LeRobot"] = 16
    addresses = {register.name: register.address for register in model.registers.values()}
    return PositionMode(model.name, addresses, scale, P.most if P.high is None else P.high, known_P)


def _require_inside(bench: Experiment, prediction: Prediction) -> None:
    """Raise TuneError if a motor of the prediction leaves the soft limits: such a trial does not drive the bench."""
    low_rad, high_rad = bench.limits.soft_rad
    least_rad, most_rad = (float(f([f(one.y_rad) for one in prediction.records])) for f in (np.min, np.max))
    if not bench.limits.is_endless and not low_rad <= least_rad <= most_rad <= high_rad:
        raise TuneError(
            f"a motor within the intervals goes from {least_rad:.2f} to {most_rad:.2f} rad in the trial, beyond the "
            f"soft limits {low_rad:.2f} to {high_rad:.2f} rad",
            "give a smaller --step, or identify the motor better",
        )


def _same_sensor(folder: Path, bench: Experiment) -> bool:
    """Whether a bench reads the shaft as finely as that of the run did; yes where the run's config does not say it."""
    with contextlib.suppress(ConfigError):
        return config.load(folder / CONFIG, follows_links=False).sensor.curve.lsb_rad == bench.sensor.curve.lsb_rad
    return True


def _sensing(e: Experiment, result: RunResult | None) -> Sensing:
    """How a bench samples and drives; ``result`` as for ``_Place.of``."""
    lsb_rad = e.sensor.curve.lsb_rad
    seen = None if result is None or result.breakaway is None else result.breakaway.noise_rad
    # the noise that the breakaway check saw has the steps in it
    white_rad = math.sqrt(max((seen or 0.0) ** 2 - lsb_rad**2 / 12.0, 0.0))
    return Sensing(e.period_s, max(white_rad, LEAST_NOISE_RAD), lsb_rad, e.drive.max_V)


def _that_fits(place: _Place, asked: Asked, motor: UncertainMotor) -> tuple[Tuned, Trial]:
    """The loop and its trial; a step that nobody asked for is as large as fits. Raises TuneError."""
    sensing, room, top_rad_s = place
    least = Margins(asked.gain_dB, asked.phase_deg, 0.0)
    steps = [asked.step or STEP_SHARE * (room.high_rad - room.low_rad)]
    if asked.step is None and asked.loop == "velocity":
        steps = [STEP_SHARE * top_rad_s * SMALLER**k for k in range(TIMES)]

    def at(step: float) -> tuple[Tuned, Trial]:
        tuned = tune(motor, sensing, Wish(asked.loop, step, asked.bandwidth_1_s, least, top_rad_s))
        return tuned, whole_trial(tuned, room)

    for step in steps[:-1]:
        with contextlib.suppress(TuneError):
            return at(step)
    return at(steps[-1])


def _room(e: Experiment) -> Room:
    low, high = (-TURN_RAD, TURN_RAD) if e.limits.is_endless else e.limits.soft_rad
    sines = () if e.tracking is None else tuple((one.amplitude_rad, one.omega_rad_s) for one in e.tracking.trajectory)
    return Room(low, high, sines)


def _latency_s(recording: Recording) -> float:
    """What the device reports, from a sample to the effect of its drive, s; 0 if it does not."""
    late = recording.t_u_s - recording.t_s
    known = late[np.isfinite(late)]
    return max(float(np.median(known)), 0.0) if known.size else 0.0


def written_up(folder: Path, result: RunResult, tuned: TunedResult) -> None:
    """Write a tuned loop into the result and the report of the run that drove it. Raises CannotWriteError."""
    write_whole(folder / RESULT, json_text(result.model_copy(update={"tuned": tuned})))
    write_report(folder)
