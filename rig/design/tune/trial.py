"""A loop tried on a simulated motor, and what a record shows of it: overshoot, rise, settling, tracking error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.signal import savgol_filter

from rig.control.law import OwnLaw
from rig.control.state_feedback import Loop
from rig.core.arrays import Array
from rig.core.signals import Sample
from rig.design.tune.margins import periods_of
from rig.model.real_motor import FramedMotor, MovingMotor

BAND = 0.05  # of the step: within it the shaft has settled
SMOOTHED = {"position": 5, "velocity": 9}  # samples that a quadratic is fitted to


@dataclass(frozen=True)
class Sensing:
    """How a bench samples and drives.

    period_s   between two samples, s, > 0
    noise_rad  standard deviation of white noise of the reading, rad
    lsb_rad    step of the sensor, rad; 0: none
    largest_V  largest drive, V
    """

    period_s: float
    noise_rad: float
    lsb_rad: float
    largest_V: float

    @property
    def whole_noise_rad(self) -> float:
        """Noise and steps together, as white noise, rad."""
        return math.hypot(self.noise_rad, self.lsb_rad / math.sqrt(12.0))

    @property
    def shown_rad(self) -> float:
        """A deviation that one reading shows for certain, rad."""
        return max(self.lsb_rad, 3.0 * self.whole_noise_rad)

    @property
    def shown_rad_s(self) -> float:
        """A deviation that a smoothed speed shows for certain, rad/s."""
        half = SMOOTHED["velocity"] // 2
        # the slope of the fitted quadratic: noise over the root of the sum of the squared times
        return 3.0 * self.whole_noise_rad / (self.period_s * math.sqrt(half * (half + 1) * (2 * half + 1) / 3.0))


class Shaft(Protocol):
    """A motor in motion."""

    @property
    def reading_rad(self) -> float:
        """What an ideal sensor shows, rad."""
        ...

    def advance(self, u_V: float, t_s: float, dt_s: float) -> None:
        """Let ``dt_s`` pass from ``t_s`` on, under a constant drive."""
        ...


def shaft_of(framed: FramedMotor) -> Shaft:
    """A motor at rest at 0 rad."""
    return MovingMotor(framed.motor, framed.frame, 0.0)


class Record(NamedTuple):
    """Times, s, readings, rad, drives, V, and the reference at each sample, rad; (n,) each."""

    t_s: Array
    y_rad: Array
    u_V: Array
    yd_rad: Array


def driven(shaft: Shaft, law: OwnLaw, sensing: Sensing, delay_s: float, duration_s: float, seed: int) -> Record:
    """The law on the shaft from rest, for ``duration_s``; a drive acts ``delay_s`` after its sample.

    The bench does not report when a drive acts: the law has to know its delay.
    """
    whole, part_s = periods_of(delay_s, sensing.period_s)
    random = np.random.default_rng(seed)
    drives = [0.0] * (whole + 2)  # of this sample, of the one before, ...
    rows = []
    for tick in range(int(duration_s / sensing.period_s + 1e-9) + 1):
        t_s = tick * sensing.period_s
        y_rad = shaft.reading_rad + sensing.noise_rad * random.standard_normal()
        if sensing.lsb_rad:
            y_rad = round(y_rad / sensing.lsb_rad) * sensing.lsb_rad
        u_V = law.step(Sample(t_s, float(y_rad), 0))
        rows.append((t_s, y_rad, u_V, getattr(law, "yd_rad", math.nan)))
        drives = [u_V, *drives[:-1]]
        shaft.advance(drives[whole + 1], t_s, part_s)
        shaft.advance(drives[whole], t_s + part_s, sensing.period_s - part_s)
    return Record(*np.array(rows).T)


class StepShown(NamedTuple):
    """What a record shows of a step; the reading smoothed over 5 samples, of a speed over 9.

    overshoot_percent  beyond the set-point, % of the step, >= 0
    rise_s             from 10 % to 90 % of the step, s; nan: it did not come there
    settling_s         from the step until it stays within 5 % of it, or within what the sensor shows, s; nan: never
    """

    overshoot_percent: float
    rise_s: float
    settling_s: float


def step_shown(loop: Loop, record: Record, span_s: tuple[float, float], step: float, shown: float = 0.0) -> StepShown:
    """Measures of a step.

    span_s  begin and end of the step, s from the record's first row
    step    in rad, or rad/s of a velocity loop, with its sign
    shown   the settled band is at least so wide, rad or rad/s
    """
    elapsed = record.t_s - record.t_s[0]
    rows = np.flatnonzero((elapsed >= span_s[0] - 1e-9) & (elapsed < span_s[1] - 1e-9))
    t_s, measured = elapsed[rows] - span_s[0], smoothed(loop, record.t_s, record.y_rad)[rows]
    # of a position from where the reference stood before the step
    start = float(record.yd_rad[max(rows[0] - 1, 0)]) if loop == "position" else 0.0
    done = (measured - start) / step
    rise_s = _reached(t_s, done, 0.9) - _reached(t_s, done, 0.1)
    # smoothing mixes the last rows with what follows the step
    whole = len(rows) - SMOOTHED[loop] // 2
    outside = np.flatnonzero(np.abs(done[:whole] - 1.0) > max(BAND, shown / abs(step)))
    settling_s = 0.0
    if outside.size:
        settling_s = float(t_s[outside[-1] + 1]) if outside[-1] + 1 < whole else math.nan
    return StepShown(max(100.0 * (float(done.max()) - 1.0), 0.0), rise_s, settling_s)


def smoothed(loop: Loop, t_s: Array, y_rad: Array) -> Array:
    """Position, rad, or speed, rad/s, by a local quadratic."""
    period_s = float(np.median(np.diff(t_s)))
    found: Array = savgol_filter(
        y_rad, SMOOTHED[loop], 2, deriv=0 if loop == "position" else 1, delta=period_s, mode="interp"
    )
    return found


def _reached(t_s: Array, done: Array, level: float) -> float:
    """When ``done`` came to the level, between two rows; nan if it did not."""
    k = int(np.argmax(done >= level))
    if done[k] < level:
        return math.nan
    return float(np.interp(level, done[k - 1 : k + 1], t_s[k - 1 : k + 1])) if k else float(t_s[0])
