"""What may happen to bytes on a serial line: lost, late, twice, or damaged."""

from __future__ import annotations

import random
from collections.abc import Sequence

from rig.emulate.rtu_slave import Direction

_DIRECTIONS: tuple[Direction, ...] = ("request", "reply")


class Corruption:
    """Random damage to single bytes: changed, lost or come from nowhere, at most one in what is sent at a time.

    rate_1_s  how many a second, of requests and replies alike; where there is no traffic they wait for it
    seed      of where and what
    after_s   when it begins
    """

    def __init__(self, rate_1_s: float, seed: int, after_s: float = 0.0) -> None:
        self.done = 0
        self._rate_1_s = rate_1_s
        self._after_s = after_s
        self._random = random.Random(seed)
        self._next: Direction = self._random.choice(_DIRECTIONS)

    def __call__(self, direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        """As a Disturbance."""
        if direction != self._next or (t_s - self._after_s) * self._rate_1_s < self.done + 1:
            return ((0.0, data),)
        self.done += 1
        draw = self._random
        self._next = draw.choice(_DIRECTIONS)
        at, damage = draw.randrange(len(data)), draw.randrange(4)
        if damage == 0:
            return ((0.0, data[:at] + data[at + 1 :]),)
        other = bytes((draw.randrange(256),))
        if damage == 1:
            return ((0.0, data[:at] + other + data[at:]),)
        changed = bytes((data[at] ^ draw.randrange(1, 256),))
        return ((0.0, data[:at] + changed + data[at + 1 :]),)


class Mishap:
    """One thing that happens to the next ``times`` of what is sent in a direction.

    delay_s  of it, s; None: it is lost
    copy_s   delay of a second copy, s; None: there is none
    """

    def __init__(
        self, direction: Direction, times: int = 1, *, delay_s: float | None = 0.0, copy_s: float | None = None
    ) -> None:
        self.left = times
        self._direction = direction
        self._delays_s = [d for d in (delay_s, copy_s) if d is not None]

    def __call__(self, direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        """As a Disturbance."""
        if direction != self._direction or self.left == 0:
            return ((0.0, data),)
        self.left -= 1
        return [(delay_s, data) for delay_s in self._delays_s]
