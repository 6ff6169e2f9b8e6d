"""What a tuned loop will do on motors that the tests allow: each measure with the interval of a next motor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from rig.control.state_feedback import Loop
from rig.core.arrays import Array
from rig.design.tune.program import Trial
from rig.design.tune.trial import Record, driven, shaft_of, smoothed, step_shown
from rig.design.tune.tuning import Tuned

DRAWS = 79  # motors; the outermost one at each end is left out: a next motor is inside in 76 of 80 cases
OUTSIDE = 0.025  # share of motors at each end
LEAST_DRAWS = 39
# by name: meaning, and the unit of a position and of a velocity loop
MEASURES: Final[dict[str, tuple[str, str, str]]] = {
    "overshoot_percent": ("overshoot of the step", "%", "%"),
    "rise_s": ("rise, 10 to 90 %", "s", "s"),
    "settling_s": ("settling, within 5 %", "s", "s"),
    "tracking_rms": ("RMS error of the tracking", "rad", "rad/s"),
}


class Range(NamedTuple):
    """Median over the drawn motors, and the interval that holds a next one's value in 95 %.

    inf: a motor never came there
    """

    median: float
    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Whether a value is inside, ends included; nan: it never came there."""
        came = math.inf if math.isnan(value) else value
        return self.low - 1e-9 <= came <= self.high + 1e-9


@dataclass(frozen=True)
class Prediction:
    """A trial on each drawn motor.

    records  one for each motor
    ranges   by the name of the measure
    """

    trial: Trial
    records: tuple[Record, ...]
    ranges: dict[str, Range]

    @property
    def overshoot(self) -> Range:
        """Of the step, %."""
        return self.ranges["overshoot_percent"]


def predict(
    tuned: Tuned, trial: Trial, draws: int = DRAWS, seed: int = 1, on_progress: Callable[[int, int], None] | None = None
) -> Prediction:
    """The trial on ``draws`` (>= 39) motors drawn from the intervals, each with noise of its own.

    on_progress  is called with how many motors are simulated, and how many there are
    Raises ValueError for fewer motors: their whole range would hold less than 95 %.
    """
    if draws < LEAST_DRAWS:
        raise ValueError(f"{draws} motors are too few: the whole range of {LEAST_DRAWS} holds a next one in 95 %")
    records = []
    for k, (framed, delay_s) in enumerate(tuned.motor.drawn(draws, np.random.default_rng(seed))):
        program = trial.program()
        law = tuned.law(program)
        records.append(driven(shaft_of(framed), law, tuned.sensing, delay_s, program.duration_s, 1000 * seed + k))
        if on_progress is not None:
            on_progress(k + 1, draws)
    each = [shown_of(tuned, record, trial) for record in records]
    return Prediction(trial, tuple(records), {name: _range([one[name] for one in each]) for name in MEASURES})


def shown_of(tuned: Tuned, record: Record, trial: Trial) -> dict[str, float]:
    """The measures of a recorded trial, simulated or of a bench, by the names of ``MEASURES``."""
    loop = tuned.wish.loop
    shown = tuned.sensing.shown_rad if loop == "position" else tuned.sensing.shown_rad_s
    step = step_shown(loop, record, trial.step_s, tuned.wish.step, shown)
    return step._asdict() | {"tracking_rms": _tracking_rms(loop, record, trial)}


def speed_of(record: Record, trial: Trial) -> Array:
    """The reference's speed at each row, rad/s."""
    program = trial.program()
    program.start_rad = float(record.yd_rad[0])
    return np.array([program.at(t).v_rad_s for t in (record.t_s - record.t_s[0]).tolist()])


def _tracking_rms(loop: Loop, record: Record, trial: Trial) -> float:
    """RMS of the reference less what is measured over the trajectory; nan without one."""
    if trial.tracking_s is None:
        return math.nan
    elapsed = record.t_s - record.t_s[0]
    rows = (elapsed >= trial.tracking_s[0]) & (elapsed <= trial.tracking_s[1])
    if np.count_nonzero(rows) < 3:
        return math.nan
    if loop == "position":
        error = record.yd_rad - record.y_rad
    else:
        error = speed_of(record, trial) - smoothed(loop, record.t_s, record.y_rad)
    return float(np.sqrt(np.mean(error[rows] ** 2)))


def _range(values: list[float]) -> Range:
    """The median, and the order statistics that leave out ``OUTSIDE`` at each end."""
    some = np.sort(np.nan_to_num(np.array(values), nan=np.inf))
    k = int(OUTSIDE * (len(some) + 1) + 1e-9)
    return Range(float(some[len(some) // 2]), float(some[k - 1]), float(some[-k]))
