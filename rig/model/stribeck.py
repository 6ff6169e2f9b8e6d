"""Motion under Stribeck friction by Taylor series, with a bound on the truncation at every step.

The motor moves in one direction, with speed x in units of the Stribeck velocity vs and time in units of tau:

    x' = e - x - b expm1(-x),    e = K (D - fs) / vs,    b = K (fs - fc) / vs,    x >= 0

D is the drive along the motion, V. tau and K include viscous friction (docs/theory.md 8.1, 8.2). The right side is
analytic, so x is a power series in time. So are position and integral of position, its integrals.

The step. With B = b exp(-x0), on the disc |x - x0| <= R the right side is at most M = |x0'| + R + B (exp(R) - 1) and
its slope at most L = 1 + B exp(R). So the solution is analytic, and stays in the disc, at least for |t| < rho =
max(R / M, ln(1 + R L / |x0'|) / L) (Picard; Gronwall). By Cauchy's estimate the k-th term at t is at most
R (t / rho)^k. Steps end at rho / RATIO, so the terms beyond ORDER add up to at most R RATIO^-ORDER / (RATIO - 1),
2e-14 R. In practice they are below rounding, because rho is about half of the true radius.

Where b exp(-x) is below rounding, the closed form of docs/theory.md 1.3 takes over.

``rig.model.step`` makes segments of these functions; numba compiles them into the loops of ``rig.model.compiled``.
``c`` is a list or an array of ORDER + 1 coefficients.
"""

from __future__ import annotations

import math
from collections.abc import MutableSequence, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Series = Sequence[float] | Array
Room = MutableSequence[float] | Array

ORDER = 22
RATIO = 4.0
NEGLIGIBLE = 32.0  # exp(-32) = 1.3e-14, against a speed of at least 32: 4e-16 of it
# Range of b. Below it friction does not fall. Above it friction falls within 1e-12 tau: it is static at rest only.
SMALLEST, LARGEST = 1e-200, 1e12
JUST_ABOVE = 1.0 + 1e-9  # a glide down to the far speed ends on it, give or take rounding

TRUNCATION = RATIO**-ORDER / (RATIO - 1.0)  # bound of a step's truncation, over R


def far_speed(b: float) -> float:
    """Speed, in vs, above which the Stribeck effect, ``b``, is below rounding; 0 without Stribeck effect."""
    return NEGLIGIBLE + math.log1p(b) if SMALLEST <= b <= LARGEST else 0.0


def is_exponential(x: float, target: float, b: float) -> bool:
    """Whether the motion from speed ``x`` towards ``target`` = e + b is exponential at first."""
    if not SMALLEST <= b <= LARGEST:
        return True
    far = far_speed(b)
    return x > JUST_ABOVE * far or x >= far <= target


def expand(x: float, e: float, b: float, c: Room, w: Room) -> float:
    """Fill ``c`` with the coefficients of x(t) about speed ``x``. Returns the step, in tau, for which they hold.

    x, e, b   as above, in units of the Stribeck velocity
    w         buffer of the size of ``c``, for the coefficients of exp(-x)
    """
    slope = e - x - b * math.expm1(-x)
    c[0] = x
    c[1] = slope
    w[0] = math.exp(-x)
    steady = b * w[0]
    for k in range(1, ORDER):
        total = 0.0
        for j in range(1, k + 1):
            total += j * c[j] * w[k - j]
        w[k] = -total * (1.0 / k)
        c[k + 1] = -(c[k] + b * w[k]) * (1.0 / (k + 1))
    if slope == 0.0:
        return math.inf
    size = abs(slope)
    growth = (1.0 + size) / steady  # exp(R) - 1
    radius = math.log1p(growth)
    lipschitz = 1.0 + steady * (1.0 + growth)
    by_size = radius / (size + radius + steady * growth)
    by_slope = math.log1p(radius * lipschitz / size) / lipschitz
    return max(by_size, by_slope) / RATIO


def speed_at(c: Series, h: float) -> float:
    """Speed ``h`` after the point of expansion, in vs."""
    x = 0.0
    for k in range(ORDER, -1, -1):
        x = x * h + c[k]
    return x


def path_at(c: Series, h: float) -> float:
    """Path travelled ``h`` after the point of expansion, in vs tau."""
    y = 0.0
    for k in range(ORDER, -1, -1):
        y = y * h + c[k] / (k + 1)
    return y * h


def integral_at(c: Series, h: float) -> float:
    """Integral of that path ``h`` after the point of expansion, in vs tau^2."""
    z = 0.0
    for k in range(ORDER, -1, -1):
        z = z * h + c[k] / ((k + 1) * (k + 2))
    return z * h * h


def rest_within(c: Series, h: float) -> float:
    """Time within (0, h], in tau, at which a falling speed is zero. It is > 0 at 0 and <= 0 at h. Bracketed Newton."""
    before, after = 0.0, h
    t = h
    for _ in range(100):
        x = 0.0
        slope = 0.0
        for k in range(ORDER, -1, -1):
            slope = slope * t + x
            x = x * t + c[k]
        if x > 0.0:
            before = t
        else:
            after = t
        newton = t - x / slope if slope < 0.0 else before
        if abs(newton - t) <= 4e-16 * h:
            return min(max(newton, before), after)
        t = newton if before < newton < after else 0.5 * (before + after)
    return t


def terminal_speed(x: float, e: float, b: float) -> float:
    """Final speed of the motion from ``x``, in vs; 0 if it comes to rest. ``e``, and ``b`` > 0, as above.

    The right side is concave in x. It has no zero, or two: the lower one is unstable, the upper one stable.
    """
    slope = e - x - b * math.expm1(-x)
    if slope == 0.0:
        return x
    top = math.log(b) if b > 1.0 else 0.0  # where the right side is largest
    if slope < 0.0 and (x <= top or e - top - b * math.expm1(-top) <= 0.0):
        return 0.0
    # Newton from above: on a concave function it falls monotonically to the upper zero.
    root = e + b
    for _ in range(200):
        fall = 1.0 - b * math.exp(-root)
        lower = root + (e - root - b * math.expm1(-root)) / fall
        if not top <= lower < root:
            break
        root = lower
    return root
