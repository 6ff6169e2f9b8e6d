"""A whole relay test on the exact motor, tick by tick (see ``rig.model.sampled_relay``)."""

from __future__ import annotations

from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from rig.model.library import LIBRARY, RelayPlan, address, filled, given, numbers, require_size
from rig.model.step import Numbers

Array = NDArray[np.float64]

Disturbance = tuple[Array, Array, float]  # added to the readings, rad, and to the drives, V; step of the reading, rad


def relay_test(
    motor: Numbers,
    gains_V: tuple[float, float],
    times_s: tuple[Array, Array],
    disturbance: Disturbance,
    start: Numbers,
    out: Array,
) -> None:
    """Fill ``out`` (n, 5): position as read, drive, integral of what was read, true velocity, true position.

    gains_V   h1, h2
    times_s   of the samples, and at which each sample's drive acts
    """
    series = [given(one) for one in (*times_s, *disturbance[:2])]
    n = series[0].size
    for one in series:
        require_size(one, n, "series of a relay test")
    plan = RelayPlan(*(address(one) for one in series), *gains_V, disturbance[2], n)
    LIBRARY.relay_test(numbers(*motor), byref(plan), numbers(*start), filled(out, n, 5))
