"""The Cramer-Rao bound of an experiment: no unbiased estimator scatters less (docs/theory.md 7.9).

For Gaussian noise e of covariance R on the positions and a motion y(theta), the covariance of any unbiased estimate is
at least (J^T R^-1 J)^-1 with J = dy/dtheta at the truth; all of theta is unknown, the initial state too.
Quantisation counts as white noise of variance LSB^2 / 12. What disturbs the motor rather than its reading is not in
the bound: it holds then, but cannot be reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.model.sensitivity import Theta, position_and_jacobian
from rig.recording.series import Steps

Array = NDArray[np.float64]

DELAY = Theta._fields.index("delay_s")


@dataclass(frozen=True)
class PositionNoise:
    """Noise of the position as read: white, quantisation, and first-order autoregressive.

    white_rad, lsb_rad   standard deviation of white noise, step of the reading, rad, >= 0
    correlated_rad       standard deviation of the autoregressive part, rad, >= 0
    coefficient          its correlation from one sample to the next, 0 <= c < 1
    Raises ValueError outside these ranges, or where there is no white part at all.
    """

    white_rad: float
    lsb_rad: float = 0.0
    correlated_rad: float = 0.0
    coefficient: float = 0.0

    def __post_init__(self) -> None:
        if min(self.white_rad, self.lsb_rad, self.correlated_rad) < 0.0 or not 0.0 <= self.coefficient < 1.0:
            raise ValueError("standard deviations and the step must be >= 0, the coefficient in [0, 1)")
        if self.white_variance_rad2 == 0.0:
            raise ValueError("without white noise or quantisation there is no bound")

    @property
    def white_variance_rad2(self) -> float:
        """Variance of the part that is independent from sample to sample, rad^2."""
        return self.white_rad**2 + self.lsb_rad**2 / 12.0

    def whitened(self, columns: Array) -> Array:
        """R^-1/2 times the columns, (n, m): as a Kalman filter of the noise would leave them, of unit variance."""
        r = self.white_variance_rad2
        power = self.correlated_rad**2
        if power == 0.0:
            return columns / math.sqrt(r)
        out = np.empty_like(columns)
        ahead, variance = np.zeros(columns.shape[1]), power
        for k, row in enumerate(columns):
            total = variance + r
            innovation = row - ahead
            out[k] = innovation / math.sqrt(total)
            ahead = self.coefficient * (ahead + variance / total * innovation)
            variance = self.coefficient**2 * variance * r / total + (1.0 - self.coefficient**2) * power
        return out


def cramer_rao(theta: Theta, steps: Steps, t_s: Array, noise: PositionNoise, *, delay_known: bool = False) -> Array:
    """Bound on the standard deviation of each of ``Theta``, in its order and units.

    theta        the truth: v0 and y0 at t_s[0], the offset of the reading in y0
    steps        the drive
    t_s          n times of the samples that are fitted, s
    delay_known  the times of the drive were recorded: the delay is not estimated, its entry is 0
    Returns (7,); inf where the experiment does not tell a parameter from the others.
    """
    jacobian = noise.whitened(position_and_jacobian(theta, *steps, t_s)[1])
    size = np.linalg.norm(jacobian, axis=0)
    bound = np.where(size > 0.0, 0.0, math.inf)
    free = size > 0.0
    if delay_known:
        free[DELAY], bound[DELAY] = False, 0.0
    _, singular, directions = np.linalg.svd(jacobian[:, free] / size[free], full_matrices=False)
    told = singular > singular[0] * t_s.size * np.finfo(float).eps
    # a direction that the data does not tell spoils the parameters that it touches, and only these
    untold = np.any(np.abs(directions[~told]) > 1e-6, axis=0)
    deviation = np.linalg.norm(directions[told] / singular[told, None], axis=0) / size[free]
    bound[free] = np.where(untold, math.inf, deviation)
    return bound
