"""Distribution functions: normal, Student's and chi-squared (Abramowitz and Stegun, 1964, chapters 6 and 26).

scipy has them, too; it takes as long to load as a whole identification.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from rig.core.arrays import Array

Z_975 = 1.959963984540054  # the 97.5 % quantile of the normal distribution
MANY = 30.0  # degrees of freedom from which on a series in one over them is exact to 1e-8
FAR_BELOW = -20.0  # from there on an asymptotic series has the logarithm to the last digit
TERMS, CLOSE = 500, 1e-15
HALVINGS = 60

_erfc = np.frompyfunc(math.erfc, 1, 1)


def normal_below(x: Array) -> Array:
    """Probability that a normal variable of mean 0 and variance 1 is below ``x``, any shape, a pure number."""
    return np.asarray(0.5 * _erfc(np.asarray(x) / -math.sqrt(2.0)), dtype=np.float64)


def log_normal_below(x: Array) -> Array:
    """Logarithm of ``normal_below`` of ``x``, any shape, a pure number, also where that is too small for one."""
    far = np.minimum(x, FAR_BELOW)
    square = far**-2.0
    series = 1.0 - square * (1.0 - 3.0 * square * (1.0 - 5.0 * square * (1.0 - 7.0 * square)))
    below = -0.5 * far**2 - np.log(-far * math.sqrt(2.0 * math.pi)) + np.log(series)
    return np.where(x < FAR_BELOW, below, np.log(normal_below(np.maximum(x, FAR_BELOW))))


@cache
def student_975(freedom: float) -> float:
    """The 97.5 % quantile of Student's distribution with ``freedom`` degrees of freedom, > 0."""
    z, v = Z_975, float(freedom)
    if v >= MANY:  # Abramowitz and Stegun 26.7.5
        terms = (
            z**3 + z,
            (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 24.0,
            (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 96.0,
            (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / 23040.0,
        )
        return z + sum(term / (4.0 * v**k) for k, term in enumerate(terms, 1))
    return math.exp(_root(lambda log_t: _student_beyond(math.exp(log_t), v) - 0.05, 0.0, 200.0))


def chi_squared_beyond(freedom: float, square: float) -> float:
    """Probability that chi-squared of ``freedom`` degrees of freedom, > 0, is beyond ``square``, >= 0."""
    return _gamma_beyond(0.5 * freedom, 0.5 * square)


def chi_squared_quantile(freedom: float, chance: float) -> float:
    """What chi-squared of ``freedom`` degrees of freedom, > 0, is beyond with the probability ``chance``, in (0, 1)."""
    return math.exp(_root(lambda log_x: chi_squared_beyond(freedom, math.exp(log_x)) - chance, -700.0, 50.0))


def _root(falls: Callable[[float], float], low: float, high: float) -> float:
    """Where a falling function is 0."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if falls(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)


def _student_beyond(t: float, v: float) -> float:
    """Probability that a variable of Student's distribution is farther than ``t`` from 0: incomplete beta."""
    x = v / (v + t * t)
    a, b = 0.5 * v, 0.5
    front: float = math.exp(math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x)) * (1.0 - x) ** b
    if x < (a + 1.0) / (a + b + 2.0):
        return front * _beta_fraction(a, b, x) / a
    return 1.0 - front * _beta_fraction(b, a, 1.0 - x) / b


def _beta_fraction(a: float, b: float, x: float) -> float:
    """The continued fraction of the incomplete beta function (26.5.8), as Lentz computes one."""

    def numerator(k: int) -> float:
        m = k // 2
        if k % 2:
            return -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0))
        return m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m))

    return 1.0 / _fraction(1.0, numerator, lambda k: 1.0)


def _gamma_beyond(a: float, x: float) -> float:
    """The incomplete gamma function Q(a, x): a series below its middle, a continued fraction above (6.5.29, 6.5.31)."""
    if x <= 0.0:
        return 1.0
    front = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        for k in range(1, 20 * TERMS):
            term *= x / (a + k)
            total += term
            if term < CLOSE * total:
                break
        return 1.0 - front * total
    return front / _fraction(x + 1.0 - a, lambda k: -k * (k - a), lambda k: x + 2 * k + 1.0 - a)


def _fraction(first: float, numerator: Callable[[int], float], denominator: Callable[[int], float]) -> float:
    """A continued fraction: ``first`` + numerator(1) / (denominator(1) + numerator(2) / ...)."""
    value = ratio = first
    inverse = 0.0
    for k in range(1, 20 * TERMS):
        inverse = 1.0 / (denominator(k) + numerator(k) * inverse or 1e-300)
        ratio = denominator(k) + numerator(k) / ratio or 1e-300
        value *= ratio * inverse
        if abs(ratio * inverse - 1.0) < CLOSE:
            break
    return value
