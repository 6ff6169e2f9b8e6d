"""A real motor under a recorded drive: what its sensor reads, and the derivatives (docs/theory.md 12.4)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.model.compiled.kernel import kernel
from rig.model.real_step import (
    NO_FADING,
    STEP_OF_TAU,
    Frame,
    Numbers,
    RealMotor,
    State,
    Step,
    advance,
    behind_play,
    direction,
    force,
    lagged,
    level_at_rest,
    level_of_bristles,
    mean_cosine,
    next_step,
    phi4,
    reading,
    staged,
    stiffness,
    target,
    weights,
)

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

NUMBERS = len(RealMotor._fields)
V0, Y0 = NUMBERS, NUMBERS + 1  # columns of a piece's start, behind the numbers of the motor
WAVES = NUMBERS + 2  # columns of waves of the force, behind them
TAU, K, FC, BIAS, DELAY = (RealMotor._fields.index(n) for n in ("tau_s", "K_rad_s_V", "fc_V", "bias_V", "delay_s"))
DEAD_BAND, GAIN, SAG = (RealMotor._fields.index(n) for n in ("dead_band_V", "gain_by_sign", "sag_per_V"))
LAG, VISCOUS = (RealMotor._fields.index(n) for n in ("lag_s", "viscous_by_direction_V_s_rad"))
STATIC, STRIBECK, UNIT = (RealMotor._fields.index(n) for n in ("static_V", "stribeck_V", "stribeck_rad_s"))
DRAG, BRISTLE = (RealMotor._fields.index(n) for n in ("drag_V_s2_rad2", "bristle_V_rad"))
FORCE, FRICTION = (RealMotor._fields.index(n) for n in ("force_sin_V", "friction_sin_V"))  # and the cosines behind
COGGING, ORDER = (RealMotor._fields.index(n) for n in ("cogging_sin_V", "cogging_per_rad"))
BACKLASH, LINEARITY, DRIFT = (RealMotor._fields.index(n) for n in ("backlash_rad", "linearity_sin1_rad", "drift"))

# No motor is as fast: numbers that a fit tries may drive it on by themselves, as a drag that pushes does.
RUNAWAY_RAD_S = 1e5
# steps at most, on the average over rows and edges: by the way that it turns in one, and by its time constants in one
STEPS_OF_ROW, STEPS_OF_TAUS = 500, 1_000

# Which of the derivatives cost a function of their own: over position, over the cogging, over speed.
Used = tuple[bool, bool, bool]


# Rows of ``Slopes.state`` and of ``Slopes.room``.
V, Y, F, X = range(4)
W, STAGED, LEVEL, STAGE = range(4)


class Slopes(NamedTuple):
    """Derivatives of a state by the columns of a Jacobian, and room to work in; few arrays, as each costs at a call.

    which   number of the motor of each column, ``V0`` or ``Y0``, or from ``WAVES`` on a wave of the force, (c,)
    state   (4, c), of v, y, f and x
    room    (11, n), by every number of the motor: of the drive behind the lag and before it, of a level of friction,
            and from ``STAGE`` on of the right sides at the four stages of a step: target velocity and bristles' rate
    orders  of the waves of the force over position that the motor has not, 1/rad: a sine and a cosine each, (k,)
    """

    which: Rows
    state: Array
    room: Array
    orders: Array


@kernel
def _level_slopes(
    motor: RealMotor, frame: Frame, used: Used, at: tuple[float, float, float], room: Array, row: int
) -> tuple[float, float]:
    """Fill a row of ``room`` with the derivatives of the level; returns those by speed and position.

    at   speed, rad/s, position, rad, and time, s
    """
    speed, y, t = at
    position, _, stribeck = used
    course = (t - frame.start_s) / frame.duration_s - 0.5
    room[row, FC] = 1.0 + motor.drift * course
    room[row, DRIFT] = motor.fc_V * course
    by_speed = by_y = 0.0
    if position:
        q = y - frame.centre_rad
        sine, cosine = math.sin(q), math.cos(q)
        room[row, FRICTION], room[row, FRICTION + 1] = sine, cosine - mean_cosine(frame)
        by_y = motor.friction_sin_V * cosine - motor.friction_cos_V * sine
    if stribeck and motor.stribeck_rad_s > 0.0:
        share = math.exp(-speed / motor.stribeck_rad_s)
        room[row, STRIBECK] = share
        room[row, UNIT] = motor.stribeck_V * share * speed / (motor.stribeck_rad_s * motor.stribeck_rad_s)
        by_speed = -motor.stribeck_V * share / motor.stribeck_rad_s
    return by_speed, by_y


@kernel
def _slopes(
    motor: RealMotor, frame: Frame, used: Used, sign: float, at: State, when: tuple[float, float], d: Slopes, row: int
) -> tuple[float, float, float, float, float]:
    """Fill two rows of its room with derivatives of the target velocity and of the bristles' rate.

    when   time, s, and the target velocity there, rad/s
    Returns the derivatives of the target velocity by v and y, and of the rate by v, y, f.
    """
    t, aim = when
    room, orders = d.room, d.orders
    gain, v, y = motor.K_rad_s_V, at.v, at.y
    speed = sign * v
    room[row, K] = aim / gain
    room[row, BIAS] = gain
    room[row, VISCOUS] = -gain * speed
    room[row, DRAG] = -gain * v * speed
    by_v = -gain * (motor.viscous_by_direction_V_s_rad * sign + 2.0 * motor.drag_V_s2_rad2 * speed)
    by_y = 0.0
    position, cogging, _ = used
    if position:
        q = y - frame.centre_rad
        sine, cosine = math.sin(q), math.cos(q)
        room[row, FORCE], room[row, FORCE + 1] = -gain * sine, -gain * (cosine - mean_cosine(frame))
        by_y -= gain * (motor.force_sin_V * cosine - motor.force_cos_V * sine)
    if cogging:
        q = motor.cogging_per_rad * y
        sine, cosine = math.sin(q), math.cos(q)
        slope = motor.cogging_sin_V * cosine - motor.cogging_cos_V * sine
        room[row, COGGING], room[row, COGGING + 1], room[row, ORDER] = -gain * sine, -gain * cosine, -gain * y * slope
        by_y -= gain * motor.cogging_per_rad * slope
    for k in range(orders.size):
        q = orders[k] * y
        room[row, WAVES + 2 * k], room[row, WAVES + 2 * k + 1] = -gain * math.sin(q), -gain * math.cos(q)
    by_speed, by_place = _level_slopes(motor, frame, used, (speed, y, t), room, row + 1)
    if motor.bristle_V_rad <= 0.0:
        for k in (FC, DRIFT, FRICTION, FRICTION + 1, STRIBECK, UNIT):
            room[row, k] = -gain * sign * room[row + 1, k]
        return by_v - gain * by_speed, by_y - gain * sign * by_place, 0.0, 0.0, 0.0
    floor = level_of_bristles(motor, frame, speed, y, t)
    stiff, share = stiffness(motor, floor), at.f / floor
    limited = stiff < motor.bristle_V_rad
    by_level = v * stiff / floor if limited else stiff * speed * share / floor
    for k in (FC, DRIFT, FRICTION, FRICTION + 1, STRIBECK, UNIT):
        room[row + 1, k] *= by_level
    room[row + 1, BRISTLE] = 0.0 if limited else v - speed * share
    return (
        by_v,
        by_y,
        stiff * (1.0 - sign * share) + by_level * sign * by_speed,
        by_level * by_place,
        -stiff * speed / floor,
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
def _copy_staged(room: Array) -> None:
    for i in range(room.shape[1]):  # for a row at once numba compiles its message for rows of two lengths: 5 s
        room[W, i] = room[STAGED, i]


@kernel
def _fade(motor: RealMotor, d: Slopes, faded_V: float, h_s: float) -> None:
    """Carry the derivatives of the drive over ``h_s``, at whose start it is ``faded_V`` from its end."""
    room = d.room
    if motor.lag_s <= 0.0:
        _copy_staged(room)
        return
    keep = math.exp(-h_s / motor.lag_s)
    for i in range(NUMBERS):
        room[W, i] = room[STAGED, i] + (room[W, i] - room[STAGED, i]) * keep
    room[W, LAG] += faded_V * keep * h_s / (motor.lag_s * motor.lag_s)


@kernel
def _step_drive(motor: RealMotor, d: Slopes, staged_V: float, u_V: float) -> float:
    """Take the derivatives over an edge from ``staged_V`` to the drive ``u_V``; returns it as it is before the lag."""
    new_V = staged(motor, u_V)
    _staged_slopes(motor, u_V, d.room[STAGED])
    if motor.lag_s > 0.0:
        d.room[W, DELAY] += (staged_V - new_V) / motor.lag_s
    else:
        _copy_staged(d.room)
    return new_V


@kernel
def _begin(motor: RealMotor, frame: Frame, used: Used, d: Slopes, start: Array, now: tuple[float, float]) -> State:
    """State at the start of a piece, and its derivatives; ``now``: time, s, and drive behind the lag, V."""
    which, state, room = d.which, d.state, d.room
    t, w = now
    v0, y0, side, bend = start[0], start[1], start[2], start[3]
    at = State(v0, y0 + 0.5 * side * motor.backlash_rad, 0.0, w, y0)
    columns = which.size
    for i in range(columns):
        state[V, i] = 1.0 if which[i] == V0 else 0.0
        state[X, i] = 1.0 if which[i] == Y0 else 0.0
        state[Y, i] = state[X, i] + (0.5 * side if which[i] == BACKLASH else 0.0)
        state[F, i] = 0.0
    if motor.bristle_V_rad <= 0.0:
        return at
    floor = level_of_bristles(motor, frame, abs(v0), at.y, t)
    pull = w + motor.bias_V - force(motor, frame, at.y)
    if bend == 0.0 and abs(pull) > floor:
        bend = 1.0 if pull > 0.0 else -1.0
    at = State(at.v, at.y, bend * floor if bend != 0.0 else pull, at.w, at.x)
    if columns:
        gain = motor.K_rad_s_V
        aim = target(motor, frame, 1.0, at, t)
        _, by_y, _, _, _ = _slopes(motor, frame, used, 1.0, at, (t, aim), d, STAGE)
        for i in range(room.shape[1]):
            room[LEVEL, i] = 0.0
        by_speed, by_place = _level_slopes(motor, frame, used, (abs(v0), at.y, t), room, LEVEL)
        by_v = by_speed if v0 > 0.0 else -by_speed
        for i in range(columns):
            p = which[i]
            if bend != 0.0:
                state[F, i] = bend * (room[LEVEL, p] + by_v * state[V, i] + by_place * state[Y, i])
            else:
                known = p == BIAS or FORCE <= p <= FORCE + 1 or COGGING <= p <= ORDER or p >= WAVES
                state[F, i] = by_y * state[Y, i] / gain + room[W, p] + (room[STAGE, p] / gain if known else 0.0)
    return at


@kernel
def _through(motor: RealMotor, frame: Frame, used: Used, d: Slopes, at: State, now: tuple[Step, float, float]) -> None:
    """Take the derivatives of v, y, f through a step of a motor in motion; ``now``: the step, time, s, and drive, V."""
    step, t, staged_V = now
    s, h, tau, gain = step.stages, step.duration_s, motor.tau_s, motor.K_rad_s_V
    lag = motor.lag_s
    half, keep = (math.exp(-0.5 * h / lag), math.exp(-h / lag)) if lag > 0.0 else (0.0, 0.0)
    faded = at.w - staged_V
    # weights of the step, and their derivatives by tau
    c = h / tau
    p4 = phi4(c)
    p3 = 1.0 / 6.0 - c * p4
    p2 = 0.5 - c * p3
    p1 = 1.0 - c * p2
    e, e2, _, b1, b2, b4 = weights(c)
    b1, b2, b4 = c * b1, c * b2, c * b4
    q1, q2, q3 = p1 - p2, p2 - 2.0 * p3, p3 - 3.0 * p4  # derivatives of p1, p2, p3 by -c
    rate = -c / tau
    e_tau, e2_tau = -rate * e, -0.5 * rate * e2
    b1_tau = rate * (b1 / c - c * (q1 - 3.0 * q2 + 4.0 * q3))
    b2_tau = rate * (b2 / c - c * (2.0 * q2 - 4.0 * q3))
    b4_tau = rate * (b4 / c - c * (4.0 * q3 - q2))
    # those of the bristles; how they change shows only in what the step leaves off
    slide = s.slide
    g, g2, mean, g_b1, g_b2, g_b4 = weights(h * slide) if motor.bristle_V_rad > 0.0 else NO_FADING
    near = 0.5 * h * mean
    middle = staged_V + faded * half
    at2, at3 = State(s.v2, s.y2, s.f2, middle, 0.0), State(s.v3, s.y3, s.f3, middle, 0.0)
    at4 = State(s.v4, s.y4, s.f4, step.end.w, 0.0)
    which, state, room = d.which, d.state, d.room
    av1, ay1, rv1, ry1, rf1 = _slopes(motor, frame, used, step.sign, at, (t, s.a1), d, STAGE)
    av2, ay2, rv2, ry2, rf2 = _slopes(motor, frame, used, step.sign, at2, (t + 0.5 * h, s.a2), d, STAGE + 2)
    av3, ay3, rv3, ry3, rf3 = _slopes(motor, frame, used, step.sign, at3, (t + 0.5 * h, s.a3), d, STAGE + 4)
    av4, ay4, rv4, ry4, rf4 = _slopes(motor, frame, used, step.sign, at4, (t + h, s.a4), d, STAGE + 6)
    bristles = motor.bristle_V_rad > 0.0
    af = -gain if bristles else 0.0
    for i in range(which.size):
        p = which[i]
        by_tau = 1.0 if p == TAU else 0.0
        v, y, f, drive = state[V, i], state[Y, i], state[F, i], room[STAGED, p]
        mid, far = drive + (room[W, p] - drive) * half, drive + (room[W, p] - drive) * keep
        if p == LAG and lag > 0.0:
            mid += faded * half * 0.5 * h / (lag * lag)
            far += faded * keep * h / (lag * lag)
        along = y + tau * v + by_tau * at.v  # of p = y + tau v
        a1 = av1 * v + ay1 * y + af * f + gain * room[W, p] + room[STAGE, p]
        v2 = e2 * v + (1.0 - e2) * a1 + by_tau * e2_tau * (at.v - s.a1)
        y2 = along + 0.5 * h * a1 - tau * v2 - by_tau * s.v2
        r1 = r2 = r3 = r4 = 0.0
        f2 = f3 = f4 = f
        if bristles:
            r1 = rv1 * v + ry1 * y + (rf1 + slide) * f + room[STAGE + 1, p]
            f2 = g2 * f + near * r1
            r2 = rv2 * v2 + ry2 * y2 + (rf2 + slide) * f2 + room[STAGE + 3, p]
            f3 = g2 * f + near * r2
        a2 = av2 * v2 + ay2 * y2 + af * f2 + gain * mid + room[STAGE + 2, p]
        v3 = e2 * v + (1.0 - e2) * a2 + by_tau * e2_tau * (at.v - s.a2)
        y3 = along + 0.5 * h * a2 - tau * v3 - by_tau * s.v3
        if bristles:
            r3 = rv3 * v3 + ry3 * y3 + (rf3 + slide) * f3 + room[STAGE + 5, p]
            f4 = g2 * f2 + near * (2.0 * r3 - r1)
        a3 = av3 * v3 + ay3 * y3 + af * f3 + gain * mid + room[STAGE + 4, p]
        v4 = e2 * v2 + (1.0 - e2) * (2.0 * a3 - a1) + by_tau * e2_tau * (s.v2 - 2.0 * s.a3 + s.a1)
        y4 = along + h * a3 - tau * v4 - by_tau * s.v4
        if bristles:
            r4 = rv4 * v4 + ry4 * y4 + (rf4 + slide) * f4 + room[STAGE + 7, p]
        a4 = av4 * v4 + ay4 * y4 + af * f4 + gain * far + room[STAGE + 6, p]
        v_end = e * v + b1 * a1 + b2 * (a2 + a3) + b4 * a4
        v_end += by_tau * (e_tau * at.v + b1_tau * s.a1 + b2_tau * (s.a2 + s.a3) + b4_tau * s.a4)
        state[V, i] = v_end
        state[Y, i] = along + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4) - tau * v_end - by_tau * step.end.v
        state[F, i] = g * f + h * (g_b1 * r1 + g_b2 * (r2 + r3) + g_b4 * r4)


@kernel
def _reverse(motor: RealMotor, frame: Frame, d: Slopes, sign: float, at: State, now: tuple[float, float]) -> None:
    """Jump of the velocity's derivatives at a reversal of a motion in the direction ``sign``; ``now``: as below."""
    t, staged_V = now
    before = (target(motor, frame, sign, at, t) - at.v) / motor.tau_s
    jump = _acceleration(motor, frame, at, staged_V, t) / before if before != 0.0 else 0.0
    for i in range(d.which.size):
        d.state[V, i] *= jump


@kernel
def _release(motor: RealMotor, frame: Frame, used: Used, d: Slopes, at: State, now: tuple[float, float, float]) -> None:
    """Jump of the velocity's derivatives where the lag or the drift lets go; ``now``: time, drive V, direction."""
    which, state, room = d.which, d.state, d.room
    t, staged_V, sign = now
    gain = motor.K_rad_s_V
    aim = target(motor, frame, sign, at, t)
    rate = (staged_V - at.w) / motor.lag_s if motor.lag_s > 0.0 else 0.0
    rate -= sign * motor.fc_V * motor.drift / frame.duration_s  # of the pull beyond the level
    _, by_y, _, _, _ = _slopes(motor, frame, used, sign, at, (t, aim), d, STAGE)
    room[STAGE, STATIC] = -gain * sign
    for i in range(which.size):
        p = which[i]
        by_p = by_y * state[Y, i] / gain + room[W, p] + (room[STAGE, p] / gain if p != K else 0.0)
        state[V, i] += aim / motor.tau_s * by_p / rate
    room[STAGE, STATIC] = 0.0


@kernel
def _kick(motor: RealMotor, frame: Frame, d: Slopes, before: State, at: State, now: tuple[float, float, float]) -> None:
    """Jump of the velocity's derivatives at an edge without lag; ``now``: time, s, drives before and after it, V."""
    which, state = d.which, d.state
    t, from_V, to_V = now
    was = _acceleration(motor, frame, before, from_V, t)
    later = was - _acceleration(motor, frame, at, to_V, t)
    slower = later  # a short lag acts as a delay, except where it lets go of a motor at rest
    if was == 0.0 and at.v == 0.0 and later != 0.0 and motor.bristle_V_rad <= 0.0:
        beyond = abs(to_V + motor.bias_V - force(motor, frame, at.y)) - level_at_rest(motor, frame, at.y, t)
        slower = later * math.log(abs(to_V - from_V) / beyond)
        slower += math.copysign(motor.K_rad_s_V / motor.tau_s * beyond, later)
    for i in range(which.size):
        if which[i] == DELAY:
            state[V, i] += later
        elif which[i] == LAG:
            state[V, i] += slower


@kernel
def _read(motor: RealMotor, frame: Frame, d: Slopes, x: float, row: Array) -> None:
    """Fill a row of the Jacobian of the reading at ``x``."""
    which, state, room = d.which, d.state, d.room
    by_x = _reading_slopes(motor, frame, x, room[LEVEL])
    for i in range(which.size):
        k = which[i] - LINEARITY
        row[i] = by_x * state[X, i] + (room[LEVEL, k] if 0 <= k < 4 else 0.0)


@kernel
def readings(
    numbers: tuple[Numbers, Numbers],
    drive: tuple[Array, Array],
    t_s: Array,
    pieces: tuple[Rows, Array],
    free: tuple[Rows, Array],
    out: tuple[Array, Array],
) -> None:
    """Fill the readings (n,) and their Jacobian (n, c): by the c - 2 numbers ``free``, and by the own piece's start.

    numbers   of the motor and of its frame
    drive     edges, s, and drives that act from them on, V; before the first edge the drive is that edge's
    pieces    first rows (p,), increasing from 0 on, and starts (p, 4): v0, rad/s, y0, rad, side of the play, -1 to 1,
              and how far the bristles are bent, -1 to 1; 0: they balance the drive
    free      numbers (m,), and orders (k,), 1/rad, of waves of the force that the motor has not: the sine and the
              cosine of each are further numbers, c = m + 2 k + 2
    out       readings, rad, and Jacobian. One of no columns: it is left out. All nan for a motor that runs away,
              or that is so stiff that it takes too many steps
    """
    motor, frame = RealMotor(*numbers[0]), Frame(*numbers[1])
    edge_s, u_V = drive
    first, starts = pieces
    y_rad, jacobian = out
    n, edges, columns = t_s.size, edge_s.size, jacobian.shape[1]
    used = (
        motor.friction_sin_V != 0.0
        or motor.friction_cos_V != 0.0
        or motor.force_sin_V != 0.0
        or motor.force_cos_V != 0.0,
        motor.cogging_sin_V != 0.0 or motor.cogging_cos_V != 0.0,
        motor.stribeck_V != 0.0,
    )
    which, orders = free
    room = np.zeros((11, WAVES + 2 * orders.size))
    d = Slopes(np.empty(columns, dtype=np.int64), np.zeros((4, columns)), room, orders)
    for i in range(columns):
        if i < which.size:
            d.which[i] = which[i]
        else:
            d.which[i] = WAVES + i - which.size if i < columns - 2 else V0 + i - (columns - 2)
    j = 0
    staged_V = staged(motor, u_V[0])
    _staged_slopes(motor, u_V[0], d.room[STAGED])
    _copy_staged(d.room)
    w, begun = staged_V, min(t_s[0], edge_s[0] + motor.delay_s)
    of_taus = 2.0 * (t_s[n - 1] - t_s[0]) / (STEP_OF_TAU * motor.tau_s)
    left = STEPS_OF_ROW * (n + edges) + min(of_taus, STEPS_OF_TAUS * (n + edges))
    for piece in range(first.size):
        k = first[piece]
        last = first[piece + 1] if piece + 1 < first.size else n
        now = t_s[k]
        while begun < now or (j + 1 < edges and edge_s[j + 1] + motor.delay_s <= now):  # the drive, up to the piece
            edge = edge_s[j + 1] + motor.delay_s if j + 1 < edges else math.inf
            until = max(min(edge, now), begun)
            _fade(motor, d, w - staged_V, until - begun)
            w, begun = lagged(motor, staged_V, w, until - begun), until
            if edge <= now:
                j += 1
                staged_V = _step_drive(motor, d, staged_V, u_V[j])
                w = w if motor.lag_s > 0.0 else staged_V
        at = _begin(motor, frame, used, d, starts[piece], (now, w))
        while True:
            edge = edge_s[j + 1] + motor.delay_s if j + 1 < edges else math.inf
            while k < last and (t_s[k] <= now or now < edge):
                if t_s[k] <= now:
                    y_rad[k] = reading(motor, frame, at.x)
                    if columns:
                        _read(motor, frame, d, at.x, jacobian[k])
                    k += 1
                    continue
                end = min(edge, t_s[k])
                step = next_step(motor, frame, at, staged_V, now, end - now)
                if columns:
                    if step.sign != 0.0:
                        _through(motor, frame, used, d, at, (step, now, staged_V))
                    else:
                        d.state[V] = 0.0
                    _fade(motor, d, at.w - staged_V, step.duration_s)
                    if step.sign * (step.end.y - at.x) >= 0.5 * motor.backlash_rad and step.sign != 0.0:
                        for i in range(columns):  # the play is taken up
                            d.state[X, i] = d.state[Y, i] - (0.5 * step.sign if d.which[i] == BACKLASH else 0.0)
                now = end if step.duration_s >= end - now else now + step.duration_s
                x = behind_play(motor, step.sign, step.end)
                at = State(step.end.v, step.end.y, step.end.f, step.end.w, x)
                left -= 1
                if left < 0 or not abs(at.v) < RUNAWAY_RAD_S:  # its steps are, or would become, too short ever to end
                    y_rad[:] = math.nan
                    jacobian[:] = math.nan
                    return
                if columns and step.reverses:
                    _reverse(motor, frame, d, step.sign, at, (now, staged_V))
                if columns and step.released != 0.0:
                    _release(motor, frame, used, d, at, (now, staged_V, step.released))
            if k == last:
                w, begun = at.w, now
                break
            j += 1
            before, from_V = at, staged_V
            staged_V = _step_drive(motor, d, from_V, u_V[j])
            if motor.lag_s <= 0.0:
                at = State(at.v, at.y, at.f, staged_V, at.x)
                if columns:
                    _kick(motor, frame, d, before, at, (now, from_V, staged_V))


@kernel
def advanced(
    numbers: tuple[Numbers, Numbers], at: Numbers, u_V: float, when: tuple[float, float]
) -> tuple[float, float, float, float, float]:
    """``real_step.advance`` for one step of a loop.

    numbers   of the motor and of its frame
    at, u_V   state, and the drive, V
    when      time, s, and how long, s
    """
    end = advance(RealMotor(*numbers[0]), Frame(*numbers[1]), State(*at), u_V, when[0], when[1])
    return end.v, end.y, end.f, end.w, end.x
