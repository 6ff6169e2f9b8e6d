"""Homing: careful strokes that bring the shaft to rest at zero, where a test has to start."""

from __future__ import annotations

import math
from collections import deque
from statistics import fmean

from rig.control.breakaway import BreakawayFound, turns
from rig.control.law import BareLaw
from rig.core.faults import Fault
from rig.core.signals import Sample


class Homing(BareLaw):
    """Wait until the shaft stands. If it does not stand at zero, give it a stroke towards zero, and wait again.

    A stroke is a constant drive a little above the breakaway level. In a short stroke the shaft travels a distance that
    grows with the square of time. So each stroke shows how long the next one should be. If the shaft did not move, the
    next stroke is stronger. A stroke over a long distance ends early, with a quarter of it left. Needs no motor model.

    found          result of the breakaway check
    max_V          largest drive, V
    tolerance_rad  largest mean position that counts as zero
    period_s       period of the loop
    timeout_s      longest homing; Fault NOT_HOME if it passes first

    Results: ``strokes``, the number of strokes; ``rest_rad``, the mean position at which the shaft last stood.
    Raises ValueError for levels or a tolerance that are not > 0.
    """

    LOOK_S = 0.2  # time for which the shaft has to stand still
    SHORTEST_TICKS = 1
    FIRST_TICKS = 3
    ABOVE_BREAKAWAY = 1.15

    def __init__(
        self, found: BreakawayFound, max_V: float, tolerance_rad: float, period_s: float, timeout_s: float
    ) -> None:
        if not (found.plus_V > 0.0 and found.minus_V > 0.0 and tolerance_rad > 0.0):
            raise ValueError("homing needs breakaway levels > 0 V and a tolerance > 0 rad")
        self.noise_rad = found.noise_rad
        self.tolerance_rad = tolerance_rad
        self.timeout_s = timeout_s
        self.strokes = 0
        self.rest_rad = math.nan
        self._max_V = max_V
        self._breakaway_V = {1: found.plus_V, -1: found.minus_V}
        self._above = {1: self.ABOVE_BREAKAWAY, -1: self.ABOVE_BREAKAWAY}
        self._reach_rad = {1: math.nan, -1: math.nan}  # displacement of a stroke of one tick, as measured
        self._window: deque[float] = deque(maxlen=max(8, 2 * round(0.5 * self.LOOK_S / period_s)))
        self._direction = 0  # 0: looking
        self._ticks = 0  # planned ticks of the stroke
        self._gone = 0  # its ticks so far
        self._period_s = period_s
        self._last_s = math.nan

    def step(self, sample: Sample) -> float:
        """Drive of a stroke, V; 0 V while looking."""
        if self._elapsed_s(sample) > self.timeout_s:
            raise Fault(
                "NOT_HOME",
                f"{self.strokes} strokes in {self.timeout_s:.0f} s, last position {1e3 * sample.y_rad:+.1f} mrad; "
                f"wanted within {1e3 * self.tolerance_rad:.1f} mrad",
            )
        if self._direction == 0:
            self._look(sample.y_rad)
        else:
            self._stroke(sample)
        self._last_s = sample.t_s
        return self._drive_V()

    def _drive_V(self) -> float:
        way = self._direction
        return way * min(self._above[way] * self._breakaway_V[way], self._max_V) if way else 0.0

    def _look(self, y_rad: float) -> None:
        self._window.append(y_rad)
        if len(self._window) < (self._window.maxlen or 0) or turns(
            list(self._window), 0.5 * self.tolerance_rad, self.noise_rad
        ):
            return
        before_rad, self.rest_rad = self.rest_rad, fmean(self._window)
        if abs(self.rest_rad) <= self.tolerance_rad:
            self.finished = True
            return
        way = -1 if self.rest_rad > 0.0 else 1
        self._learn(before_rad)
        self._ticks = self._plan(way)
        self._gone = 0
        self._direction = way
        self.strokes += 1

    def _learn(self, before_rad: float) -> None:
        """Learn from the last stroke: how far a stroke of one tick would go, and whether its drive was right."""
        if self._gone == 0:
            return
        way = -1 if before_rad > 0.0 else 1
        moved = (self.rest_rad - before_rad) * way
        if moved < max(0.5 * self.tolerance_rad, 2.0 * self.noise_rad * math.sqrt(2.0 / len(self._window))):
            if self._gone > self.FIRST_TICKS:  # a shorter stroke may have been too short to move it
                self._above[way] = min(1.1 * self._above[way], self._max_V / self._breakaway_V[way])
                self._reach_rad[way] = math.nan
            else:
                self._reach_rad[way] = self.tolerance_rad / (2.0 * self._gone) ** 2
            return
        self._reach_rad[way] = moved / self._gone**2
        if self._gone == self.SHORTEST_TICKS and moved > abs(before_rad) + self.tolerance_rad:
            self._above[way] = max(
                1.02, 0.95 * self._above[way]
            )  # the shortest stroke went too far: next time a weaker one

    def _plan(self, way: int) -> int:
        """Ticks of the next stroke."""
        reach = self._reach_rad[way]
        if math.isnan(reach):
            other = self._reach_rad[-way]
            if math.isnan(other):
                return self.FIRST_TICKS if abs(self.rest_rad) < 20.0 * self.tolerance_rad else 4 * self.FIRST_TICKS
            reach = other
        return max(self.SHORTEST_TICKS, math.floor(math.sqrt(abs(self.rest_rad) / reach)))

    def _stroke(self, sample: Sample) -> None:
        # a host that stood still has made it longer, unless it sent its drive only after that
        acted_s = sample.t_s - (max(sample.t_u_s, self._last_s) if sample.t_u_s <= sample.t_s else self._last_s)
        self._gone += max(round(acted_s / self._period_s), 1)
        left = -sample.y_rad * self._direction
        near = left < 0.25 * abs(self.rest_rad) and abs(self.rest_rad) > 5.0 * self.tolerance_rad
        if self._gone >= self._ticks or near:
            self._direction = 0
            self._window.clear()
