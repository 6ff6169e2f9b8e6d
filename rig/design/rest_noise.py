"""The noise of a reading at rest, which each further pause tells better (docs/until.md)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STILL_SHARE = 0.6  # of a pause, its end: by then the shaft stands
FEWEST_ROWS = 20
MOVES = 2.0  # times the variance so far: the shaft still moved
NORMAL = 3.0  # standard deviations


class RestNoise:
    """What is known of the noise at rest.

    std_rad   standard deviation, rad, > 0
    error     its standard error, as a share of it, >= 0; 0: it is known
    """

    def __init__(self, std_rad: float, error: float) -> None:
        self.std_rad = std_rad
        self.error = error

    def take(self, y_rad: Array) -> bool:
        """Take the positions (n,), rad, of a pause. Returns False, and learns nothing, if the shaft still moved.

        Nor from noise that is not white: a pause shows too little of it, and a fit's residual follows another rule.
        """
        y = np.asarray(y_rad[-round(STILL_SHARE * y_rad.size) :], dtype=float)
        if y.size < FEWEST_ROWS or self.error == 0.0:
            return False
        x = np.arange(float(y.size)) - 0.5 * (y.size - 1)
        y = y - y.mean()
        slope = float(x @ y) / float(x @ x)
        freedom = y.size - 2
        power = float(y @ y) - slope**2 * float(x @ x)
        variance = power / freedom
        creeps = abs(slope) > NORMAL * math.sqrt(variance / float(x @ x)) if variance > 0.0 else slope != 0.0
        line = y - slope * x
        if creeps or variance > MOVES * self.std_rad**2 or not _is_white(line, variance):
            return False
        before = 0.5 / self.error**2
        self.std_rad = math.sqrt((before * self.std_rad**2 + power) / (before + freedom))
        self.error = 1.0 / math.sqrt(2.0 * (before + freedom))
        return True


def _is_white(noise: Array, variance: float) -> bool:
    """Whether first and second differences have the variances of white noise, twice and six times the noise's own."""
    by_first, by_second = (float(np.mean(np.diff(noise, k) ** 2)) / of for k, of in ((1, 2.0), (2, 6.0)))
    off = NORMAL / math.sqrt(noise.size)  # the second ratio scatters half as much
    return variance > 0.0 and abs(by_first / variance - 1.0) <= off and abs(by_second / by_first - 1.0) <= 0.5 * off
