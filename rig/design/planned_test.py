"""The tests that a design can plan, what one may use of the bench, and what is expected of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rig.control.strokes import Stroke


@dataclass(frozen=True)
class Room:
    """The limits of a planned test.

    low_rad, high_rad   positions that the shaft keeps within, rad, low < 0 < high: inside the soft limits
    max_V               largest drive, V, > 0
    max_speed_rad_s     largest speed, rad/s, > 0
    static_V            level that the shaft breaks away at, V, >= 0
    stop_rad            (low, high), rad: the guard brakes when it predicts a stop beyond them; default: it never does
    horizon_s           time at its present speed until the shaft has stopped, as the guard counts it, s, >= 0
    Raises ValueError outside these ranges.
    """

    low_rad: float
    high_rad: float
    max_V: float
    max_speed_rad_s: float
    static_V: float = 0.0
    stop_rad: tuple[float, float] = (-math.inf, math.inf)
    horizon_s: float = 0.0

    def __post_init__(self) -> None:
        if not (self.low_rad < 0.0 < self.high_rad and self.stop_rad[0] < 0.0 < self.stop_rad[1]):
            raise ValueError("the room of a test must lie on both sides of 0 rad")
        if not (min(self.max_V, self.max_speed_rad_s) > 0.0 and min(self.static_V, self.horizon_s) >= 0.0):
            raise ValueError("need max_V, max_speed_rad_s > 0 and static_V, horizon_s >= 0")

    @property
    def is_endless(self) -> bool:
        """Whether the guard never brakes for the position."""
        return math.isinf(self.stop_rad[0]) and math.isinf(self.stop_rad[1])


@dataclass(frozen=True)
class Reading:
    """How the bench is read.

    period_s    between two samples, s, > 0
    noise_rad   standard deviation of one reading, rad, >= 0
    lsb_rad     step of the reading, rad, >= 0; one of both > 0
    latency_s   from a sample until its drive acts, as the device says, s, >= 0
    Raises ValueError outside these ranges.
    """

    period_s: float
    noise_rad: float
    lsb_rad: float = 0.0
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        if not (self.period_s > 0.0 and min(self.noise_rad, self.lsb_rad, self.latency_s) >= 0.0):
            raise ValueError("need period_s > 0 and noise_rad, lsb_rad, latency_s >= 0")
        if not self.noise_rad2 > 0.0:
            raise ValueError("no test can be designed for a reading without noise or step")

    @property
    def noise_rad2(self) -> float:
        """Variance of one reading, its step included, rad^2."""
        return self.noise_rad**2 + self.lsb_rad**2 / 12.0


@dataclass(frozen=True)
class RelayGains:
    """A relay test at these gains, V."""

    h1_V: float
    h2_V: float


@dataclass(frozen=True)
class Strokes:
    """A stroke test: its strokes, and the longest that one of them can take, s, by what is known of the motor."""

    strokes: tuple[Stroke, ...]
    longest_stroke_s: float


PlannedTest = RelayGains | Strokes


@dataclass(frozen=True)
class Reach:
    """How far a test can go, whatever of the possible motors it is: positions, rad, and largest speed, rad/s."""

    low_rad: float
    high_rad: float
    speed_rad_s: float


@dataclass(frozen=True)
class Design:
    """A planned test, and what it should bring.

    test       what to drive
    seconds    from its begin until the wanted interval, s
    percent    the largest half width of the 95 % intervals of tau, K and f_c by then, % of the value
    reach      of the shaft
    """

    test: PlannedTest
    seconds: float
    percent: float
    reach: Reach
