"""Whether estimates of several runs are of one motor, and how they change: weighted means, their scatter, their trend.

Pure: arrays in, numbers out (docs/theory.md 9.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.core.arrays import Array

LARGEST_RATIO = 1e8  # of the variance between runs to the largest of their own: the search for it ends there


@dataclass(frozen=True, eq=False)
class Agreement:
    """How n estimates of p numbers agree within their covariance.

    chance   probability that estimates of one motor differ at least so much
    off      (n, p) how far each is off the weighted mean of the others
    error    (n, p) standard deviation of ``off``
    square   (n,) how far that is in all p numbers together: a sum of p squares, in standard deviations
    """

    chance: float
    off: Array
    error: Array
    square: Array

    @property
    def alone(self) -> Array:
        """(n,) probability that one of the same motor is off the others at least so much."""
        return np.asarray(_special().chdtrc(self.off.shape[1], self.square), dtype=np.float64)


def agreement(values: Array, covariance: Array) -> Agreement:
    """Compare n >= 2 estimates of p numbers each with their weighted mean, and each with that of the others.

    values       (n, p)
    covariance   (n p, n p), run by run: what several runs share is in its blocks beside the diagonal
    Raises numpy.linalg.LinAlgError for a covariance that is not positive definite.
    """
    n, p = values.shape
    size = np.sqrt(np.diag(covariance))
    np.linalg.cholesky(covariance / np.outer(size, size))  # raises for what is no covariance
    weight = np.linalg.inv(covariance / np.outer(size, size)) / np.outer(size, size)
    same = np.tile(np.eye(p), (n, 1))
    by_mean = weight @ same
    left = weight - by_mean @ np.linalg.solve(same.T @ by_mean, by_mean.T)
    pull = left @ values.ravel()
    off, error, square = np.empty((n, p)), np.empty((n, p)), np.empty(n)
    for k in range(n):
        own = slice(k * p, (k + 1) * p)
        spread = np.linalg.inv(left[own, own])
        off[k] = spread @ pull[own]
        error[k] = np.sqrt(np.diag(spread))
        square[k] = max(pull[own] @ off[k], 0.0)  # of equal values rounding makes a square below 0
    return Agreement(float(_special().chdtrc(p * (n - 1), max(values.ravel() @ pull, 0.0))), off, error, square)


def odd_ones(values: Array, covariance: Array, level: float) -> list[int] | None:
    """The runs without which the others agree; [] if all agree; None if it takes away half of them, or of two runs.

    values       (n, p), each in a unit of its own
    covariance   (n p, n p) of them, run by run, in these units
    level        probability of naming any run of those that are of one motor: each is one of n looks
    """
    n, p = values.shape
    here = list(range(n))
    odd: list[int] = []
    while True:
        rows = [k * p + j for k in here for j in range(p)]
        found = agreement(values[here], covariance[np.ix_(rows, rows)])
        if found.chance >= level:
            return odd
        most = int(np.argmax(found.square))
        if 2 * (len(here) - 1) <= n or len(here) < 3 or len(here) * found.alone[most] >= level:
            return None
        odd.append(here.pop(most))


def between_runs(design: Array, values: Array, variances: Array) -> float:
    """Variance between runs beyond their own, by Paule and Mandel; 0 if their own explain how they differ.

    design      (n, q) what the mean depends on, n > q; a column of ones: on nothing
    values      (n,)
    variances   (n,) of the values by their own noise
    """
    n, q = design.shape

    def excess(between: float) -> float:
        weight = 1.0 / (variances + between)
        residual = values - design @ _weighted(design, values, weight)[0]
        return float(weight @ residual**2) - float(n - q)

    top = float(variances.max() + np.ptp(values) ** 2)
    if excess(0.0) <= 0.0:
        return 0.0
    while excess(top) > 0.0 and top < LARGEST_RATIO * float(variances.max()):
        top *= 4.0
    from scipy.optimize import brentq  # it loads slowly

    return float(brentq(excess, 0.0, top)) if excess(top) < 0.0 else top


def _special() -> Any:
    """Its functions; it loads slowly, and `import rig` loads this file."""
    from scipy import special

    return special


def _weighted(design: Array, values: Array, weight: Array) -> tuple[Array, Array]:
    """Coefficients (q,) of a weighted fit, and their covariance (q, q)."""
    normal = design.T @ (weight[:, None] * design)
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return covariance @ (design.T @ (weight * values)), covariance


@dataclass(frozen=True)
class Off:
    """How far one run is off the others, and how far a further run of their motor would be off by chance.

    error     standard deviation of that: its own, the mean's, and the scatter from run to run
    freedom   of that error; infinite where the scatter is known
    """

    by: float
    error: float
    freedom: float

    @property
    def chance(self) -> float:
        """Probability that a further run of their motor is off at least so much."""
        return chance_of(self.by / self.error, self.freedom)

    @property
    def half(self) -> float:
        """Half width of the 95 % interval of ``by``."""
        return quantile(self.freedom) * self.error


def off_the_others(values: Array, variances: Array, at: int, known: float | None) -> Off:
    """Run ``at`` beside the others of its kind: beyond their scatter?

    values, variances   (n,), n >= 2; of one number
    known               variance from run to run; None: that of the others, n >= 3
    """
    others = np.delete(np.arange(values.size), at)
    ones = np.ones((others.size, 1))
    between = between_runs(ones, values[others], variances[others]) if known is None else known
    mean, variance = _weighted(ones, values[others], 1.0 / (variances[others] + between))
    return Off(
        float(values[at] - mean[0]),
        math.sqrt(float(variances[at] + between + variance[0, 0])),
        math.inf if known is not None else float(others.size - 1),
    )


@dataclass(frozen=True)
class Slope:
    """A straight line through n runs: its slope, half the width of its 95 % interval, and the chance of such a slope
    without any.
    """

    slope: float
    half: float
    chance: float


def slope(x: Array, values: Array, variances: Array) -> Slope:
    """The trend of n >= 3 values over x, which is not constant, by meta-regression.

    The runs scatter about the line by ``between_runs`` beyond their own variances. The interval takes Student's
    quantile with n - 2 degrees of freedom (Knapp and Hartung, 2003).
    """
    centred = x - x.mean()
    span = float(np.abs(centred).max())
    design = np.column_stack([np.ones(x.size), centred / span])
    between = between_runs(design, values, variances)
    found, covariance = _weighted(design, values, 1.0 / (variances + between))
    error, freedom = math.sqrt(float(covariance[1, 1])), float(x.size - 2)
    ratio = float(found[1]) / error
    return Slope(float(found[1]) / span, quantile(freedom) * error / span, chance_of(ratio, freedom))


def holm(chances: Sequence[float]) -> list[float]:
    """The same chances, corrected for so many looks (Holm, 1979)."""
    order = sorted(range(len(chances)), key=lambda k: chances[k])
    corrected, least = [0.0] * len(chances), 0.0
    for place, k in enumerate(order):
        least = max(least, min(1.0, (len(chances) - place) * chances[k]))
        corrected[k] = least
    return corrected


def quantile(freedom: float) -> float:
    """97.5 % quantile of Student's distribution; of the normal one for infinite freedom."""
    return float(_special().stdtrit(min(freedom, 1e9), 0.975))


def chance_of(ratio: float, freedom: float) -> float:
    """Probability of a ratio at least so far from 0, in Student's distribution.

    ratio     of a number to its standard error
    freedom   degrees of freedom of that error; infinite: it is known
    """
    return float(2.0 * _special().stdtr(min(freedom, 1e9), -abs(ratio)))
