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
    rows, count = fit.rows, cut.y_rad.size
    both = np.column_stack((rows.by_number[:count], problem.whitened(waves)))
    for first, stop in zip(cut.begins, np.append(cut.begins[1:], count), strict=True):
        start = np.linalg.qr(rows.by_start[first:stop])[0]
        both[first:stop] -= start @ (start.T @ both[first:stop])
    m = len(problem.free)
    size = 1.0 / np.sqrt(np.maximum(np.sum(both[:, :m] ** 2, axis=0), 1e-300))
    own, off = both[:, :m] * size, both[:, m:]
    inverse = np.linalg.pinv(own.T @ own, rcond=1e-13, hermitian=True)
    by_waves = np.sum((inverse @ (own.T @ off)) ** 2, axis=1)
    share = min(float(np.sum(off**2)) / sum(cut.counting_lengths) / unit(fit), 1.0)
    grown = 1.0 - share + by_waves / np.maximum(np.diag(inverse) * unit(fit), 1e-300)
    return np.asarray(np.maximum(grown, 1.0))
