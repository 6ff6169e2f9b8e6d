"""The exact motion under a recorded drive, sample by sample: its states, and its positions with their derivatives."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model.compiled.kernel import kernel
from rig.model.step import (
    Numbers,
    Plant,
    Segment,
    State,
    decay_after,
    direction,
    exponential,
    glide,
    glide_after,
    glide_by,
    next_segment,
    series,
    series_position,
    state_after,
    target_velocity,
)
from rig.model.stribeck import ORDER

Array = NDArray[np.float64]
Drive = tuple[Array, Array, float]  # edges, s, the drives that act from them on, V, and by how much later all do, s


@kernel
def response(motor: Numbers, start: Numbers, drive: Drive, t_s: Array, out: Array) -> None:
    """Fill ``out`` at the times ``t_s`` (n, s, non-decreasing): positions, (n,), or v, y, z, (n, 3).

    start   state at the first sample
    Before its first edge the drive is the drive of that edge.
    """
    plant, state = Plant(*motor), State(*start)
    edge_s, u_V, delay_s = drive
    n, edges = t_s.size, edge_s.size
    c, w = np.zeros(ORDER + 1), np.zeros(ORDER + 1)
    falls = plant.stribeck_rad_s > 0.0
    now = t_s[0]
    j = 0
    while j + 1 < edges and edge_s[j + 1] + delay_s <= now:
        j += 1
    k = 0
    while True:
        end = edge_s[j + 1] + delay_s if j + 1 < edges else math.inf
        drive_V = u_V[j] + plant.bias_V
        while now < end:
            if falls:
                segment = next_segment(plant, state.v, drive_V, end - now, c, w)
            else:  # as next_segment does; the call itself would cost a fifth of the loop
                sign, target, duration_s, reverses = exponential(plant, state.v, drive_V, end - now)
                segment = Segment(False, sign, duration_s, target, 0.0 if reverses else math.nan)
            until = now + segment.duration_s if segment.duration_s < end - now else end
            # numba drops the branches that the shape of `out` rules out, and computes nothing for them
            while segment.is_series and k < n and t_s[k] < until:
                if out.ndim == 1:
                    out[k] = series_position(state, segment.sign * plant.stribeck_rad_s, plant.tau_s, c, t_s[k] - now)
                else:
                    v, y, z = series(state, segment.sign * plant.stribeck_rad_s, plant.tau_s, c, t_s[k] - now)
                    out[k, 0], out[k, 1], out[k, 2] = v, y, z
                k += 1
            while not segment.is_series and k < n and t_s[k] < until:
                if out.ndim == 1:
                    out[k] = glide(state, segment.target_rad_s, plant.tau_s, t_s[k] - now).y
                else:
                    v, y, z = glide(state, segment.target_rad_s, plant.tau_s, t_s[k] - now)
                    out[k, 0], out[k, 1], out[k, 2] = v, y, z
                k += 1
            if k == n:
                return
            state = state_after(plant, segment, c, state) if segment.is_series else glide_after(plant, segment, state)
            now = until
        j += 1


@kernel
def position_and_jacobian(
    motor: Numbers, start: Numbers, drive: Drive, t_s: Array, y_rad: Array, jacobian: Array
) -> None:
    """Fill ``y_rad`` (n,) and ``jacobian`` (n, 7), by tau, K, fc, asym, delay, v0, y0; no Stribeck effect.

    fc is the plant's level in both directions, and asym its bias.
    """
    plant, state = Plant(*motor), State(*start)
    tau, K = plant.tau_s, plant.K_rad_s_V
    edge_s, u_V, delay = drive
    v0, y0 = state.v, state.y
    n, edges = t_s.size, edge_s.size
    now = t_s[0]
    # derivatives of v and y at the segment's begin by (tau, fc, asym, delay, v0)
    vt = vf = va = vd = 0.0
    v_0 = 1.0
    yt = yf = ya = yd = y_0 = 0.0
    j = 0
    while j + 1 < edges and edge_s[j + 1] + delay <= now:
        j += 1
    k = 0
    while True:
        end = edge_s[j + 1] + delay if j + 1 < edges else math.inf
        drive_V = u_V[j] + plant.bias_V
        target = 0.0
        while now < end:
            sign, target, duration_s, reverses = exponential(plant, state.v, drive_V, end - now)
            until = now + duration_s if reverses else end
            tf = -K * sign
            ta = K if sign != 0.0 else 0.0
            excess = state.v - target
            while k < n and t_s[k] < until:
                h = t_s[k] - now
                decay = decay_after(h, tau)
                glide = tau * decay
                drift = h - glide
                at = glide_by(state, target, tau, h, decay).y
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
            decay = decay_after(h, tau)
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
            after = glide_by(state, target, tau, h, decay)
            state = State(0.0, after.y, 0.0) if reverses else after
            now = until
            if reverses:
                before = target
                target = target_velocity(plant, direction(plant, 0.0, drive_V), drive_V)
                jump = target / before
                vt, vf, va, vd, v_0 = vt * jump, vf * jump, va * jump, vd * jump, v_0 * jump
        j += 1
        drive_V = u_V[j] + plant.bias_V
        vd += (target - target_velocity(plant, direction(plant, state.v, drive_V), drive_V)) / tau
