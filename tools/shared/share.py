"""A share that was counted, with its exact bounds (Clopper and Pearson)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest


def bounds(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share, from 0 to 1; ``of`` at least 1."""
    interval = binomtest(count, of).proportion_ci(confidence_level=0.95, method="exact")
    return float(interval.low), float(interval.high)


def at_most(count: int, of: int) -> float:
    """What a share does not exceed, with 95 % confidence; ``of`` at least 1."""
    return float(binomtest(count, of, alternative="less").proportion_ci(confidence_level=0.95, method="exact").high)


def counted(held: Sequence[bool] | np.ndarray[Any, Any]) -> tuple[str, str]:
    """``k of n: share`` and the bounds, as words; of nothing, a dash and nothing."""
    n, k = len(held), int(np.sum(held))
    if not n:
        return "–", ""
    low, high = bounds(k, n)
    return f"{k} of {n}: {100 * k / n:.1f} %", f"{100 * low:.1f} to {100 * high:.1f} %"
