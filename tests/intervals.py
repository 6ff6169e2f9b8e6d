"""Whether an interval reaches the truth, where what is measured differs from machine to machine."""

from __future__ import annotations

from collections.abc import Sequence

# A 95 % interval misses the truth once in twenty machines or seeds; three times as wide, once in some hundred million.
TIMES = 3.0


def reaches(ci95: Sequence[float], true: float) -> bool:
    """Whether ``true`` lies within ``TIMES`` the half width of a 95 % interval about its middle."""
    low, high = ci95
    return abs(true - 0.5 * (low + high)) < TIMES * 0.5 * (high - low)
