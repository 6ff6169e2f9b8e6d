"""A motor driven on this machine: the exact model, a sensor that is noisy and coarse, a law or any drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig.control.law import OwnLaw
from rig.core.signals import Sample
from rig.model.motor import Motor, MovingPlainMotor
from rig.model.real_motor import Frame, MovingMotor, RealMotor
from rig.run_folder.recording.recording import MIN_ROWS, Recording, from_columns

# A drive: a law; volts over time, as a function of s; volts, one a sample; or constant volts.
Drive = OwnLaw | Callable[[float], float] | Sequence[float] | NDArray[np.float64] | float
SOURCE = Path("simulation")


@dataclass(frozen=True)
class Sampling:
    """How a simulated motor is watched and driven.

    period_s        between two samples, s, > 0
    delay_s         from a sample until its drive acts, s, at least 0 and less than ``period_s``
    noise_rad       standard deviation of white noise on the position, rad, at least 0
    resolution_rad  step of the sensor, rad, at least 0; 0: it has none
    start_rad       position at the start, rad
    seed            of the noise
    Raises ValueError outside these ranges.
    """

    period_s: float = 0.01
    delay_s: float = 0.001
    noise_rad: float = 0.0
    resolution_rad: float = 0.0
    start_rad: float = 0.0
    seed: int = 1

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period_s) and 0.0 <= self.delay_s < self.period_s):
            raise ValueError("period_s must be > 0, and delay_s from 0 to less than period_s")
        if not (self.noise_rad >= 0.0 and self.resolution_rad >= 0.0 and math.isfinite(self.start_rad)):
            raise ValueError("noise_rad and resolution_rad must be at least 0, and start_rad finite")


def simulate(
    motor: Motor | RealMotor,
    drive: Drive,
    duration_s: float,
    sampling: Sampling | None = None,
    frame: Frame | None = None,
) -> Recording:
    """Drive a motor, and record it as a bench would.

    motor       one with parts has a ``delay_s`` of 0: ``sampling`` says how late a drive acts
    drive       a law; a function of the time in s that gives volts; volts, one for each sample; or constant volts
    duration_s  how long, s, at least three samples; it ends before where the law says ``finished``, or with the
                volts' last
    sampling    default: ``Sampling()``
    frame       what the parts of a real motor refer to; default: pi to both sides of 0, and the duration
    Returns the rows t_s, y_rad, u_V, and t_u_s, from which u acts. What the law raises goes through. Raises ValueError
    where there would be fewer than three samples, or a drive is no number.
    """
    s = Sampling() if sampling is None else sampling
    ticks = int(duration_s / s.period_s + 1e-9) if math.isfinite(duration_s) else 0
    if isinstance(drive, Sequence | np.ndarray):
        ticks = min(ticks, len(drive))
    if ticks < MIN_ROWS:
        raise ValueError(f"{duration_s} s of samples every {s.period_s} s are too few: {MIN_ROWS} at least")
    shaft = _shaft(motor, s, Frame(duration_s=duration_s) if frame is None else frame)
    random = np.random.default_rng(s.seed)
    acting_V = 0.0
    rows: list[tuple[float, float, float]] = []
    for tick in range(ticks):
        t_s = tick * s.period_s
        sample = _sampled(shaft.reading_rad, t_s, acting_V, s, random)
        u_V = _asked(drive, tick, sample)
        if not math.isfinite(u_V):
            raise ValueError(f"the drive at {t_s:g} s is {u_V}, which is no number of volts")
        rows.append((t_s, sample.y_rad, u_V))
        shaft.advance(acting_V, t_s, s.delay_s)
        acting_V = u_V
        shaft.advance(acting_V, t_s + s.delay_s, s.period_s - s.delay_s)
        if getattr(drive, "finished", False) and len(rows) >= MIN_ROWS:
            break
    t, y, u = np.array(rows).T
    return from_columns(SOURCE, t, u, y, t_u_s=t + s.delay_s)


def _shaft(motor: Motor | RealMotor, s: Sampling, frame: Frame) -> MovingPlainMotor | MovingMotor:
    """The motor at its start, at rest."""
    if isinstance(motor, Motor):
        return MovingPlainMotor(motor, s.start_rad)
    if motor.delay_s != 0.0:
        raise ValueError("a simulated motor's delay_s must be 0: sampling.delay_s says how late its drive acts")
    return MovingMotor(motor, frame, s.start_rad)


def _sampled(shown_rad: float, t_s: float, acting_V: float, s: Sampling, random: np.random.Generator) -> Sample:
    """What the sensor shows."""
    y_rad, counts = shown_rad + s.noise_rad * random.standard_normal(), 0
    if s.resolution_rad:
        counts = round(y_rad / s.resolution_rad)
        y_rad = counts * s.resolution_rad
    t_u_s = t_s - s.period_s + s.delay_s if t_s else math.nan
    return Sample(t_s, float(y_rad), counts, t_u_s=t_u_s, u_V=acting_V)


def _asked(drive: Drive, tick: int, sample: Sample) -> float:
    """The drive for one sample, V."""
    if hasattr(drive, "step"):
        return float(drive.step(sample))
    if isinstance(drive, Sequence | np.ndarray):
        return float(drive[tick])
    return float(drive(sample.t_s) if callable(drive) else drive)
