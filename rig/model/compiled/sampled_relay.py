"""A whole relay test on the exact motor, tick by tick (see ``rig.model.sampled_relay``)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model.compiled.kernel import kernel
from rig.model.step import Numbers, Plant, State, advance_exponentially

Array = NDArray[np.float64]


Disturbance = tuple[Array, Array, float]  # added to the readings, rad, and to the drives, V; step of the reading, rad


@kernel
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
    h1_V, h2_V = gains_V
    t_s, t_u_s = times_s
    n = t_s.size
    reading_rad, drive_V, lsb_rad = disturbance
    plant, state = Plant(*motor), State(*start)
    z = 0.0
    acting, applied = 0.0, 0
    before = 0.0
    sign_y = sign_z = 0.0
    for k in range(n):
        read = state.y + reading_rad[k]
        if lsb_rad > 0.0:
            read = math.floor(read / lsb_rad + 0.5) * lsb_rad
        if k == 0:
            sign_y = sign_z = 1.0 if read >= 0.0 else -1.0
        else:
            z += (t_s[k] - t_s[k - 1]) * 0.5 * (read + before)
            if z != 0.0:
                sign_z = 1.0 if z > 0.0 else -1.0
        if read != 0.0:
            sign_y = 1.0 if read > 0.0 else -1.0
        before = read
        out[k, 0], out[k, 1], out[k, 2] = read, -h1_V * sign_y - h2_V * sign_z, z
        out[k, 3], out[k, 4] = state.v, state.y
        if k + 1 == n:
            return
        now, until = t_s[k], t_s[k + 1]
        while applied <= k and t_u_s[applied] < until:
            at = max(t_u_s[applied], now)
            state = advance_exponentially(plant, state, acting + drive_V[k], at - now)
            acting = out[applied, 1]
            applied += 1
            now = at
        state = advance_exponentially(plant, state, acting + drive_V[k], until - now)
