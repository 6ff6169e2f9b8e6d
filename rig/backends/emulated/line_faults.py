"""Random damage to the bytes on a serial line."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Literal

Direction = Literal["request", "reply"]
# What becomes of bytes on the line: (direction, bytes, time s) -> what arrives instead, each with its delay, s
Disturbance = Callable[[Direction, bytes, float], Sequence[tuple[float, bytes]]]

_DIRECTIONS: tuple[Direction, ...] = ("request", "reply")


def disturbed(
    disturbance: Disturbance | None, direction: Direction, data: bytes, t_s: float
) -> Sequence[tuple[float, bytes]]:
    """What arrives of bytes on a line with this disturbance, or none, each with its delay, s; no empty ones."""
    arriving = ((0.0, data),) if disturbance is None else disturbance(direction, data, t_s)
    return [(delay_s, one) for delay_s, one in arriving if one]


class Corruption:
    """Random damage to single bytes: one is changed, lost or added, at most one in each frame.

    rate_1_s  damages per second, of requests and replies alike; without traffic they wait for it
    seed      of place and kind of each damage
    after_s   time at which it begins, s
    """

    def __init__(self, rate_1_s: float, seed: int, after_s: float = 0.0) -> None:
        self.done = 0
        self._rate_1_s = rate_1_s
        self._after_s = after_s
        self._random = random.Random(seed)
        self._next: Direction = self._random.choice(_DIRECTIONS)

    def __call__(self, direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        """As ``Disturbance``: the bytes that arrive instead, each with its delay, s."""
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
