"""The exact motion under a recorded drive, with its derivatives, sample by sample (see ``rig.model.sensitivity``)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def target_velocity(v: float, u_V: float, fc_V: float, fs_V: float, K: float) -> tuple[float, float]:
    """Velocity that the motion tends to, rad/s, and its direction (0: held by friction)."""
    if v > 0.0 or (v == 0.0 and u_V > fs_V):
        return K * (u_V - fc_V), 1.0
    if v < 0.0 or u_V < -fs_V:
        return K * (u_V + fc_V), -1.0
    return 0.0, 0.0


@njit(cache=True)
def position(
    theta: tuple[float, float, float, float, float, float, float],
    fs_V: float,
    edge_s: Array,
    u_V: Array,
    t_s: Array,
    y_rad: Array,
) -> None:
    """Fill ``y_rad`` with the positions at the times ``t_s``."""
    tau, K, fc, asym, delay, v, y = theta
    n, edges = t_s.size, edge_s.size
    now = t_s[0]
    j = 0
    while j + 1 < edges and edge_s[j + 1] + delay <= now:
        j += 1
    target, _ = target_velocity(v, u_V[j] + asym, fc, fs_V, K)
    k = 0
    while True:
        end = edge_s[j + 1] + delay if j + 1 < edges else math.inf
        while True:
            reversal = now + tau * math.log1p(-v / target) if v < 0.0 < target or target < 0.0 < v else math.inf
            reverses = reversal < end
            until = reversal if reverses else end
            excess = v - target
            while k < n and t_s[k] < until:
                h = t_s[k] - now
                y_rad[k] = y + target * h - excess * tau * math.expm1(-h / tau)
                k += 1
            if k == n:
                return
            h = until - now
            decay = -math.expm1(-h / tau)
            y += target * h + excess * tau * decay
            v = target + excess * (1.0 - decay)
            now = until
            if not reverses:
                break
            v = 0.0
            target, _ = target_velocity(0.0, u_V[j] + asym, fc, fs_V, K)
        j += 1
        target, _ = target_velocity(v, u_V[j] + asym, fc, fs_V, K)


@njit(cache=True)
def position_and_jacobian(
    theta: tuple[float, float, float, float, float, float, float],
    fs_V: float,
    edge_s: Array,
    u_V: Array,
    t_s: Array,
    y_rad: Array,
    jacobian: Array,
) -> None:
    """Fill ``y_rad`` (n,) and ``jacobian`` (n, 7), by tau, K, fc, asym, delay, v0, y0."""
    tau, K, fc, asym, delay, v0, y0 = theta
    n, edges = t_s.size, edge_s.size
    now, v, y = t_s[0], v0, y0
    # derivatives of v and y at the segment's begin by (tau, fc, asym, delay, v0)
    vt = vf = va = vd = 0.0
    v_0 = 1.0
    yt = yf = ya = yd = y_0 = 0.0
    j = 0
    while j + 1 < edges and edge_s[j + 1] + delay <= now:
        j += 1
    target, sign = target_velocity(v, u_V[j] + asym, fc, fs_V, K)
    k = 0
    while True:
        end = edge_s[j + 1] + delay if j + 1 < edges else math.inf
        while True:
            reversal = now + tau * math.log1p(-v / target) if v < 0.0 < target or target < 0.0 < v else math.inf
            reverses = reversal < end
            until = reversal if reverses else end
            tf = -K * sign
            ta = K if sign != 0.0 else 0.0
            excess = v - target
            while k < n and t_s[k] < until:
                h = t_s[k] - now
                decay = -math.expm1(-h / tau)
                glide = tau * decay
                drift = h - glide
                at = y + target * h + excess * glide
                y_rad[k] = at
                jacobian[k, 0] = yt + vt * glide + excess * (decay - h / tau * (1.0 - decay))
                # the motion is linear in K at a given v0 / K
                jacobian[k, 5] = y_0 + v_0 * glide
                jacobian[k, 1] = (at - y0 - v0 * jacobian[k, 5]) / K
                jacobian[k, 2] = yf + vf * glide + tf * drift
                jacobian[k, 3] = ya + va * glide + ta * drift
                jacobian[k, 4] = yd + vd * glide
                jacobian[k, 6] = 1.0
                k += 1
            if k == n:
                return
            h = until - now
            decay = -math.expm1(-h / tau)
            keep = 1.0 - decay
            glide = tau * decay
            drift = h - glide
            yt += vt * glide + excess * (decay - h / tau * keep)
            yf += vf * glide + tf * drift
            ya += va * glide + ta * drift
            yd += vd * glide
            y_0 += v_0 * glide
            vt = vt * keep + excess * keep * h / (tau * tau)
            vf = vf * keep + tf * decay
            va = va * keep + ta * decay
            vd *= keep
            v_0 *= keep
            y += target * h + excess * glide
            v = target + excess * keep
            now = until
            if not reverses:
                break
            v = 0.0
            before = target
            target, sign = target_velocity(0.0, u_V[j] + asym, fc, fs_V, K)
            jump = target / before
            vt, vf, va, vd, v_0 = vt * jump, vf * jump, va * jump, vd * jump, v_0 * jump
        j += 1
        before = target
        target, sign = target_velocity(v, u_V[j] + asym, fc, fs_V, K)
        vd += (before - target) / tau
