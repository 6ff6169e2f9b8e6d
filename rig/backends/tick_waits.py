"""How long the exchanges of a tick may wait: what preflight counts into the room to stop, and no more. Pure.

The loop keeps to its grid: where the exchanges of a tick took more of the period than is theirs, the next one may come
whole periods later, because the host needs its part, too. So how much later the ticks began, and what the last one
does, is all that a drive comes late.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from rig.backends.link_budget import LINK_SHARE

REACTS_TICKS: Final = 3  # that a loop needs: one until it reads the motion, two by which its velocity lags
UNWATCHED_S: Final = 0.1  # the longest that a drive may act on where no watchdog of the device ends it

_ROUNDING_S: Final = 1e-9
_READINGS: Final = 2  # of a tick: another one where the host stood still


def unwatched_s(timeout_s: float, watchdog_s: float) -> float:
    """What late ticks may take together where the device has no watchdog, s: as one may silence that has one."""
    return min(max(timeout_s, UNWATCHED_S), watchdog_s)


class TickWaits:
    """What the exchanges of the latest ticks took, and what the next one may take.

    ticks      ahead of the current one in which a loop reacts
    period_s   of the loop; 0: not known, and all that a tick takes counts
    longest_s  what late ticks and the current one may take together
    """

    def __init__(self, ticks: int, period_s: float) -> None:
        self.longest_s = 0.0
        self._period_s = period_s
        self._before = deque([0.0] * ticks, maxlen=ticks)
        self._begun_s = self._this_s = 0.0
        self._readings, self._is_driven = 0, False

    def restart(self, longest_s: float) -> None:
        """The loop begins: no tick was late."""
        self.longest_s, self._this_s = longest_s, 0.0
        self._before.extend([0.0] * len(self._before))
        self._readings, self._is_driven = 0, False

    @property
    def is_over(self) -> bool:
        """Whether they have taken more: what has come while this process stood still counts, however late."""
        return self.left_s < -_ROUNDING_S

    @property
    def words(self) -> str:
        """Why the next exchange may not wait for longer, for people."""
        return f"late replies may take {1e3 * self.longest_s:.0f} ms together, all that `rig check` counts"

    @property
    def left_s(self) -> float:
        """For how long the next exchange may wait, s."""
        return self.longest_s - sum(self._before) - self._this_s

    def read(self, now_s: float) -> None:
        """A reading begins. A tick has two at most: who reads on and drives nothing has other ticks."""
        if self._is_driven or self._readings >= _READINGS:
            self._next_tick(now_s)
        elif self._readings == 0:
            self._begun_s = now_s
        self._readings += 1

    def take(self, took_s: float) -> None:
        """An exchange of this tick took so long."""
        self._this_s += took_s

    def drive(self) -> None:
        """The drive of this tick is out."""
        self._is_driven = True

    def _next_tick(self, now_s: float) -> None:
        """How much later it begins because of what the exchanges of the last one took; else the host was late."""
        took_s, period_s = self._this_s, self._period_s
        late_s = took_s
        if period_s > 0.0:
            due_s = period_s * (1 if self._is_driven else self._readings)
            late_s = min(max(now_s - self._begun_s - due_s, 0.0), period_s * math.ceil(took_s / period_s))
            if took_s <= LINK_SHARE * due_s:
                late_s = 0.0
        self._before.append(late_s)
        self._begun_s, self._this_s = now_s, 0.0
        self._readings, self._is_driven = 0, False
