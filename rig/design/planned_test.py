"""The tests that a design can plan, and what it expects of one."""

from __future__ import annotations

from dataclasses import dataclass

from rig.control.strokes import Stroke


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
