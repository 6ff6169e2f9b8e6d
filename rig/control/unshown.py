"""Motion that the reading does not show: how far a drive may turn the shaft unseen, and the pushes that prove a sensor.

Both count on a friction of at least half of the level at which the breakaway check saw the shaft move
(docs/theory.md 4.5).
"""

from __future__ import annotations

import math
from collections import deque

from rig.control.law import BareLaw
from rig.control.motion import Gaps, Standstill
from rig.core.faults import Fault
from rig.core.signals import Sample

STILL_S = 0.3  # as the guard's: for which a drive above friction may leave the reading where it is
FRICTION = 0.5  # of the level that moves the shaft, at least
STRONGEST = 1.4  # times that level: the guard itself watches drives above it
START = 1.55  # times that level: a relay's first drive
TO_AND_FRO = 4.0
_ROUNDING_S = 1e-9
_MEAN_OF = 3  # readings: their mean, else noise looks like motion once in some hundred standstills
_LONGER, _MOST = 2.0, 4.0  # times the longest that ended in motion, and of the first bound: as the guard's


class Flicker:
    """Finds a reading that does not change at all while the motor is driven, although it flickered at rest.

    longest_s  for which the reading may stay the same, s; inf: it need not flicker
    """

    def __init__(self, longest_s: float) -> None:
        self.longest_s = longest_s
        self._counts: int | None = None
        self._since_s = math.nan

    def step(self, sample: Sample, u_V: float) -> None:
        """Take a sample, and the drive decided on it. Raises Fault SENSOR_STUCK."""
        if self._counts is None or sample.y_counts != self._counts:
            self._counts, self._since_s = sample.y_counts, sample.t_s
        same_s = sample.t_s - self._since_s
        if same_s > self.longest_s:
            raise Fault(
                "SENSOR_STUCK",
                f"the reading has not changed at all for {same_s:.2f} s, at {u_V:+.2f} V; at rest it flickered: check "
                "the wiper's wire first",
            )
        if u_V == 0.0:
            self._counts = None


class UnshownMotion:
    """Finds a reading that stands still for so long under drives that they may have turned the shaft far.

    If friction is half of ``moves_V``, a drive u turns the shaft at up to K (|u| - moves_V/2). Over one standstill that
    may add up to as much as a start at ``START`` times ``moves_V`` gives in ``STILL_S``, drives to the other side
    taken off; and to ``TO_AND_FRO`` times as much without taking them off. Where a standstill has ended in motion the
    next may have twice what that one had, but at most four times the first bound.

    moves_V     level at which the breakaway check saw the shaft move, V, > 0
    motion_rad  a reading within this span stands still, rad, > 0
    delay_s     until a drive shows in the reading, beyond its own tick, s
    flicker     of the reading
    from_V      drives below this do not count: a shaft may stand in the midst of a cycle, V
    """

    def __init__(
        self, moves_V: float, motion_rad: float, delay_s: float, flicker: Flicker, from_V: float = 0.0
    ) -> None:
        self.moves_V = moves_V
        self.from_V = from_V
        self.motion_rad = motion_rad
        self.allowed_s = STILL_S * (START - FRICTION) + (STRONGEST - FRICTION) * delay_s  # in units of moves_V
        self.flicker = flicker
        self.standstill = Standstill()
        self._last: deque[float] = deque(maxlen=_MEAN_OF)
        self._last_s = math.nan
        self._gaps = Gaps()
        self._u_V = self._before_V = 0.0
        self._driven_s = 0.0  # in units of moves_V; > 0: towards rising positions
        self._to_and_fro_s = 0.0
        self._longest_s = 0.0

    def step(self, sample: Sample, u_V: float) -> str:
        """Take a sample, and the drive decided on it. Returns why it is too much, in words, or "".

        Raises Fault SENSOR_STUCK, as ``Flicker``.
        """
        gap_s = self._gaps.step(sample.t_s)
        self.flicker.step(sample, u_V)
        self._last.append(sample.y_rad)
        still_s = self.standstill.step(sample.t_s, sum(self._last) / len(self._last), self.motion_rad)
        if still_s == 0.0:
            self._longest_s = max(self._longest_s, abs(self._driven_s))
            self._driven_s = self._to_and_fro_s = 0.0
        elif not math.isnan(self._last_s):
            # a host that stood still may have sent its drive late: the one before acted until then
            came_late = gap_s > 0.0 and sample.t_u_s > self._last_s
            acts_s = min(sample.t_u_s, sample.t_s) if came_late else self._last_s
            self._take(self._before_V, acts_s - self._last_s)
            self._take(self._u_V, sample.t_s - acts_s)
        self._last_s, self._before_V, self._u_V = sample.t_s, self._u_V, u_V
        allowed_s = min(max(self.allowed_s, _LONGER * self._longest_s), _MOST * self.allowed_s)
        if abs(self._driven_s) <= allowed_s and self._to_and_fro_s <= TO_AND_FRO * allowed_s:
            return ""
        return (
            f"the reading stood still for {still_s:.2f} s under {abs(u_V):.2f} V; the shaft broke away at "
            f"{self.moves_V:.2f} V; {self.standstill.words()}"
        )

    def _take(self, u_V: float, time_s: float) -> None:
        """A drive has acted for a time while the reading stood still."""
        share = min(abs(u_V) / self.moves_V, STRONGEST) - FRICTION
        if abs(u_V) >= self.from_V:
            driven_s = max(share, 0.0) * time_s
            self._driven_s += math.copysign(driven_s, u_V)
            self._to_and_fro_s += driven_s


class Pushes(BareLaw):
    """Equal pushes to and fro until the reading shows that they move the shaft.

    first_V, last_V  levels, V, > 0: a pair that moves nothing is followed by one ``GROWTH`` times as strong
    push_s           length of a push, s, > 0
    motion_rad       the reading has to move by that in one push, rad, > 0
    flicker          of the reading
    way              direction of the first push, +1 or -1; 0: inward

    moved_V          level that has moved the shaft, once finished, V

    Raises Fault SENSOR_STUCK once neither push at ``last_V`` has moved the reading.
    """

    GROWTH = 1.4

    def __init__(
        self, first_V: float, last_V: float, push_s: float, motion_rad: float, flicker: Flicker, way: int = 0
    ) -> None:
        self.level_V = first_V
        self.last_V = max(first_V, last_V)
        self.push_s = push_s
        self.motion_rad = motion_rad
        self.flicker = flicker
        self.moved_V = math.nan
        self._way = way
        self._since_s = math.nan
        self._last_s = math.nan
        self._gaps = Gaps()
        self._is_second = False
        self._last: deque[float] = deque(maxlen=_MEAN_OF)
        self._standstill = Standstill()

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V. Raises Fault SENSOR_STUCK."""
        t_s = sample.t_s
        if math.isnan(self._since_s):
            self._since_s = t_s
        if self._way == 0:
            self._way = -1 if sample.y_rad > 0.0 else 1
        self._last.append(sample.y_rad)
        self._standstill.step(t_s, sum(self._last) / len(self._last), self.motion_rad)
        if self._gaps.step(t_s) > 0.0 and self._last_s == self._since_s and sample.u_V * self._way > 0.0:
            self._since_s = max(self._since_s, sample.t_u_s)  # a host that stood still may have sent the push late
        self._last_s = t_s
        if self._standstill.longest_s > 0.0:
            self.finished, self.moved_V = True, self.level_V
        elif t_s - self._since_s >= self.push_s - _ROUNDING_S:
            self._next_push(t_s)
        self.flicker.step(sample, self._way * self.level_V)
        return self._way * self.level_V

    def _next_push(self, t_s: float) -> None:
        """The push did not move the reading: push back, or more strongly."""
        if self._is_second:
            if self.level_V >= self.last_V:
                raise Fault(
                    "SENSOR_STUCK",
                    f"pushes of {self.level_V:.2f} V, {self.push_s:.2f} s to either side, did not move the reading by "
                    f"{1e3 * self.motion_rad:.0f} mrad; {self._standstill.words()}",
                )
            self.level_V = min(self.GROWTH * self.level_V, self.last_V)
        self._is_second, self._way, self._since_s = not self._is_second, -self._way, t_s
        self._standstill.restart()
        self._last.clear()
