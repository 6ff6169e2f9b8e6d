"""The part of a residual that repeats in each cycle. Unlike noise it does not average out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rig.core.arrays import Array, Rows
from rig.run_folder.recording.series import Window


def repetitions(windows: Sequence[Window], periods_s: Sequence[float | None]) -> list[tuple[Rows, Rows]]:
    """Pairs of rows that are one, two, ... whole cycles apart, within the windows; none without a cycle.

    periods_s  for each window the period of its cycle, s, or None
    """
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
    """Share of the power of a ``residual``, (n,), that repeats in each cycle, 0 to 1; 0 if chance explains it.

    Steps of a coarse sensor repeat, and so do effects that the model leaves out.
    """
    power = float(residual @ residual) / residual.size
    count = sum(first.size for first, _ in pairs)
    if power == 0.0 or count == 0:
        return 0.0
    share = sum(float(residual[first] @ residual[later]) for first, later in pairs) / (count * power)
    return min(1.0, max(0.0, share))


def with_repetition(covariance: Array, jacobian: Array, pairs: Sequence[tuple[Rows, Rows]], share: float) -> Array:
    """The ``covariance``, (p, p), of a fit with the repeated part of its residual: standard errors grow.

    jacobian   (n, p), whitened
    share      of the residual's power that repeats in each cycle, 0 to 1
    Correlations stay as they are.
    """
    if share == 0.0 or not np.all(np.isfinite(covariance)):
        return covariance
    influence = covariance @ jacobian.T  # (p, n), but for the variance of the residual
    own = np.sum(influence * influence, axis=1)
    again = sum(
        (2.0 * np.sum(influence[:, first] * influence[:, later], axis=1) for first, later in pairs), np.zeros_like(own)
    )
    grow = np.sqrt(np.maximum(1.0, 1.0 + share * again / np.where(own > 0.0, own, 1.0)))
    return np.asarray(covariance * np.outer(grow, grow))
