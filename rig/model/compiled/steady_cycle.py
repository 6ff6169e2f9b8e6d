"""The steady cycle under given edges of the relays, in closed form, with its derivatives, and fits to it.

Velocity is linear in the drive, and w = y + tau v moves in straight lines. So a periodic motion under given edges needs
no iteration. The reversal needs none either: exp(t1 / tau) solves a linear equation.
``rig.identification.triple_relay`` uses it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.model.library import LIBRARY, CycleData, CycleSearch, address, filled, given, numbers, require_size, room

Array = NDArray[np.float64]
CONDITIONS = 5
NUMBERS = 6


class Data(NamedTuple):
    """What a cycle is fitted to.

    gains       h1, h2, V
    edges       time from RC to RB and to the next RC, in the half that starts upwards and in the other, s, (4,); or the
                three durations, s
    halves      number of samples in each half; those of the second are folded (position and drive negated)
    t_s         times since the half's own RC edge as recorded, before the delay, (n,), s; none for the five conditions
    measured    target of the curve, (n,), or of the conditions, (5,)
    weight      one over the size of an error, of the same shape
    """

    gains: tuple[float, float]
    edges: Array
    halves: tuple[int, int]
    t_s: Array
    measured: Array
    weight: Array


class Search(NamedTuple):
    """How theta is searched.

    low, high   its range. The delay goes up to its bounds and stays there
    tolerance   steps that end the search
    damping     of the first step
    """

    low: Array
    high: Array
    tolerance: Array
    damping: float


def switching_conditions(
    theta: Array, gains: tuple[float, float], durations: tuple[float, float, float], values: Array, jacobian: Array
) -> None:
    """Fill ``values`` (5,): z at RC, v at RA, y at RB, y at RA, y at RC, from odd symmetry, and ``jacobian`` (5, 3).

    theta   log tau, log K, fc; the columns of the Jacobian in this order
    """
    require_size(theta, 3, "theta")
    into = filled(values, CONDITIONS), filled(jacobian, CONDITIONS, 3)
    LIBRARY.cycle_conditions(numbers(*theta), numbers(*gains), numbers(*durations), *into)


def reversal_times(theta: Array, gains: tuple[float, float], edges: Array) -> tuple[float, float]:
    """Times of the reversal in both halves, s; 0 where the motor stops before the RC edge.

    theta, gains, edges   as for ``curve``: edges in s
    """
    require_size(theta, NUMBERS, "theta")
    times = numbers(0.0, 0.0)
    LIBRARY.cycle_reversal_times(numbers(*theta), byref(_cycle(gains, edges)), times)
    return times[0], times[1]


def curve(
    theta: Array, gains: tuple[float, float], edges: Array, halves: tuple[int, int], t_s: Array, y: Array, jac: Array
) -> None:
    """Fill ``y`` (n,) with positions of the steady cycle, and ``jac`` (n, 6) with their derivatives.

    theta    log tau, log K, fc, asym, position at the first RC edge, delay of the edges: as the columns of ``jac``
    The rest as in ``Data``.
    """
    require_size(theta, NUMBERS, "theta")
    t = given(t_s)
    data = _cycle(gains, edges)
    data.t_s, data.samples, data.first_half = address(t), t.size, halves[0]
    LIBRARY.cycle_curve(numbers(*theta), byref(data), filled(y, t.size), filled(jac, t.size, NUMBERS))


def solve(theta: Array, free: Sequence[bool], data: Data, search: Search, iterates: Array) -> tuple[int, float]:
    """Damped Gauss-Newton; changes ``theta`` where ``free``.

    theta      (6,) as for ``curve``, or (3,) as for ``switching_conditions``
    iterates   (m, 3) or (m, 6): filled with theta at each iteration, the start first
    Returns the number of iterates and the sum of squares. The damping grows until a step lowers the sum, then it falls.
    """
    t, measured, weight = given(data.t_s), given(data.measured), given(data.weight)
    low, high, tolerance = given(search.low), given(search.high), given(search.tolerance)
    n, p = t.size or CONDITIONS, theta.size
    require_size(theta, NUMBERS if t.size else 3, "theta")
    for one in (measured, weight):
        require_size(one, n, "measured and weight")
    for one in (low, high, tolerance):
        require_size(one, p, "range and tolerance")
    cycle = _cycle(data.gains, data.edges)
    cycle.t_s, cycle.measured, cycle.weight = address(t), address(measured), address(weight)
    cycle.samples, cycle.first_half = t.size, data.halves[0]
    wanted = CycleSearch(*(address(one) for one in (low, high, tolerance)), search.damping, iterates.shape[0])
    work, cost = room(2 * n * (1 + p)), ctypes.c_double()
    moving = (ctypes.c_uint8 * p)(*map(bool, free))
    into = filled(theta, p), filled(iterates, iterates.shape[0], p)
    count = LIBRARY.cycle_solve(into[0], p, moving, byref(cycle), byref(wanted), address(work), into[1], byref(cost))
    return count, cost.value


def _cycle(gains: tuple[float, float], edges: Array) -> CycleData:
    """Gains and edges alone."""
    data = CycleData()
    data.gains[:] = gains
    data.edges[: len(edges)] = list(edges)
    return data
