"""A whole relay test on the exact motor, tick by tick (see ``rig.model.sampled_relay``)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def advance(
    motor: tuple[float, float, float, float, float, float, float], v: float, y: float, u_V: float, dt_s: float
) -> tuple[float, float]:
    """Velocity and position after ``dt_s`` of constant drive, through a reversal; as ``Motor.advance``."""
    tau, K, plus, minus, static_plus, static_minus, bias = motor
    drive = u_V + bias
    left = dt_s
    while left > 0.0:
        if v > 0.0 or (v == 0.0 and drive > static_plus):
            target = K * (drive - plus)
        elif v < 0.0 or drive < -static_minus:
            target = K * (drive + minus)
        else:
            return 0.0, y
        reversal = tau * math.log1p(-v / target) if v < 0.0 < target or target < 0.0 < v else math.inf
        h = min(reversal, left)
        decay = -math.expm1(-h / tau)
        excess = v - target
        y += target * h + excess * tau * decay
        v = 0.0 if reversal < left else v - excess * decay
        left -= h
    return v, y


@njit(cache=True)
def relay_test(
    motor: tuple[float, float, float, float, float, float, float],
    h1_V: float,
    h2_V: float,
    t_s: Array,
    t_u_s: Array,
    disturbance_rad: Array,
    disturbance_V: Array,
    lsb_rad: float,
    start: tuple[float, float],
    out: Array,
) -> None:
    """Fill ``out`` (n, 5): position as read, drive, integral, true velocity, true position."""
    n = t_s.size
    v, y = start
    z = 0.0
    acting, applied = 0.0, 0
    before = 0.0
    sign_y = sign_z = 0.0
    for k in range(n):
        read = y + disturbance_rad[k]
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
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = read, -h1_V * sign_y - h2_V * sign_z, z, v, y
        if k + 1 == n:
            return
        now, until = t_s[k], t_s[k + 1]
        while applied <= k and t_u_s[applied] < until:
            at = max(t_u_s[applied], now)
            v, y = advance(motor, v, y, acting + disturbance_V[k], at - now)
            acting = out[applied, 1]
            applied += 1
            now = at
        v, y = advance(motor, v, y, acting + disturbance_V[k], until - now)
