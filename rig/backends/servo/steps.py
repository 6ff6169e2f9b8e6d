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
_APART_S: Final = 2.0 * STEP_S  # by which readings have moved the bounds where the clock goes at another pace
_PACES: Final = 0.97, 1.03  # of clocks that a bus at its baud still understands


class Steps:
    """The instants of the steps.

    low_s, high_s  between them is the host time of the step that was told last, s
    step_s         length of a step by the host's clock, as far as it is known
    is_known       whether any reading has told the clock
    """

    def __init__(self) -> None:
        self.low_s, self.high_s = -math.inf, math.inf
        self.step_s = STEP_S
        self.is_known = False
        self._last = 0
        self._began_s = math.nan
        self._moved_s = self._passed_s = 0.0  # the bounds by readings, in how long

    def take(self, tick: int, earliest_s: float, latest_s: float) -> float:
        """A reading that was executed between these times told ``tick``. Returns the time of that step, s.

        A clock that goes at another pace moves the bounds along, and its pace is learnt: the last reading is always
        right.
        """
        passed_s = ((tick - self._last) % WRAPS) * self.step_s if self.is_known else 0.0
        self._last, self.is_known = tick, True
        low_s, high_s = earliest_s - self.step_s, latest_s
        old_low_s, old_high_s = self.low_s + passed_s, self.high_s + passed_s
        # where the clocks have moved apart, then by no more than what is between the bounds
        if old_low_s > high_s:
            self._moved_s += high_s - old_low_s
            self.low_s = self.high_s = high_s
        elif old_high_s < low_s:
            self._moved_s += low_s - old_high_s
            self.low_s = self.high_s = low_s
        else:
            self.low_s = old_low_s if old_low_s > low_s else low_s
            self.high_s = old_high_s if old_high_s < high_s else high_s
        self._began_s = 0.5 * (self.low_s + self.high_s)
        self._passed_s += passed_s
        if abs(self._moved_s) > _APART_S:  # less may be the machine
            pace = self.step_s / STEP_S * (1.0 + self._moved_s / max(self._passed_s, STEP_S))
            self.step_s = STEP_S * min(max(pace, _PACES[0]), _PACES[1])
            self._moved_s = self._passed_s = 0.0
        return self._began_s

    def next_s(self, t_s: float) -> float:
        """The first step after a time, s."""
        since = (t_s - self._began_s) / self.step_s
        return self._began_s + math.ceil(since) * self.step_s
