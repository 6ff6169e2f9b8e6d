"""The motion of a real motor under a recorded drive: readings of its sensor, and their derivatives (theory 12.3)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model.compiled.kernel import kernel
from rig.model.real_step import (
    Frame,
    RealMotor,
    State,
    behind_play,
    direction,
    force,
    level_at_rest,
    level_of_bristles,
    mean_cosine,
    next_step,
    phi4,
    reading,
    staged,
    target,
)

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

NUMBERS = len(RealMotor._fields)
V0, Y0 = NUMBERS, NUMBERS + 1  # columns of a piece's start, behind the numbers of the motor
TAU, K, FC, BIAS, DELAY = (RealMotor._fields.index(n) for n in ("tau_s", "K_rad_s_V", "fc_V", "bias_V", "delay_s"))
DEAD_BAND, GAIN, SAG = (RealMotor._fields.index(n) for n in ("dead_band_V", "gain_by_sign", "sag_per_V"))
LAG, VISCOUS = (RealMotor._fields.index(n) for n in ("lag_s", "viscous_by_direction_V_s_rad"))
STATIC, STRIBECK, UNIT = (RealMotor._fields.index(n) for n in ("static_V", "stribeck_V", "stribeck_rad_s"))
DRAG, BRISTLE = (RealMotor._fields.index(n) for n in ("drag_V_s2_rad2", "bristle_V_rad"))
FORCE, FRICTION = (RealMotor._fields.index(n) for n in ("force_sin_V", "friction_sin_V"))  # and the cosines behind
COGGING, ORDER = (RealMotor._fields.index(n) for n in ("cogging_sin_V", "cogging_per_rad"))
BACKLASH, LINEARITY, DRIFT = (RealMotor._fields.index(n) for n in ("backlash_rad", "linearity_sin1_rad", "drift"))

# Which of the derivatives cost a function of their own: over position, over the cogging, over speed.
Used = tuple[bool, bool, bool]


@kernel
def _level_slopes(
    motor: RealMotor, frame: Frame, used: Used, at: tuple[float, float, float], out: Array
) -> tuple[float, float]:
    """Fill ``out`` with the derivatives of the level by the motor's numbers; returns those by speed and position.

    at   speed, rad/s, position, rad, and time, s
    """
    speed, y, t = at
    position, _, stribeck = used
    course = (t - frame.start_s) / frame.duration_s - 0.5
    out[FC] = 1.0 + motor.drift * course
    out[DRIFT] = motor.fc_V * course
    by_speed = by_y = 0.0
    if position:
        q = y - frame.centre_rad
        sine, cosine = math.sin(q), math.cos(q)
        out[FRICTION], out[FRICTION + 1] = sine, cosine - mean_cosine(frame)
        by_y = motor.friction_sin_V * cosine - motor.friction_cos_V * sine
    if stribeck and motor.stribeck_rad_s > 0.0:
        share = math.exp(-speed / motor.stribeck_rad_s)
        out[STRIBECK] = share
        out[UNIT] = motor.stribeck_V * share * speed / (motor.stribeck_rad_s * motor.stribeck_rad_s)
        by_speed = -motor.stribeck_V * share / motor.stribeck_rad_s
    return by_speed, by_y


@kernel
def _slopes(
    motor: RealMotor, frame: Frame, used: Used, sign: float, at: State, when: tuple[float, float], out: Array
) -> tuple[float, float, float, float, float]:
    """Fill ``out`` (2, n) with derivatives of the target velocity and the bristles' rate by the motor's numbers.

    when   time, s, and the target velocity there, rad/s
    Returns the derivatives of the target velocity by v and y, and of the rate by v, y, f.
    """
    t, aim = when
    gain, v, y = motor.K_rad_s_V, at.v, at.y
    speed = sign * v
    out[0, K] = aim / gain
    out[0, BIAS] = gain
    out[0, VISCOUS] = -gain * speed
    out[0, DRAG] = -gain * v * speed
    by_v = -gain * (motor.viscous_by_direction_V_s_rad * sign + 2.0 * motor.drag_V_s2_rad2 * speed)
    by_y = 0.0
    position, cogging, _ = used
    if position:
        q = y - frame.centre_rad
        sine, cosine = math.sin(q), math.cos(q)
        out[0, FORCE], out[0, FORCE + 1] = -gain * sine, -gain * (cosine - mean_cosine(frame))
        by_y -= gain * (motor.force_sin_V * cosine - motor.force_cos_V * sine)
    if cogging:
        q = motor.cogging_per_rad * y
        sine, cosine = math.sin(q), math.cos(q)
        slope = motor.cogging_sin_V * cosine - motor.cogging_cos_V * sine
        out[0, COGGING], out[0, COGGING + 1], out[0, ORDER] = -gain * sine, -gain * cosine, -gain * y * slope
        by_y -= gain * motor.cogging_per_rad * slope
    by_speed, by_place = _level_slopes(motor, frame, used, (speed, y, t), out[1])
    if motor.bristle_V_rad <= 0.0:
        for k in (FC, DRIFT, FRICTION, FRICTION + 1, STRIBECK, UNIT):
            out[0, k] = -gain * sign * out[1, k]
        return by_v - gain * by_speed, by_y - gain * sign * by_place, 0.0, 0.0, 0.0
    stiffness, floor = motor.bristle_V_rad, level_of_bristles(motor, frame, speed, y, t)
    share = at.f / floor
    by_level = stiffness * speed * share / floor
    for k in (FC, DRIFT, FRICTION, FRICTION + 1, STRIBECK, UNIT):
        out[1, k] *= by_level
    out[1, BRISTLE] = v - speed * share
    return (
        by_v,
        by_y,
        stiffness * (1.0 - sign * share) + by_level * sign * by_speed,
        by_level * by_place,
        -stiffness * speed / floor,
    )


@kernel
def _staged_slopes(motor: RealMotor, u_V: float, out: Array) -> None:
    """Fill ``out`` at the numbers of the drive stage with the derivatives of the drive behind it, V per unit."""
    out[DEAD_BAND] = out[GAIN] = out[SAG] = 0.0
    rest = abs(u_V) - motor.dead_band_V
    if rest > 0.0:
        sign = 1.0 if u_V > 0.0 else -1.0
        share = 1.0 + sign * motor.gain_by_sign
        size = rest * share
        slope = sign * (1.0 - 2.0 * motor.sag_per_V * size)
        out[DEAD_BAND], out[GAIN], out[SAG] = -slope * share, slope * sign * rest, -sign * size * size


@kernel
def _acceleration(motor: RealMotor, frame: Frame, at: State, staged_V: float, t_s: float) -> float:
    """Acceleration, rad/s2; 0 of a motor that friction holds."""
    sign = direction(motor, frame, at, staged_V, t_s)
    return 0.0 if sign == 0.0 else (target(motor, frame, sign, at, t_s) - at.v) / motor.tau_s


@kernel
def _reading_slopes(motor: RealMotor, frame: Frame, x: float, out: Array) -> float:
    """Fill ``out`` (4,) with the derivatives of the reading by the linearity; returns the one by ``x``."""
    share = (x - frame.centre_rad) / frame.half_travel_rad
    q = math.pi * share
    out[0], out[1] = math.sin(q) - 3.0 / math.pi * share, math.cos(q)
    out[2], out[3] = math.sin(2.0 * q) + 1.5 / math.pi * share, math.cos(2.0 * q)
    slope = motor.linearity_sin1_rad * (math.pi * math.cos(q) - 3.0 / math.pi)
    slope -= motor.linearity_cos1_rad * math.pi * math.sin(q)
    slope += motor.linearity_sin2_rad * (2.0 * math.pi * math.cos(2.0 * q) + 1.5 / math.pi)
    slope -= motor.linearity_cos2_rad * 2.0 * math.pi * math.sin(2.0 * q)
    return 1.0 + slope / frame.half_travel_rad


@kernel
def readings(
    numbers: tuple[tuple[float, ...], tuple[float, ...]],
    drive: tuple[Array, Array],
    t_s: Array,
    pieces: tuple[Rows, Array],
    free: Rows,
    out: tuple[Array, Array],
) -> None:
    """Fill the readings (n,) and their Jacobian (n, c): by the c - 2 numbers ``free``, and by the own piece's start.

    numbers   of the motor and of its frame
    drive     edges, s, and drives that act from them on, V; before the first edge the drive is that edge's
    pieces    first rows (p,), increasing from 0 on, and starts (p, 4): v0, rad/s, y0, rad, side of the play, -1 to 1,
              and how far the bristles are bent, -1 to 1; 0: they balance the drive
    out       readings, rad, and Jacobian. One of no columns: it is left out
    """
    motor, frame = RealMotor(*numbers[0]), Frame(*numbers[1])
    edge_s, u_V = drive
    first, starts = pieces
    y_rad, jacobian = out
    n, edges, columns = t_s.size, edge_s.size, jacobian.shape[1]
    tau, gain = motor.tau_s, motor.K_rad_s_V
    which = np.empty(columns, dtype=np.int64)
    position = (
        motor.friction_sin_V != 0.0
        or motor.friction_cos_V != 0.0
        or motor.force_sin_V != 0.0
        or motor.force_cos_V != 0.0
    )
    cogging = motor.cogging_sin_V != 0.0 or motor.cogging_cos_V != 0.0
    for i in range(columns):
        which[i] = free[i] if i < columns - 2 else NUMBERS + i - (columns - 2)
    use = (position, cogging, motor.stribeck_V != 0.0)
    # derivatives of v, y, f and x by each column, of the drive before and behind the lag, and of the inner stages
    dv, dy, df, dx = np.zeros(columns), np.zeros(columns), np.zeros(columns), np.zeros(columns)
    dw, ds = np.zeros(NUMBERS + 2), np.zeros(NUMBERS + 2)
    slopes = np.zeros((4, 2, NUMBERS + 2))
    bent = np.zeros(NUMBERS + 2)
    curve = np.zeros(4)
    # the drive behind its stage at the first sample, from all edges before it
    j = 0
    staged_V = staged(motor, u_V[0])
    _staged_slopes(motor, u_V[0], ds)
    w, begun = staged_V, min(t_s[0], edge_s[0] + motor.delay_s)
    for i in range(NUMBERS):
        dw[i] = ds[i]
    for piece in range(first.size):
        k = first[piece]
        last = first[piece + 1] if piece + 1 < first.size else n
        now = t_s[k]
        # through the edges since the last piece
        while True:
            edge = edge_s[j + 1] + motor.delay_s if j + 1 < edges else math.inf
            passed = edge <= now
            until = edge if passed else now
            if until > begun:
                keep = math.exp(-(until - begun) / motor.lag_s) if motor.lag_s > 0.0 else 0.0
                for i in range(NUMBERS):
                    dw[i] = ds[i] + (dw[i] - ds[i]) * keep
                if motor.lag_s > 0.0:
                    dw[LAG] += (w - staged_V) * keep * (until - begun) / (motor.lag_s * motor.lag_s)
                w = staged_V + (w - staged_V) * keep
                begun = until
            if not passed:
                break
            j += 1
            before = staged_V
            staged_V = staged(motor, u_V[j])
            _staged_slopes(motor, u_V[j], ds)
            if motor.lag_s > 0.0:
                dw[DELAY] += (before - staged_V) / motor.lag_s
            else:
                w = staged_V
                for i in range(NUMBERS):
                    dw[i] = ds[i]
        # the start of the piece
        v0, y0, side, bend = starts[piece, 0], starts[piece, 1], starts[piece, 2], starts[piece, 3]
        at = State(v0, y0 + 0.5 * side * motor.backlash_rad, 0.0, w, y0)
        for i in range(columns):
            dv[i] = 1.0 if which[i] == V0 else 0.0
            dx[i] = 1.0 if which[i] == Y0 else 0.0
            dy[i] = dx[i] + (0.5 * side if which[i] == BACKLASH else 0.0)
            df[i] = 0.0
        if motor.bristle_V_rad > 0.0:
            floor = level_of_bristles(motor, frame, abs(v0), at.y, now)
            pull = w + motor.bias_V - force(motor, frame, at.y)
            if bend == 0.0 and abs(pull) > floor:
                bend = 1.0 if pull > 0.0 else -1.0
            balance = bend == 0.0
            at = State(at.v, at.y, pull if balance else bend * floor, at.w, at.x)
            if columns:
                aim = target(motor, frame, 1.0, at, now)
                _, by_y, _, _, _ = _slopes(motor, frame, use, 1.0, at, (now, aim), slopes[0])
                bent[:] = 0.0
                by_speed, by_place = _level_slopes(motor, frame, use, (abs(v0), at.y, now), bent)
                for i in range(columns):
                    p = which[i]
                    if balance:
                        known = p == BIAS or FORCE <= p <= FORCE + 1 or COGGING <= p <= ORDER
                        df[i] = by_y * dy[i] / gain + dw[p] + (slopes[0, 0, p] / gain if known else 0.0)
                    else:
                        slope = by_speed if v0 > 0.0 else -by_speed
                        df[i] = bend * (bent[p] + slope * dv[i] + by_place * dy[i])
        while True:
            edge = edge_s[j + 1] + motor.delay_s if j + 1 < edges else math.inf
            while True:
                while k < last and t_s[k] <= now:
                    y_rad[k] = reading(motor, frame, at.x)
                    if columns:
                        by_x = _reading_slopes(motor, frame, at.x, curve)
                        for i in range(columns):
                            p = which[i] - LINEARITY
                            jacobian[k, i] = by_x * dx[i] + (curve[p] if 0 <= p < 4 else 0.0)
                    k += 1
                if k == last or now >= edge:
                    break
                end = min(edge, t_s[k])
                step = next_step(motor, frame, at, staged_V, now, end - now)
                h = step.duration_s
                sign = step.sign
                if columns:
                    keep = math.exp(-h / motor.lag_s) if motor.lag_s > 0.0 else 0.0
                    half = math.sqrt(keep)
                    faded = at.w - staged_V
                    if sign != 0.0:
                        s = step.stages
                        w2, w4 = staged_V + faded * half, step.end.w
                        # derivatives of the weights by tau
                        c = h / tau
                        p4 = phi4(c)
                        p3 = 1.0 / 6.0 - c * p4
                        p2 = 0.5 - c * p3
                        p1 = 1.0 - c * p2
                        e = 1.0 - c * p1
                        e2 = math.sqrt(e)
                        b1, b2, b4 = c * (p1 - 3.0 * p2 + 4.0 * p3), c * (2.0 * p2 - 4.0 * p3), c * (4.0 * p3 - p2)
                        q1, q2, q3 = p1 - p2, p2 - 2.0 * p3, p3 - 3.0 * p4  # derivatives of p1 .. p3 by -c
                        scale = -c / tau
                        e_tau, e2_tau = -scale * e, -0.5 * scale * e2
                        b1_tau = scale * (b1 / c - c * (q1 - 3.0 * q2 + 4.0 * q3))
                        b2_tau = scale * (b2 / c - c * (2.0 * q2 - 4.0 * q3))
                        b4_tau = scale * (b4 / c - c * (4.0 * q3 - q2))
                        at2, at3 = State(s.v2, s.y2, s.f2, w2, 0.0), State(s.v3, s.y3, s.f3, w2, 0.0)
                        at4 = State(s.v4, s.y4, s.f4, w4, 0.0)
                        middle = now + 0.5 * h
                        v1, y1, rv1, ry1, rf1 = _slopes(motor, frame, use, sign, at, (now, s.a1), slopes[0])
                        v2, y2, rv2, ry2, rf2 = _slopes(motor, frame, use, sign, at2, (middle, s.a2), slopes[1])
                        v3, y3, rv3, ry3, rf3 = _slopes(motor, frame, use, sign, at3, (middle, s.a3), slopes[2])
                        v4, y4, rv4, ry4, rf4 = _slopes(motor, frame, use, sign, at4, (now + h, s.a4), slopes[3])
                        bristles = motor.bristle_V_rad > 0.0
                        by_f = -gain if bristles else 0.0
                        for i in range(columns):
                            p = which[i]
                            tau_1 = 1.0 if p == TAU else 0.0
                            mid = ds[p] + (dw[p] - ds[p]) * half
                            far = ds[p] + (dw[p] - ds[p]) * keep
                            if p == LAG and motor.lag_s > 0.0:
                                mid += faded * half * 0.5 * h / (motor.lag_s * motor.lag_s)
                                far += faded * keep * h / (motor.lag_s * motor.lag_s)
                            dp = dy[i] + tau * dv[i] + tau_1 * at.v
                            a1 = v1 * dv[i] + y1 * dy[i] + by_f * df[i] + gain * dw[p] + slopes[0, 0, p]
                            dv2 = e2 * dv[i] + (1.0 - e2) * a1 + tau_1 * e2_tau * (at.v - s.a1)
                            dy2 = dp + 0.5 * h * a1 - tau * dv2 - tau_1 * s.v2
                            df2 = df[i]
                            r1 = r2 = r3 = r4 = 0.0
                            if bristles:
                                r1 = rv1 * dv[i] + ry1 * dy[i] + rf1 * df[i] + slopes[0, 1, p]
                                df2 = df[i] + 0.5 * h * r1
                                r2 = rv2 * dv2 + ry2 * dy2 + rf2 * df2 + slopes[1, 1, p]
                            a2 = v2 * dv2 + y2 * dy2 + by_f * df2 + gain * mid + slopes[1, 0, p]
                            dv3 = e2 * dv[i] + (1.0 - e2) * a2 + tau_1 * e2_tau * (at.v - s.a2)
                            dy3 = dp + 0.5 * h * a2 - tau * dv3 - tau_1 * s.v3
                            df3 = df[i] + 0.5 * h * r2
                            if bristles:
                                r3 = rv3 * dv3 + ry3 * dy3 + rf3 * df3 + slopes[2, 1, p]
                            a3 = v3 * dv3 + y3 * dy3 + by_f * df3 + gain * mid + slopes[2, 0, p]
                            aim = 2.0 * a3 - a1
                            dv4 = e2 * dv2 + (1.0 - e2) * aim + tau_1 * e2_tau * (s.v2 - 2.0 * s.a3 + s.a1)
                            dy4 = dp + h * a3 - tau * dv4 - tau_1 * s.v4
                            df4 = df[i] + h * r3
                            if bristles:
                                r4 = rv4 * dv4 + ry4 * dy4 + rf4 * df4 + slopes[3, 1, p]
                            a4 = v4 * dv4 + y4 * dy4 + by_f * df4 + gain * far + slopes[3, 0, p]
                            new = e * dv[i] + b1 * a1 + b2 * (a2 + a3) + b4 * a4
                            new += tau_1 * (e_tau * at.v + b1_tau * s.a1 + b2_tau * (s.a2 + s.a3) + b4_tau * s.a4)
                            dy[i] = dp + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4) - tau * new - tau_1 * step.end.v
                            dv[i] = new
                            df[i] += h / 6.0 * (r1 + 2.0 * (r2 + r3) + r4)
                    else:
                        dv[:] = 0.0
                    for i in range(NUMBERS):
                        dw[i] = ds[i] + (dw[i] - ds[i]) * keep
                    if motor.lag_s > 0.0:
                        dw[LAG] += faded * keep * h / (motor.lag_s * motor.lag_s)
                x = behind_play(motor, sign, step.end)
                engaged = sign != 0.0 and sign * (step.end.y - at.x) >= 0.5 * motor.backlash_rad
                at_end = State(step.end.v, step.end.y, step.end.f, step.end.w, x)
                if h >= end - now:
                    now = end
                else:
                    now += h
                if columns:
                    if engaged:
                        for i in range(columns):
                            dx[i] = dy[i] - (0.5 * sign if which[i] == BACKLASH else 0.0)
                    if step.reverses:
                        slowing = (target(motor, frame, sign, at_end, now) - at_end.v) / tau
                        after = _acceleration(motor, frame, at_end, staged_V, now)
                        jump = after / slowing if slowing != 0.0 else 0.0
                        for i in range(columns):
                            dv[i] *= jump
                    if step.released != 0.0:
                        sign = step.released
                        after = target(motor, frame, sign, at_end, now) / tau
                        rate = (staged_V - at_end.w) / motor.lag_s if motor.lag_s > 0.0 else 0.0
                        rate = sign * rate - motor.fc_V * motor.drift / frame.duration_s
                        aim = target(motor, frame, sign, at_end, now)
                        slopes[0, 0, STATIC] = -gain * sign
                        _, by_y, _, _, _ = _slopes(motor, frame, use, sign, at_end, (now, aim), slopes[0])
                        for i in range(columns):
                            p = which[i]
                            by_p = by_y * dy[i] / gain + dw[p]
                            if p != K and p < NUMBERS:
                                by_p += slopes[0, 0, p] / gain
                            dv[i] += after * sign * by_p / rate
                        slopes[0, 0, STATIC] = 0.0
                at = at_end
            if k == last:
                w, begun = at.w, now
                break
            # an edge
            j += 1
            before = _acceleration(motor, frame, at, staged_V, now)
            earlier = staged_V
            staged_V = staged(motor, u_V[j])
            _staged_slopes(motor, u_V[j], ds)
            if motor.lag_s > 0.0:
                dw[DELAY] += (earlier - staged_V) / motor.lag_s
            else:
                at = State(at.v, at.y, at.f, staged_V, at.x)
                for i in range(NUMBERS):
                    dw[i] = ds[i]
                if columns:
                    after = _acceleration(motor, frame, at, staged_V, now)
                    later = before - after
                    slower = later  # a short lag acts as a delay, except where it lets go of a motor at rest
                    if before == 0.0 and at.v == 0.0 and after != 0.0 and motor.bristle_V_rad <= 0.0:
                        pull = abs(staged_V + motor.bias_V - force(motor, frame, at.y))
                        beyond = pull - level_at_rest(motor, frame, at.y, now)
                        slower = -after * math.log(abs(staged_V - earlier) / beyond)
                        slower -= math.copysign(gain / tau * beyond, after)
                    for i in range(columns):
                        if which[i] == DELAY:
                            dv[i] += later
                        elif which[i] == LAG:
                            dv[i] += slower
