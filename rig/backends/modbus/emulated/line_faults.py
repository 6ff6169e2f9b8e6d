"""Random damage to what is sent on a serial line."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import NamedTuple

from rig.backends.modbus.emulated.rtu_slave import Direction

_DIRECTIONS: tuple[Direction, ...] = ("request", "reply")


class CorruptionRate(NamedTuple):
    """How often a line damages what passes: arguments of ``Corruption``."""

    rate_1_s: float
    seed: int
    after_s: float = 0.0


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
