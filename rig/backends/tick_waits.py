"""How late the ticks of a loop may come, by its host and by what exchanges wait: what preflight counts. Pure.

From a reading to the drive that answers to it a loop has so many periods; all beyond them is late, whoever was it.
"""

from __future__ import annotations

from collections import deque
from typing import Final

REACTS_TICKS: Final = 3  # that a loop needs: one until it reads the motion, two by which its velocity lags
UNWATCHED_S: Final = 0.1  # the longest that a drive may act on where no watchdog of the device ends it

_ROUNDING_S: Final = 1e-9
_READINGS: Final = 2  # of a tick: another one where the host stood still


def unwatched_s(timeout_s: float, watchdog_s: float) -> float:
    """What late ticks may take together where the device has no watchdog, s: as one may silence that has one."""
    return min(max(timeout_s, UNWATCHED_S), watchdog_s)


class TickWaits:
    """How late the latest ticks came, and for how long the current one may wait.

    ticks      ahead of the current one in which a loop reacts
    period_s   of the loop; 0: not known, and the current tick alone counts
    longest_s  what late ticks and the current one may take together
    until_s    when all that the current one may take is over
    """

    def __init__(self, ticks: int, period_s: float) -> None:
        self.longest_s = self.until_s = 0.0
        self._period_s = period_s
        self._before: deque[float] = deque(maxlen=ticks if period_s > 0.0 else 0)
        self._begun_s = 0.0
        self._readings, self._is_driven = 0, False

    def restart(self, longest_s: float, now_s: float) -> None:
        """The loop begins: no tick was late."""
        self.longest_s, self._begun_s, self.until_s = longest_s, now_s, now_s + longest_s
        self._before.clear()
        self._readings, self._is_driven = 0, False

    @property
    def words(self) -> str:
        """Why the next exchange may not wait for longer, for people."""
        return f"late ticks and replies may take {1e3 * self.longest_s:.0f} ms together, all that `rig check` counts"

    def is_over(self, now_s: float) -> bool:
        """Whether they have taken more, now: also where this process stood still."""
        return self.left_s(now_s) < -_ROUNDING_S

    def left_s(self, now_s: float) -> float:
        """For how long an exchange that begins now may wait, s."""
        return self.until_s - now_s

    def read(self, now_s: float) -> None:
        """A reading begins. A tick has two at most: who reads on and drives nothing has other ticks."""
        if self._is_driven or self._readings >= _READINGS:
            # less than 0 where the tick before was late, and this one is on the loop's grid again
            due_s = self._period_s * (1 if self._is_driven else self._readings)
            self._before.append(now_s - self._begun_s - due_s)
            self._readings, self._is_driven = 0, False
        if self._readings == 0:
            self._begun_s, self.until_s = now_s, now_s + self.longest_s - sum(self._before)
        self._readings += 1

    def drive(self) -> None:
        """The drive of this tick is out."""
        self._is_driven = True
