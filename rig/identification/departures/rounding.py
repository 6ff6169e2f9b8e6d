"""By how much more a sensor's rounding scatters a fit than noise that is new in each row (docs/theory.md 7.6).

A sensor with little noise is off by a sawtooth of the angle. That is no new chance in each row: a shaft that turns a
whole number of steps from row to row is off by the same in all of them, and in a cycle that comes again it is off as it
was before. Nobody knows how the steps lie to the shaft. Over all ways in which they may lie, the motion of the fit
tells how the sawtooth scatters its numbers. Noise rounds the sawtooth off: of half a step it leaves nothing of it.
"""

from __future__ import annotations

import math

import numpy as np

from rig.core.arrays import Array
from rig.identification.departures.fit import Fit, unit

WAVES = 8  # of the sawtooth: they have 93 % of its power
LEAST = 1e-3  # of a step: the size of a wave that is left out
SURE = 4.0  # standard errors by which neighbours must go together


def by_rounding(fit: Fit, step_rad: float) -> Array:
    """(m,) by how much larger the variance of each of the fit's numbers is, >= 1.

    step_rad   of the sensor, rad; 0: not known, nothing grows
    """
    cut, problem = fit.problem.cut, fit.problem
    noise_rad = math.sqrt(max(fit.rms_rad**2 - step_rad**2 / 12.0, 0.0))
    sizes = [
        step_rad / (math.pi * k) * math.exp(-2.0 * (math.pi * k * noise_rad / step_rad) ** 2)
        for k in range(1, WAVES + 1)
        if step_rad > 0.0
    ]
    sizes = [size for size in sizes if size > LEAST * step_rad]
    if not sizes:
        return np.ones(len(problem.free))
    turned = 2.0 * math.pi / step_rad * (cut.y_rad + fit.residual_rad)
    waves = np.column_stack(
        [size * wave(k * turned) for k, size in enumerate(sizes, 1) for wave in (np.sin, np.cos)]
    ) * math.sqrt(0.5)  # of a sine of unknown phase
    off = _beside_starts(fit, problem.whitened(waves))
    own, inverse = _own(fit)
    by_waves = np.sum((inverse @ (own.T @ off)) ** 2, axis=1)
    share = min(float(np.sum(off**2)) / sum(cut.counting_lengths) / unit(fit), 1.0)
    grown = 1.0 - share + by_waves / np.maximum(np.diag(inverse) * unit(fit), 1e-300)
    return np.asarray(np.maximum(grown, 1.0))


def by_neighbours(fit: Fit) -> Array:
    """(m,) by how much larger the variance of each of the fit's numbers is, >= 1, where neighbouring rows go together.

    The sum of a tachometer's samples has half of each one's noise in the step before it, and half in the one behind it:
    as much again at the pace of a motor as steps of their own would have. No ``Noise`` is like that.
    """
    cut = fit.problem.cut
    left = fit.problem.whitened(fit.residual_rad)
    together = np.ones(left.size - 1)
    together[cut.begins[1:] - 1] = 0.0
    alike = float(np.sum(together * left[1:] * left[:-1])) / max(float(left @ left), 1e-300)
    if alike < SURE / math.sqrt(left.size):
        return np.ones(len(fit.problem.free))
    own, inverse = _own(fit)
    moves = own @ inverse
    beside = np.sum(together[:, None] * moves[1:] * moves[:-1], axis=0)
    return np.asarray(np.maximum(1.0 + 2.0 * alike * beside / np.maximum(np.sum(moves**2, axis=0), 1e-300), 1.0))


def _own(fit: Fit) -> tuple[Array, Array]:
    """(n, m) what each whitened row says of the fit's numbers beside the starts of its pieces; and the inverse of that.

    In units that make each column as long as any other.
    """
    own = _beside_starts(fit, fit.rows.by_number[: fit.problem.cut.y_rad.size])
    own = own / np.sqrt(np.maximum(np.sum(own**2, axis=0), 1e-300))
    return own, np.asarray(np.linalg.pinv(own.T @ own, rcond=1e-13, hermitian=True))


def _beside_starts(fit: Fit, columns: Array) -> Array:
    """Whitened columns without what the starts of the pieces would take of them."""
    cut, found = fit.problem.cut, columns.copy()
    for first, stop in zip(cut.begins, np.append(cut.begins[1:], cut.y_rad.size), strict=True):
        start = np.linalg.qr(fit.rows.by_start[first:stop])[0]
        found[first:stop] -= start @ (start.T @ found[first:stop])
    return found
