"""Motion under Stribeck friction by Taylor series, with a bound on the truncation at every step.

The motor moves in one direction, with speed x in units of the Stribeck velocity vs and time in units of tau:

    x' = e - x - b expm1(-x),    e = K (D - fs) / vs,    b = K (fs - fc) / vs,    x >= 0

D is the drive along the motion, V. tau and K include viscous friction (docs/theory.md 8.1, 8.2). It is computed in C:
firmware/motor/plain_motor.c has the derivation of step and bound.
"""

from __future__ import annotations

from collections.abc import Sequence

from rig.model.library import LIBRARY, numbers

ORDER = 22
RATIO = 4.0  # of the radius to which a series surely converges, over its step
TRUNCATION = RATIO**-ORDER / (RATIO - 1.0)  # bound of a step's truncation, over R


def expand(x: float, e: float, b: float) -> tuple[float, tuple[float, ...]]:
    """The step, in tau, for which the series of x(t) about speed ``x`` holds, and its ORDER + 1 coefficients.

    x, e, b   as above, in units of the Stribeck velocity
    """
    coefficients = numbers(*[0.0] * (ORDER + 1))
    step: float = LIBRARY.series_expand(x, e, b, coefficients)
    return step, tuple(coefficients)


def speed_at(coefficients: Sequence[float], h: float) -> float:
    """Speed ``h`` after the point of expansion, in vs."""
    speed: float = LIBRARY.series_speed(numbers(*coefficients), h)
    return speed
