"""An independent peer: the switching conditions of Theorem 2.1 in scalar form, and all of their positive solutions.

Nothing of ``rig.model.limit_cycle`` in it. Dimensionless: time in tau, drive in h2, so that a = h1 / h2 and b = fc / h2
are all that the conditions depend on (durations scale with tau, positions with K tau h2).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

Array = NDArray[np.float64]
Durations = tuple[float, float, float]

SOLVED = 1e-9  # largest residual of a solution, relative
MOST_STARTS = 60
SAME = 1e-6  # relative: closer ones are one solution
START_TAU = (1e-3, 100.0)  # where random durations begin
SCANNED_TAU = (1e-3, 1e3)  # t3 and t2 of the scan
LOGARITHMS = (-40.0, 9.0)  # of durations that are tried


def effective_inputs(a: float, b: float) -> tuple[float, float, float]:
    """Of the three stages, in h2."""
    return a + 1.0 + b, a + 1.0 - b, 1.0 - a - b


def residuals(durations: Array, a: float, b: float) -> Array:
    """Speed at RA, position at RB and the integral of y over the half period, which must be 0, relative to what moves.

    From balances over the half period: v and y end at minus what they begin with, y + v grows by the drive's integral.
    """
    inputs = effective_inputs(a, b)
    left, gone = np.exp(-durations), -np.expm1(-durations)
    forced = 0.0
    for k in range(3):
        forced = forced * left[k] + inputs[k] * gone[k]
    v = [-forced / (1.0 + float(np.prod(left)))]
    y = [-0.5 * (float(np.dot(inputs, durations)) + 2.0 * v[0])]
    area = 0.0
    for k, (U, t) in enumerate(zip(inputs, durations.tolist(), strict=True)):
        area += y[k] * t + 0.5 * U * t * t + (v[k] - U) * (t - gone[k])
        v.append(v[k] * left[k] + U * gone[k])
        y.append(y[k] + U * t - (v[k + 1] - v[k]))
    position = max(map(abs, y))
    return np.array([v[1] / max(map(abs, v)), y[2] / position, area / (position * float(durations.sum()))])


class Search(NamedTuple):
    """What random starts lead to: the solutions that differ, how many starts came to one, and how many were tried."""

    solutions: tuple[Durations, ...]
    arrived: int
    tried: int


def from_random_starts(a: float, b: float, arrivals: int, rng: np.random.Generator) -> Search:
    """Powell's hybrid method on the three equations in the logarithms of t1, t2, t3, from random positive starts.

    Ends when so many ``arrivals`` have come to a solution, or after ``MOST_STARTS``.
    """
    found: list[Durations] = []
    arrived = tried = 0

    def equations(logarithms: Array) -> Array:
        return residuals(np.exp(np.clip(logarithms, *LOGARITHMS)), a, b)

    while arrived < arrivals and tried < MOST_STARTS:
        tried += 1
        begin = rng.uniform(math.log(START_TAU[0]), math.log(START_TAU[1]), 3)
        with np.errstate(all="ignore"):
            end = root(equations, begin, method="hybr", tol=1e-13)
        inside = LOGARITHMS[0] < end.x.min() and end.x.max() < LOGARITHMS[1]
        if not (inside and np.abs(equations(end.x)).max() < SOLVED):
            continue
        arrived += 1
        t1, t2, t3 = (float(value) for value in np.exp(end.x))
        if not any(np.allclose((t1, t2, t3), other, rtol=SAME, atol=0.0) for other in found):
            found.append((t1, t2, t3))
    return Search(tuple(found), arrived, tried)


class Scan(NamedTuple):
    """All that a scan finds.

    branches    most values of t2 that meet the conditions on v and y at one t3
    crossings   changes of sign of the condition on z along them: the number of solutions
    """

    branches: int
    crossings: int


def by_scan(a: float, b: float, rows: int = 240, columns: int = 320) -> Scan:
    """Go through every t3 of a fine grid, find every t2 with v(t1) = 0 = y(t1 + t2), and see where z(0) = 0.

    v(t1) = 0 gives t1 from the speed at RC; v(T/2) = -v(0) > 0 bounds t2 from below where stage 3 brakes.
    """
    inputs = effective_inputs(a, b)
    if inputs[1] <= 0.0:
        return Scan(0, 0)  # the drive never exceeds friction: v cannot become positive
    t3 = np.geomspace(*SCANNED_TAU, rows)
    least = _least(t3, inputs)
    beyond = np.concatenate(([1e-9], np.geomspace(1e-6, 3.0 * SCANNED_TAU[1], columns)))
    sign = np.sign(_position(least[:, None] + beyond, t3[:, None], inputs))
    row, column = np.nonzero(sign[:, 1:] * sign[:, :-1] < 0.0)
    if not row.size:
        return Scan(0, 0)
    t2 = least[row] + _bisected(
        lambda more: _position(least[row] + more, t3[row], inputs), beyond[column], beyond[column + 1]
    )
    # a branch may end between two rows, where t1 = 0
    edge = _position(least, t3, inputs)
    ends = np.flatnonzero(edge[1:] * edge[:-1] < 0.0)
    t3_end = _bisected(lambda at: _position(_least(at, inputs), at, inputs), t3[ends], t3[ends + 1])
    where = np.concatenate((row, ends + 0.5))
    order = np.argsort(where, kind="stable")
    integral = np.concatenate((_integral(t2, t3[row], inputs), _integral(_least(t3_end, inputs), t3_end, inputs)))[
        order
    ]
    next_to = np.diff(where[order]) <= 1.0
    return Scan(int(np.bincount(row).max()), int(np.count_nonzero(next_to & (integral[1:] * integral[:-1] < 0.0))))


def _least(t3: Array, inputs: Durations) -> Array:
    """t2 beyond which the speed at RC is positive; nan where it is so for none."""
    if inputs[2] >= 0.0:
        return np.zeros_like(t3)
    with np.errstate(all="ignore"):
        return np.asarray(-np.log1p(inputs[2] * np.expm1(t3) / inputs[1]))


def _bisected(function: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """Zeros, each between its ``low`` and ``high``, to rounding."""
    at_low = np.sign(function(low))
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = np.sign(function(middle)) == at_low
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(low)


def _speeds(t2: Array, t3: Array, inputs: Durations) -> tuple[Array, Array]:
    """At RB and at RC."""
    at_rb = -inputs[1] * np.expm1(-t2)
    return at_rb, at_rb * np.exp(-t3) - inputs[2] * np.expm1(-t3)


def _position(t2: Array, t3: Array, inputs: Durations) -> Array:
    """0 where the shaft travels as far before RB as after it, which is y(t1 + t2) = 0."""
    at_rb, at_rc = _speeds(t2, t3, inputs)
    with np.errstate(invalid="ignore"):
        t1 = np.log1p(np.maximum(at_rc, 0.0) / inputs[0])
        return np.asarray(inputs[0] * t1 + inputs[1] * t2 - 2.0 * at_rb - inputs[2] * t3)


def _integral(t2: Array, t3: Array, inputs: Durations) -> Array:
    """Of y over the half period, relative."""
    at_rb, at_rc = _speeds(t2, t3, inputs)
    t1 = np.log1p(at_rc / inputs[0])
    y1 = at_rb - inputs[1] * t2
    y0 = y1 - (inputs[0] * t1 - at_rc)
    area = np.zeros_like(t1)
    for y, v, U, t in ((y0, -at_rc, inputs[0], t1), (y1, 0.0, inputs[1], t2), (0.0, at_rb, inputs[2], t3)):
        area += y * t + 0.5 * U * t * t + (v - U) * (t + np.expm1(-t))
    return np.asarray(area / (-y1 * (t1 + t2 + t3)))
