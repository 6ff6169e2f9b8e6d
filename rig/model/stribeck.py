"""Motion under Stribeck friction by Taylor series, its truncation bounded at every step.

While the motor moves one way, with speed x in units of the Stribeck velocity vs and time in units of tau,

    x' = e - x - b expm1(-x),    e = K (D - fs) / vs,    b = K (fs - fc) / vs,    x >= 0

(D: drive along the motion, V; viscous friction is in tau and K already; docs/theory.md 8.1, 8.2). The right side is
analytic, so x is a power series in time, and its integrals, position and integral of position, are too.

The step. With B = b exp(-x0), on the disc |x - x0| <= R the right side is at most M = |x0'| + R + B (exp(R) - 1) and
its slope at most L = 1 + B exp(R). So the solution is analytic, and stays in the disc, at least for |t| < rho =
max(R / M, ln(1 + R L / |x0'|) / L) (Picard; Gronwall). By Cauchy's estimate the k-th term at t is at most
R (t / rho)^k. Steps end at rho / RATIO: what is left off after ORDER is at most R RATIO^-ORDER / (RATIO - 1), 2e-14 R,
and in practice below rounding, because rho is about half of the true radius.

Where b exp(-x) is below rounding the motion has the closed form of docs/theory.md 1.3, and that is used.

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
# Of b: below, friction falls by nothing; above, it does so within 1e-12 tau, and the static level is one of rest only.
SMALLEST, LARGEST = 1e-200, 1e12
JUST_ABOVE = 1.0 + 1e-9  # a glide down to the far speed ends on it, give or take rounding

TRUNCATION = RATIO**-ORDER / (RATIO - 1.0)  # bound of a step's truncation, over R


def far_speed(b: float) -> float:
    """Speed, in vs, from which on the Stribeck effect, ``b``, is below rounding; 0 where there is none."""
    return NEGLIGIBLE + math.log1p(b) if SMALLEST <= b <= LARGEST else 0.0


def is_exponential(x: float, target: float, b: float) -> bool:
    """Whether the motion from speed ``x``, which would tend to ``target`` = e + b, is exponential for a while."""
    if not SMALLEST <= b <= LARGEST:
        return True
    far = far_speed(b)
    return x > JUST_ABOVE * far or x >= far <= target


def expand(x: float, e: float, b: float, c: Room, w: Room) -> float:
    """Fill ``c`` with the coefficients of x(t) about speed ``x``; returns the step, in tau, that they are good for.

    x, e, b   as above, in units of the Stribeck velocity
    ``w`` is room for as many numbers: the coefficients of exp(-x).
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
    """When within (0, h] a falling speed is zero, to rounding; it is > 0 at 0 and <= 0 at h. Newton, kept bracketed."""
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
    """Speed that the motion from ``x`` tends to, in vs; 0 if it comes to rest. ``e``, and ``b`` > 0, as above.

    The right side is concave in x: it has no zero, or an unstable one and, above it, a stable one.
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
