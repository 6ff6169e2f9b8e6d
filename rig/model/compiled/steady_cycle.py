"""The steady cycle under given edges of the relays, in closed form, with its derivatives.

Velocity is linear in the drive, and w = y + tau v moves in straight lines. So a periodic motion under given edges needs
no iteration. The reversal needs none either: exp(t1 / tau) solves a linear equation.
``rig.identification.triple_relay`` uses it.
"""

from __future__ import annotations

from ctypes import byref
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.model.library import LIBRARY, CycleData, address, given, numbers, require_size

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


def switching_conditions(
    theta: Array, gains: tuple[float, float], durations: tuple[float, float, float]
) -> tuple[Array, Array]:
    """Z at RC, v at RA, y at RB, y at RA, y at RC, (5,), from odd symmetry, and their derivatives, (5, 3).

    theta   log tau, log K, fc; the columns of the Jacobian in this order
    """
    require_size(theta, 3, "theta")
    found = np.empty(CONDITIONS), np.empty((CONDITIONS, 3))
    LIBRARY.cycle_conditions(numbers(*theta), numbers(*gains), numbers(*durations), *map(address, found))
    return found


def curve(
    theta: Array, gains: tuple[float, float], edges: Array, halves: tuple[int, int], t_s: Array
) -> tuple[Array, Array]:
    """Positions of the steady cycle, (n,), and their derivatives, (n, 6).

    theta    log tau, log K, fc, asym, position at the first RC edge, delay of the edges: as the columns
    The rest as in ``Data``.
    """
    require_size(theta, NUMBERS, "theta")
    t = given(t_s)
    data = _cycle(gains, edges)
    data.t_s, data.samples, data.first_half = address(t), t.size, halves[0]
    found = np.empty(t.size), np.empty((t.size, NUMBERS))
    LIBRARY.cycle_curve(numbers(*theta), byref(data), *map(address, found))
    return found


def rows(theta: Array, data: Data) -> tuple[Array, Array]:
    """Weighted residuals (n,) and their Jacobian (n, 6), or without samples those of the conditions, (5,) and (5, 3).

    theta   as for ``curve``, or as for ``switching_conditions``
    """
    count = data.t_s.size or CONDITIONS
    for one in (data.measured, data.weight):
        require_size(one, count, "measured and weight")
    if data.t_s.size:
        values, jacobian = curve(theta, data.gains, data.edges, data.halves, data.t_s)
    else:
        first, second, third = data.edges.tolist()
        values, jacobian = switching_conditions(theta, data.gains, (first, second, third))
    return data.weight * (values - data.measured), data.weight[:, None] * jacobian


def _cycle(gains: tuple[float, float], edges: Array) -> CycleData:
    """Gains and edges alone."""
    data = CycleData()
    data.gains[:] = gains
    data.edges[: len(edges)] = list(edges)
    return data
