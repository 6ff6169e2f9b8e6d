"""A line whose answers, or a host whose ticks, come as late as a driver takes them, and how long a loop then reacts."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Any

from rig.backends.emulated.line_faults import Direction
from rig.core.faults import Fault

TICKS = 9  # of an episode: three times those in which a loop reacts
LOST_S = 9.0
EARLY_S = 1e-5  # that an answer comes ahead of its time-out
HOST_SHARE = 0.1  # of the period, that the host takes behind each drive


class LateBus:
    """A disturbance of a line: lateness of each exchange, on the way there or back; and when each request arrives.

    Or the host stands still between exchanges.

    left_s   for how long the driver would wait for the next answer, s
    quick_s  what an exchange takes that nobody disturbs, at most, s
    there    share of requests that are late, not their answers
    seed     of what is drawn
    """

    def __init__(
        self, left_s: Callable[[], float], quick_s: float, timeout_s: float, seed: int, there: float = 0.3
    ) -> None:
        self.arrived: list[float] = []
        self.is_late = True
        self._left_s, self._quick_s, self._timeout_s = left_s, quick_s, timeout_s
        self._there, self._draw = there, random.Random(seed)
        self._kind = self._draw.choice(["all", "timeout", "any", "first", "lost", "host"])
        self._begins = self._draw.randrange(10)  # this request is the first that is late
        self._back_s = 0.0

    def __call__(self, direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        if direction == "reply":
            late_s, self._back_s = self._back_s, 0.0
            return [(late_s, data)] if late_s < LOST_S else []
        late_s, self._back_s = self._lateness(), 0.0
        if self._draw.random() >= self._there:
            late_s, self._back_s = 0.0, late_s
        self.arrived.append(t_s + late_s)
        return [(late_s, data)] if late_s < LOST_S else []

    def stands_s(self) -> float:
        """How long the host stands still now, s."""
        if self._kind != "host" or len(self.arrived) < self._begins:
            return 0.0
        return max(self._left_s() - self._quick_s - EARLY_S, 0.0) * self._draw.choice([0.0, 0.1, 0.25])

    def _lateness(self) -> float:
        if not self.is_late or self._kind == "host" or len(self.arrived) < self._begins:
            return 0.0
        left_s, timeout_s = (wait_s - self._quick_s - EARLY_S for wait_s in (self._left_s(), self._timeout_s))
        drawn = self._draw.random()
        late_s = {
            "all": left_s,
            "timeout": min(timeout_s * self._draw.choice([0.3, 0.5, 0.8, 1.0]), left_s),
            "lost": left_s * drawn if len(self.arrived) - self._begins < 2 else LOST_S,
            "any": left_s * drawn if drawn < 0.5 else 0.0,
            "first": left_s if len(self.arrived) == self._begins else min(timeout_s, left_s),
        }[self._kind]
        return max(late_s, 0.0)


def longest_reaction_s(driver: Any, clock: Any, late: LateBus, period_s: float, reacts: int, u_V: float = 0.0) -> float:
    """The longest from a reading to the drive, or the stop, that answers to a motion which began right behind it, s.

    The driver is armed. The loop keeps to its grid as the real one does, and the host has its part of each period.

    reacts    that drive is decided so many ticks later
    """
    sampled: list[float] = []
    acted: list[float] = []
    begun_s, tick = clock.now_s() + period_s, 0
    late.arrived.clear()
    try:
        while len(acted) < TICKS:
            clock.sleep_until(due_s := begun_s + tick * period_s)
            first = len(late.arrived)
            driver.read()
            sampled.append(late.arrived[first])
            clock.sleep_until(clock.now_s() + late.stands_s())
            driver.write(u_V if tick % 2 else -u_V)
            acted.append(late.arrived[-1])
            clock.sleep_until(clock.now_s() + HOST_SHARE * period_s)
            clock.sleep_until(clock.now_s() + late.stands_s())
            tick += 1 + max(int((clock.now_s() - due_s) / period_s), 0)
    except Fault:
        late.is_late = False
        asked = len(late.arrived)
        driver.safe_stop()
        acted.append(late.arrived[asked])
    return max((to_s - from_s for from_s, to_s in zip(sampled, acted[reacts:], strict=False)), default=0.0)
