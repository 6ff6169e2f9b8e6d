"""When a servo's steps of 1 ms are, in the host's time, from the clock that it tells with each reading. Pure.

A servo's clock counts whole milliseconds. Readings at different places within its step bound the instant at which its
clock went on; each later reading keeps the bound true. A reading that the machine held up bounds it less, not wrongly.
That the steps of clock, sensor and bridge are one, no manual says.
"""

from __future__ import annotations

import math
from typing import Final

STEP_S: Final = 1e-3
WRAPS: Final = 32768  # steps after which the clock begins again


class Steps:
    """The instants of the steps.

    low_s, high_s  between them is the host time of the step that is counted as 0, s
    count          of the step that was told last
    is_known       whether any reading has told the clock
    """

    def __init__(self) -> None:
        self.low_s, self.high_s = -math.inf, math.inf
        self.count = 0
        self.is_known = False
        self._last = 0
        self._began_s = math.nan

    def take(self, tick: int, earliest_s: float, latest_s: float) -> float:
        """A reading that was executed between these times told ``tick``. Returns the time of that step, s.

        A clock that goes at another pace moves the bounds along: the last reading is always right.
        """
        if self.is_known:
            self.count += (tick - self._last) % WRAPS
        self._last, self.is_known = tick, True
        high_s = latest_s - self.count * STEP_S
        low_s = earliest_s - (self.count + 1) * STEP_S
        # where the clocks have moved apart, then by no more than what is between the bounds
        self.low_s = min(max(self.low_s, low_s), high_s)
        self.high_s = max(min(self.high_s, high_s), low_s)
        self._began_s = 0.5 * (self.low_s + self.high_s)
        return self._began_s + self.count * STEP_S

    def next_s(self, t_s: float) -> float:
        """The first step after a time, s."""
        since = (t_s - self._began_s) / STEP_S
        return self._began_s + math.ceil(since) * STEP_S
