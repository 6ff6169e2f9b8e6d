"""What may happen to a frame on its way."""

from __future__ import annotations

import random
from collections.abc import Callable

Passed = list[tuple[float, bytes]]  # what comes out of the wire, and how much later, s
Damage = Callable[[bytes, random.Random], Passed]


def lost(frame: bytes, rng: random.Random) -> Passed:
    """Nothing arrives."""
    return []


def garbage(frame: bytes, rng: random.Random) -> Passed:
    """As many bytes, none of them meant."""
    return [(0.0, rng.randbytes(len(frame)))]


def flipped(frame: bytes, rng: random.Random) -> Passed:
    """One bit is wrong."""
    damaged = bytearray(frame)
    bit = rng.randrange(8 * len(frame))
    damaged[bit // 8] ^= 1 << bit % 8
    return [(0.0, bytes(damaged))]


def truncated(frame: bytes, rng: random.Random) -> Passed:
    """The end is missing."""
    return [(0.0, frame[: rng.randrange(min(1, len(frame) - 1), len(frame))])]  # nothing of a lone byte


def duplicated(frame: bytes, rng: random.Random) -> Passed:
    """It comes twice."""
    return [(0.0, frame), (0.0, frame)]


def late(by_s: float) -> Damage:
    """It comes whole, but later."""

    def damage(frame: bytes, rng: random.Random) -> Passed:
        return [(by_s, frame)]

    return damage


def reordered() -> Damage:
    """Each second one overtakes the one before it."""
    held: list[bytes] = []

    def damage(frame: bytes, rng: random.Random) -> Passed:
        if not held:
            held.append(frame)
            return []
        return [(0.0, frame), (0.0, held.pop())]

    return damage


def stale() -> Damage:
    """Instead of each comes the one before it, whole."""
    before: list[bytes] = []

    def damage(frame: bytes, rng: random.Random) -> Passed:
        before.append(frame)
        return [(0.0, before.pop(0))] if len(before) > 1 else []

    return damage


def first(number: int, damage: Damage) -> Damage:
    """The first ``number`` frames; the rest arrives as it is."""
    left = [number]

    def some(frame: bytes, rng: random.Random) -> Passed:
        left[0] -= 1
        return damage(frame, rng) if left[0] >= 0 else [(0.0, frame)]

    return some


def only(which: Callable[[bytes], bool], damage: Damage) -> Damage:
    """Frames of one kind; the rest arrives as it is."""

    def some(frame: bytes, rng: random.Random) -> Passed:
        return damage(frame, rng) if which(frame) else [(0.0, frame)]

    return some
