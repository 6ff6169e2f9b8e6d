"""The steady cycle under given edges of the relays, in closed form, with its derivatives, and fits to it.

Velocity is linear in the drive, and w = y + tau v moves in straight lines. So a periodic motion under given edges needs
no iteration. The reversal needs none either: exp(t1 / tau) solves a linear equation.
``rig.identify.triple_relay`` uses it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model.compiled.kernel import kernel

Array = NDArray[np.float64]

LARGEST_DAMPING = 1e9


@kernel
def switching_conditions(
    theta: Array, gains: tuple[float, float], durations: tuple[float, float, float], values: Array, jacobian: Array
) -> None:
    """Fill ``values`` (5,): z at RC, v at RA, y at RB, y at RA, y at RC, from odd symmetry, and ``jacobian`` (5, 3).

    theta   log tau, log K, fc; the columns of the Jacobian in this order
    """
    tau, K, fc = math.exp(theta[0]), math.exp(theta[1]), theta[2]
    h1, h2 = gains
    t1, t2, t3 = durations
    U1, U2, U3 = h1 + h2 + fc, h1 + h2 - fc, h2 - h1 - fc
    e1, e2, e3 = math.exp(-t1 / tau), math.exp(-t2 / tau), math.exp(-t3 / tau)
    half = t1 + t2 + t3
    whole = e1 * e2 * e3
    forced = U1 * (e2 * e3 - whole) + U2 * (e3 - e2 * e3) + U3 * (1.0 - e3)
    v0 = -forced / (1.0 + whole)
    area = U1 * t1 + U2 * t2 + U3 * t3
    # integral over the half period of w - w(0)
    under = U1 * t1 * (0.5 * t1 + t2 + t3) + U2 * t2 * (0.5 * t2 + t3) + 0.5 * U3 * t3 * t3
    w0 = -0.5 * area
    y0 = w0 - tau * v0
    z0 = -tau * y0 - 0.5 * (w0 * half + under)
    v1 = U1 + (v0 - U1) * e1
    v2 = U2 + (v1 - U2) * e2
    y1 = w0 + U1 * t1 - tau * v1
    y2 = w0 + U1 * t1 + U2 * t2 - tau * v2
    values[0], values[1], values[2], values[3], values[4] = K * z0, K * v1, K * y2, K * y1, K * y0
    for i in range(5):
        jacobian[i, 1] = values[i]
    for by_fc in range(2):
        # directions: tau d/dtau, then d/dfc
        d1, d2, d3 = (1.0, -1.0, -1.0) if by_fc else (0.0, 0.0, 0.0)
        scale = 0.0 if by_fc else 1.0 / tau
        m23, m3 = e2 * e3 * (t2 + t3) * scale, e3 * t3 * scale
        mw, m1, m2 = whole * half * scale, e1 * t1 * scale, e2 * t2 * scale
        dforced = U1 * (m23 - mw) + U2 * (m3 - m23) - U3 * m3
        dforced += d1 * (e2 * e3 - whole) + d2 * (e3 - e2 * e3) + d3 * (1.0 - e3)
        dv0 = -(dforced + v0 * mw) / (1.0 + whole)
        dw0 = -0.5 * (d1 * t1 + d2 * t2 + d3 * t3)
        dtau = 0.0 if by_fc else tau
        dy0 = dw0 - tau * dv0 - dtau * v0
        dunder = d1 * t1 * (0.5 * t1 + t2 + t3) + d2 * t2 * (0.5 * t2 + t3) + 0.5 * d3 * t3 * t3
        dz0 = -tau * dy0 - dtau * y0 - 0.5 * (dw0 * half + dunder)
        dv1 = d1 * (1.0 - e1) + dv0 * e1 + (v0 - U1) * m1
        dv2 = d2 * (1.0 - e2) + dv1 * e2 + (v1 - U2) * m2
        column = 2 if by_fc else 0
        jacobian[0, column] = K * dz0
        jacobian[1, column] = K * dv1
        jacobian[2, column] = K * (dw0 + d1 * t1 + d2 * t2 - tau * dv2 - dtau * v2)
        jacobian[3, column] = K * (dw0 + d1 * t1 - tau * dv1 - dtau * v1)
        jacobian[4, column] = K * dy0


@kernel
def _inputs(theta: Array, gains: tuple[float, float], inputs: Array) -> None:
    """Fill ``inputs`` (2, 3): effective drives of the stages, folded, of the half that starts upwards and the other."""
    h1, h2 = gains
    fc = theta[2]
    for i in range(2):
        a = theta[3] if i == 0 else -theta[3]
        inputs[i, 0], inputs[i, 1], inputs[i, 2] = h1 + h2 + fc + a, h1 + h2 - fc + a, h2 - h1 - fc + a


@kernel
def _reversals(tau: float, inputs: Array, edges: Array, out: Array) -> None:
    """Fill ``out`` (2, 4): exp(t1 / tau) of both halves, and its derivatives by log tau, fc and asym.

    From v(t1) = 0 in both halves and a velocity of period T. A motor that stops before the RC edge, and is held by
    friction until then, has t1 = 0 in the half that follows. A t1 after RB is put there.
    """
    rb1, rc1, rb2, rc2 = edges
    e3, whole1 = math.exp(-(rc1 - rb1) / tau), math.exp(-rc1 / tau)
    g3, whole2 = math.exp(-(rc2 - rb2) / tau), math.exp(-rc2 / tau)
    a1, a2, a3 = inputs[0]
    b1, b2, b3 = inputs[1]
    # velocity at the end of a half: p - q x, with x = exp(t1 / tau); at its begin: -a1 (x - 1)
    p1, q1 = a3 * (1.0 - e3) + a2 * e3, a2 * whole1
    p2, q2 = b3 * (1.0 - g3) + b2 * g3, b2 * whole2
    determinant = a1 * b1 - q1 * q2
    x1 = (b1 * (p2 + a1) - q2 * (p1 + b1)) / determinant
    x2 = (a1 * (p1 + b1) - q1 * (p2 + a1)) / determinant
    stops1, stops2 = x1 < 1.0, x2 < 1.0
    if stops1:
        x2 = 1.0 + (p1 - q1) / b1
        stops2 = x2 < 1.0
    elif stops2:
        x1 = 1.0 + (p2 - q2) / a1
        stops1 = x1 < 1.0
    x1, x2 = max(x1, 1.0), max(x2, 1.0)
    out[0, 0], out[1, 0] = x1, x2
    for k in range(3):
        if k == 0:
            de3, dg3 = e3 * (rc1 - rb1) / tau, g3 * (rc2 - rb2) / tau
            dp1, dq1 = (a2 - a3) * de3, q1 * rc1 / tau
            dp2, dq2 = (b2 - b3) * dg3, q2 * rc2 / tau
            da1 = db1 = 0.0
        elif k == 1:
            dp1, dq1, dp2, dq2 = -1.0, -whole1, -1.0, -whole2
            da1 = db1 = 1.0
        else:
            dp1, dq1, dp2, dq2 = 1.0, whole1, -1.0, -whole2
            da1, db1 = 1.0, -1.0
        # p1 - q1 x1 = b1 (x2 - 1) and p2 - q2 x2 = a1 (x1 - 1), differentiated
        r1 = dp1 + db1 * (1.0 - x2) - dq1 * x1
        r2 = dp2 + da1 * (1.0 - x1) - dq2 * x2
        if stops1 or stops2:
            out[0, 1 + k] = 0.0 if stops1 else r2 / a1
            out[1, 1 + k] = 0.0 if stops2 else r1 / b1
        else:
            out[0, 1 + k] = (b1 * r2 - q2 * r1) / determinant
            out[1, 1 + k] = (a1 * r1 - q1 * r2) / determinant
    for i in range(2):
        latest = min((rb1 if i == 0 else rb2) / tau, 600.0)
        if out[i, 0] > math.exp(latest):
            out[i, 0] = math.exp(latest)
            out[i, 1], out[i, 2], out[i, 3] = -latest * out[i, 0], 0.0, 0.0


@kernel
def _stop(tau: float, drive: tuple[float, float, float], t1: float, rb: float) -> float:
    """When the motor would stop after the RB edge, s; inf if it would not."""
    speed = -drive[1] * math.expm1((t1 - rb) / tau)
    return rb + tau * math.log1p(-speed / drive[2]) if speed > 0.0 > drive[2] else math.inf


@kernel
def _travel(
    tau: float,
    drive: tuple[float, float, float],
    x: tuple[float, float, float, float],
    t1: float,
    rb: float,
    side: float,
    stop: float,
    t: float,
) -> tuple[float, float, float, float, float]:
    """Folded displacement since the RC edge for K = 1, its derivatives by log tau, fc and asym, and the velocity.

    drive, x       of the half, as from ``_inputs`` and ``_reversals``
    t1, rb, stop   times of the reversal, of the RB edge, and of a stop after it (inf if there is none), s
    side           sign with which asym enters
    """
    held = t >= stop
    t = min(t, stop)  # where it stops the velocity is 0, so that the time of the stop has no derivative
    A1, A2, A3 = drive
    share = 1.0 / x[0]
    m = math.exp((t1 - t) / tau)
    m_0, m_1, m_2 = m * (x[1] * share + t / tau), m * x[2] * share, m * x[3] * share
    if t < t1:
        v = A1 * (1.0 - m)
        v_0, v_1, v_2 = -A1 * m_0, (1.0 - m) - A1 * m_1, side * (1.0 - m) - A1 * m_2
        p, p_0, p_1, p_2 = A1 * t, 0.0, t, side * t
    else:
        second = min(t, rb) - t1
        jump = tau * (A1 - A2) * share
        p = A1 * t1 + A2 * second
        p_0, p_1, p_2 = jump * x[1] + (A1 - A2) * t1, jump * x[2] + t1 - second, jump * x[3] + side * t
        if t < rb:
            v = A2 * (1.0 - m)
            v_0 = -A2 * m_0
        else:
            third = t - rb
            n = math.exp(-third / tau)
            p += A3 * third
            p_1 -= third
            v = A3 * (1.0 - n) + A2 * (n - m)
            v_0 = (A2 - A3) * n * third / tau - A2 * m_0
        v_1, v_2 = -(1.0 - m) - A2 * m_1, side * (1.0 - m) - A2 * m_2
    gained = v + A1 * (x[0] - 1.0)
    return (
        p - tau * gained,
        p_0 - tau * (v_0 + A1 * x[1] + gained),
        p_1 - tau * (v_1 + A1 * x[2] + x[0] - 1.0),
        p_2 - tau * (v_2 + A1 * x[3] + side * (x[0] - 1.0)),
        0.0 if held else v,
    )


@kernel
def curve(
    theta: Array, gains: tuple[float, float], edges: Array, halves: tuple[int, int], t_s: Array, y: Array, jac: Array
) -> None:
    """Fill ``y`` (n,) with positions of the steady cycle, and ``jac`` (n, 6) with their derivatives.

    theta    log tau, log K, fc, asym, position at the first RC edge, delay of the edges: as the columns of ``jac``
    edges    time from RC to RB and to the next RC, in the half that starts upwards and in the other, s
    halves   number of samples in each half; those of the second are folded (position and drive negated)
    t_s      n times since the half's own RC edge as recorded, before the delay
    """
    tau, K = math.exp(theta[0]), math.exp(theta[1])
    offset, delay = theta[4], theta[5]
    inputs, x = np.empty((2, 3)), np.empty((2, 4))
    _inputs(theta, gains, inputs)
    _reversals(tau, inputs, edges, x)
    up = (inputs[0, 0], inputs[0, 1], inputs[0, 2])
    down = (inputs[1, 0], inputs[1, 1], inputs[1, 2])
    x_up, x_down = (x[0, 0], x[0, 1], x[0, 2], x[0, 3]), (x[1, 0], x[1, 1], x[1, 2], x[1, 3])
    t1_up, t1_down = tau * math.log(x_up[0]), tau * math.log(x_down[0])
    rb_up, rc_up, rb_down, rc_down = edges
    stop_up, stop_down = _stop(tau, up, t1_up, rb_up), _stop(tau, down, t1_down, rb_down)
    top = _travel(tau, up, x_up, t1_up, rb_up, 1.0, stop_up, rc_up)
    bottom = _travel(tau, down, x_down, t1_down, rb_down, -1.0, stop_down, rc_down)
    for n in range(t_s.size):
        first = n < halves[0]
        t = t_s[n] - delay
        # After the delay a sample may lie in the half before. From the first RC edge the motor moves away through one
        # half, and back through the other. Before that edge it is on its way back.
        if first == (t >= 0.0):
            d, d_0, d_1, d_2, v = _travel(tau, up, x_up, t1_up, rb_up, 1.0, stop_up, t if first else t + rc_up)
        else:
            b, b_0, b_1, b_2, v = _travel(
                tau, down, x_down, t1_down, rb_down, -1.0, stop_down, t + rc_down if first else t
            )
            end = bottom if first else top
            d, d_0, d_1, d_2, v = end[0] - b, end[1] - b_0, end[2] - b_1, end[3] - b_2, -v
        fold = 1.0 if first else -1.0
        y[n] = fold * (offset + K * d)
        jac[n, 0] = fold * K * d_0
        jac[n, 1] = fold * K * d
        jac[n, 2] = fold * K * d_1
        jac[n, 3] = fold * K * d_2
        jac[n, 4] = fold
        jac[n, 5] = -fold * K * v


@kernel
def _normal_equations(
    residual: Array, jacobian: Array, free: NDArray[np.bool_], normal: Array, gradient: Array
) -> None:
    """Fill J'J and J'r. A parameter that is not free gets an equation of its own that keeps its value."""
    n, p = jacobian.shape
    normal[:] = 0.0
    gradient[:] = 0.0
    for k in range(n):
        for i in range(p):
            gradient[i] += jacobian[k, i] * residual[k]
            for j in range(i + 1):
                normal[i, j] += jacobian[k, i] * jacobian[k, j]
    for i in range(p):
        for j in range(i):
            if not (free[i] and free[j]):
                normal[i, j] = 0.0
            normal[j, i] = normal[i, j]
        if not free[i]:
            normal[i, i], gradient[i] = 1.0, 0.0


@kernel
def _damped_step(normal: Array, gradient: Array, damping: float, step: Array) -> bool:
    """Fill the step of damped Gauss-Newton, by Cholesky; False where the equations are singular."""
    p = gradient.size
    factor = np.empty((p, p))
    for i in range(p):
        for j in range(i + 1):
            total = normal[i, j]
            if i == j:
                total += damping * max(normal[i, i], 1e-30)
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = total / factor[j, j]
            elif total > 0.0:
                factor[i, i] = math.sqrt(total)
            else:
                return False
    for i in range(p):
        total = -gradient[i]
        for k in range(i):
            total -= factor[i, k] * step[k]
        step[i] = total / factor[i, i]
    for i in range(p - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, p):
            total -= factor[k, i] * step[k]
        step[i] = total / factor[i, i]
    return True


@kernel
def _misfit(
    theta: Array,
    gains: tuple[float, float],
    edges: Array,
    halves: tuple[int, int],
    t_s: Array,
    measured: Array,
    weight: Array,
    residual: Array,
    jacobian: Array,
) -> float:
    """Fill weighted residuals and their Jacobian: of the curve, or without samples of the five conditions.

    Returns the sum of squares.
    """
    if t_s.size > 0:
        curve(theta, gains, edges, halves, t_s, residual, jacobian)
    else:
        switching_conditions(theta, gains, (edges[0], edges[1], edges[2]), residual, jacobian)
    cost = 0.0
    for k in range(residual.size):
        residual[k] = weight[k] * (residual[k] - measured[k])
        for i in range(theta.size):
            jacobian[k, i] *= weight[k]
        cost += residual[k] * residual[k]
    return cost


@kernel
def _move(theta: Array, step: Array, low: Array, high: Array, walls: int, moved: Array) -> bool:
    """Fill ``moved``; False where it is out of reach. From ``walls`` on, parameters stop at their bounds instead."""
    for i in range(theta.size):
        moved[i] = theta[i] + step[i]
        if i >= walls:
            moved[i] = min(max(moved[i], low[i]), high[i])
        elif not low[i] < moved[i] < high[i]:
            return False
    return True


@kernel
def solve(
    theta: Array,
    free: NDArray[np.bool_],
    gains: tuple[float, float],
    edges: Array,
    halves: tuple[int, int],
    t_s: Array,
    measured: Array,
    weight: Array,
    low: Array,
    high: Array,
    tolerance: Array,
    damping: float,
    iterates: Array,
) -> tuple[int, float]:
    """Damped Gauss-Newton; changes ``theta`` where ``free``.

    theta             (6,) as for ``curve``, or (3,) as for ``switching_conditions``
    edges             (4,) as for ``curve``, or (3,): the durations
    halves, t_s       as for ``curve``; no samples for the five conditions
    measured, weight  target of the curve or of the conditions, and one over the size of an error
    low, high         range of theta. The delay goes up to its bounds and stays there
    tolerance         steps that end the search
    damping           of the first step
    iterates          (m, 3) or (m, 6): filled with theta at each iteration, the start first
    Returns the number of iterates and the sum of squares. The damping grows until a step lowers the sum, then it falls.
    """
    n, p = measured.size, theta.size
    walls = 5
    residual, jacobian = np.empty(n), np.empty((n, p))
    trial, trial_jacobian = np.empty(n), np.empty((n, p))
    normal, gradient, step, moved = np.empty((p, p)), np.empty(p), np.empty(p), np.empty(p)
    moving = np.empty(p, dtype=np.bool_)
    for i in range(p):
        moving[i], iterates[0, i] = free[i], theta[i]
    cost = _misfit(theta, gains, edges, halves, t_s, measured, weight, residual, jacobian)
    count = 1
    while count < iterates.shape[0] and cost > 0.0:
        for i in range(walls, p):
            uphill = 0.0
            for k in range(n):
                uphill += jacobian[k, i] * residual[k]
            outwards = (theta[i] <= low[i] and uphill > 0.0) or (theta[i] >= high[i] and uphill < 0.0)
            moving[i] = free[i] and not outwards
        _normal_equations(residual, jacobian, moving, normal, gradient)
        taken = False
        while not taken and damping < LARGEST_DAMPING:
            if _damped_step(normal, gradient, damping, step) and _move(theta, step, low, high, walls, moved):
                new = _misfit(moved, gains, edges, halves, t_s, measured, weight, trial, trial_jacobian)
                taken = new <= cost
            if not taken:
                damping = max(10.0 * damping, 1e-10)
        if not taken:
            break
        arrived = True
        for i in range(p):
            arrived = arrived and abs(moved[i] - theta[i]) <= tolerance[i]
            theta[i] = moved[i]
            iterates[count, i] = moved[i]
        residual, trial = trial, residual
        jacobian, trial_jacobian = trial_jacobian, jacobian
        cost = new
        count += 1
        damping *= 0.1
        if arrived:
            break
    return count, cost
