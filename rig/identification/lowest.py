"""Where a function with one valley is lowest."""

from __future__ import annotations

import math
from collections.abc import Callable

GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def lowest(function: Callable[[float], float], low: float, high: float, steps: int) -> tuple[float, float]:
    """Where between ``low`` and ``high``, any unit, and its value there: by so many steps of the golden section."""
    at = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)]
    values = [function(x) for x in at]
    for _ in range(steps):
        if values[0] < values[1]:
            high, at[1], values[1] = at[1], at[0], values[0]
            at[0] = high - GOLDEN * (high - low)
            values[0] = function(at[0])
        else:
            low, at[0], values[0] = at[0], at[1], values[1]
            at[1] = low + GOLDEN * (high - low)
            values[1] = function(at[1])
    return min(zip(at, values, strict=True), key=lambda pair: pair[1])
