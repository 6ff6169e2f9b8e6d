"""The Cramer-Rao bound of an experiment: no unbiased estimator scatters less (docs/theory.md 7.9).

The positions are a motion y(theta) plus Gaussian noise of covariance R. The covariance of any unbiased estimate is then
at least (J^T R^-1 J)^-1 with J = dy/dtheta at the truth. All of theta is unknown, the initial state too.
Quantisation counts as white noise of variance LSB^2 / 12. Disturbances of the motor itself are not in the bound: it
still holds with them, but no estimator reaches it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rig.core.arrays import Array
from rig.model.sensitivity import Theta, position_and_jacobian
from rig.run_folder.recording.series import Steps

DELAY = Theta._fields.index("delay_s")


@dataclass(frozen=True)
class PositionNoise:
    """Noise on the recorded position: white, quantisation, and first-order autoregressive.

    white_rad, lsb_rad   standard deviation of white noise, step of the reading, rad, >= 0
    correlated_rad       standard deviation of the autoregressive part, rad, >= 0
    coefficient          its correlation from one sample to the next, 0 <= c < 1
    Raises ValueError outside these ranges, and for noise without a white part or quantisation.
    """

    white_rad: float
    lsb_rad: float = 0.0
    correlated_rad: float = 0.0
    coefficient: float = 0.0

    def __post_init__(self) -> None:
        if min(self.white_rad, self.lsb_rad, self.correlated_rad) < 0.0 or not 0.0 <= self.coefficient < 1.0:
            raise ValueError("standard deviations and the step must be >= 0, the coefficient in [0, 1)")
        if self.white_variance_rad2 == 0.0:
            raise ValueError("there is no bound without white noise or quantisation")

    @property
    def white_variance_rad2(self) -> float:
        """Variance of the part that is independent from sample to sample (white and quantisation), rad^2."""
        return self.white_rad**2 + self.lsb_rad**2 / 12.0

    def whitened(self, columns: Array) -> Array:
        """R^-1/2 times the ``columns``, (n, m): innovations of a Kalman filter of the noise, of unit variance."""
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

    theta        the truth: v0 and y0 at t_s[0]; y0 includes the offset of the reading
    steps        the drive
    t_s          n times of the fitted samples, s
    delay_known  whether the times of the drive were recorded: then the delay is not estimated, its entry is 0
    Returns (7,); inf for a parameter that the experiment cannot separate from the others.
    """
    jacobian = noise.whitened(position_and_jacobian(theta, *steps, t_s)[1])
    size = np.linalg.norm(jacobian, axis=0)
    bound = np.where(size > 0.0, 0.0, math.inf)
    free = size > 0.0
    if delay_known:
        free[DELAY], bound[DELAY] = False, 0.0
    _, singular, directions = np.linalg.svd(jacobian[:, free] / size[free], full_matrices=False)
    observable = singular > singular[0] * t_s.size * np.finfo(float).eps
    # an unobservable direction has an infinite bound for the parameters in it, and only for these
    unknown = np.any(np.abs(directions[~observable]) > 1e-6, axis=0)
    deviation = np.linalg.norm(directions[observable] / singular[observable, None], axis=0) / size[free]
    bound[free] = np.where(unknown, math.inf, deviation)
    return bound
