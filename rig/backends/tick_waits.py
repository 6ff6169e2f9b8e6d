"""How long the exchanges of a tick may wait: what preflight counts into the room to stop, and no more. Pure.

The loop keeps to its grid: a tick whose exchanges took longer than a period makes the next one later by whole periods,
but by no more than they took. So what late ticks take, and what the last one does, is all that a drive comes late.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

REACTS_TICKS: Final = 3  # that a loop needs: one until it reads the motion, two by which its velocity lags

_OVERHEAD: Final = 0.02  # of a period, that the loop takes besides
_READINGS: Final = 2  # of a tick: another one where the host stood still


class TickWaits:
    """What the exchanges of the latest ticks took, and what the next one may take.

    ticks      ahead of the current one in which a loop reacts
    period_s   of the loop; 0: not known, and all that a tick takes counts
    late_s     a tick whose exchanges took no longer makes none later
    longest_s  what late ticks and the current one may take together
    """

    def __init__(self, ticks: int, late_s: float, period_s: float = 0.0) -> None:
        self.longest_s = 0.0
        self._late_s, self._period_s = late_s, period_s
        self._before = deque([0.0] * ticks, maxlen=ticks)
        self._this_s, self._readings = 0.0, 0

    def restart(self, longest_s: float) -> None:
        """The loop begins: no tick was late."""
        self.longest_s, self._this_s = longest_s, 0.0
        self._before.extend([0.0] * len(self._before))

    @property
    def left_s(self) -> float:
        """For how long the next exchange may wait, s."""
        return self.longest_s - sum(self._before) - self._this_s

    def read(self) -> None:
        """A reading begins. A tick has two at most: who reads on and drives nothing has other ticks."""
        self._readings += 1
        if self._readings > _READINGS:
            self.next_tick()

    def take(self, took_s: float) -> None:
        """An exchange of this tick took so long."""
        self._this_s += took_s

    def next_tick(self) -> None:
        """The drive of this tick is out."""
        later_s = self._this_s if self._this_s > self._late_s else 0.0
        if self._period_s > 0.0:
            later_s = self._period_s * math.floor(self._this_s / self._period_s + _OVERHEAD)
        self._before.append(later_s)
        self._this_s, self._readings = 0.0, 0
