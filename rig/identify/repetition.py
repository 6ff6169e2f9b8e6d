"""What comes again in each cycle: it does not average out, as noise does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rig.recording.series import Window

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def repetitions(windows: Sequence[Window], periods_s: Sequence[float | None]) -> list[tuple[Rows, Rows]]:
    """Pairs of rows one, two, ... whole cycles apart, as far as the windows go; none where there is no cycle."""
    pairs = []
    at = 0
    for window, period in zip(windows, periods_s, strict=True):
        n = window.t_s.size
        lag = 0.0 if period is None else period
        count = int((window.t_s[-1] - window.t_s[0]) / lag) if lag > 2.0 * window.period_s else 0
        for cycles in range(1, count + 1):
            later = np.searchsorted(window.t_s, window.t_s + cycles * lag - 0.5 * window.period_s)
            first = np.flatnonzero(later < n)
            pairs.append((at + first, at + later[first]))
        at += n
    return pairs


def repeated_share(residual: Array, pairs: Sequence[tuple[Rows, Rows]]) -> float:
    """Share of a residual's power that comes again in each cycle, 0 to 1; 0 where chance explains it.

    What repeats does not average out over the cycles: the steps of a coarse sensor, or what the model leaves out.
    """
    power = float(residual @ residual) / residual.size
    count = sum(first.size for first, _ in pairs)
    if power == 0.0 or count == 0:
        return 0.0
    share = sum(float(residual[first] @ residual[later]) for first, later in pairs) / (count * power)
    return min(1.0, max(0.0, share))


def with_repetition(covariance: Array, jacobian: Array, pairs: Sequence[tuple[Rows, Rows]], share: float) -> Array:
    """The covariance of a fit of which ``share`` of the residual's power repeats in each cycle.

    jacobian   (n, p), whitened. Standard errors grow, correlations stay.
    """
    if share == 0.0 or not np.all(np.isfinite(covariance)):
        return covariance
    influence = covariance @ jacobian.T  # (p, n), up to the variance of the residual
    own = np.sum(influence * influence, axis=1)
    again = sum(
        (2.0 * np.sum(influence[:, first] * influence[:, later], axis=1) for first, later in pairs), np.zeros_like(own)
    )
    grow = np.sqrt(np.maximum(1.0, 1.0 + share * again / np.where(own > 0.0, own, 1.0)))
    return np.asarray(covariance * np.outer(grow, grow))
