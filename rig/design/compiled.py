"""The compiled loops of a design: a planned test on a motor, what its rows tell, and how far the shaft goes in it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model.compiled.kernel import kernel
from rig.model.compiled.motion import position_and_jacobian
from rig.model.step import Numbers, Plant, State, advance_exponentially

Array = NDArray[np.float64]
Law = tuple[bool, Array, Array]  # True, (h1, h2), (); or False, drives of the strokes, their turning points
Timing = tuple[float, float]  # sampling period, and from a sample until its drive acts, s

PARAMETERS = 5  # log tau, log K, fc, asym, delay
STARTS = 2  # v0, y0: no test tells them, and none needs them


@kernel
def drive(
    motor: Numbers, law: Law, timing: Timing, start: Numbers, most_strokes: int, u_V: Array, states: Array
) -> tuple[int, int]:
    """Fill ``u_V`` (n,) and ``states`` (n, 2), velocity and position at each sample.

    Returns how many rows it took until ``most_strokes`` had ended, or all, and the rows of the longest stroke.
    The laws are ``rig.control.relay.DualChannelRelay`` and ``rig.control.strokes.StrokeTest``, without noise. Until the
    first drive acts there is none.
    """
    is_relay, first, second = law
    period_s, delay_s = timing
    plant, state = Plant(*motor), State(*start)
    late = int(delay_s / period_s)
    part_s = delay_s - late * period_s
    z, before = 0.0, state.y
    sign_y = sign_z = 1.0 if state.y >= 0.0 else -1.0
    ended, i, since, longest = 0, 0, 0, 0
    if not is_relay and state.y * first[0] > 0.0:
        i = 1 % first.size
    for k in range(u_V.size):
        y = state.y
        if is_relay:
            if k > 0:
                z += period_s * 0.5 * (y + before)
            before = y
            sign_y = keep(y, sign_y)
            sign_z = keep(z, sign_z)
            u_V[k] = -first[0] * sign_y - first[1] * sign_z
        else:
            if (first[i] > 0.0 and y >= second[i]) or (first[i] < 0.0 and y <= second[i]):
                i = (i + 1) % first.size
                ended += 1
                longest, since = max(longest, k - since), k
                if ended == most_strokes:
                    return k, longest
            u_V[k] = first[i]
        states[k, 0], states[k, 1] = state.v, y
        if part_s > 0.0:
            acting = u_V[k - late - 1] if k > late else 0.0
            state = advance_exponentially(plant, state, acting, part_s)
        acting = u_V[k - late] if k >= late else 0.0
        state = advance_exponentially(plant, state, acting, period_s - part_s)
    return u_V.size, max(longest, u_V.size - since)


@kernel
def keep(value: float, previous: float) -> float:
    """Sign of a value; at exactly zero the previous one stays."""
    if value > 0.0:
        return 1.0
    return -1.0 if value < 0.0 else previous


@kernel
def spread(motor: Numbers, timing: Timing, u_V: Array, states: Array, jacobian: Array) -> None:
    """Fill ``jacobian`` (n, 7): of the positions by log tau, log K, fc, asym, delay, v0, y0; rad over their units.

    ``states`` (n, 2), velocity, rad/s, and position, rad: the first one is the start.
    """
    period_s, delay_s = timing
    n = u_V.size
    edge_s, drives_V = np.empty(n + 1), np.empty(n + 1)
    t_s, y_rad = np.empty(n), np.empty(n)
    edge_s[0], drives_V[0] = -period_s, 0.0
    for k in range(n):
        t_s[k] = k * period_s
        edge_s[k + 1], drives_V[k + 1] = k * period_s + delay_s, u_V[k]
    start = (states[0, 0], states[0, 1], 0.0)
    position_and_jacobian(motor, start, (edge_s, drives_V, 0.0), t_s, y_rad, jacobian)
    plant = Plant(*motor)
    for k in range(n):
        jacobian[k, 0] *= plant.tau_s
        jacobian[k, 1] *= plant.K_rad_s_V


@kernel
def known(full: Array, seen: Array, out: Array) -> None:
    """Fill ``out`` (5, 5): the information ``seen`` and that of rows, ``full`` (7, 7), without what the starts take."""
    work = full.copy()
    for q in range(PARAMETERS + STARTS - 1, PARAMETERS - 1, -1):
        pivot = work[q, q]
        if pivot > 0.0:
            for a in range(q):
                share = work[a, q] / pivot
                for b in range(q):
                    work[a, b] -= share * work[q, b]
    for a in range(PARAMETERS):
        for b in range(PARAMETERS):
            out[a, b] = seen[a, b] + work[a, b]


@kernel
def variances(information: Array, out: Array) -> bool:
    """Fill ``out`` (3,): variances of log tau, log K and fc; False where the information does not separate them."""
    p = PARAMETERS
    work = np.empty((p, 2 * p))
    scale = np.empty(p)
    for a in range(p):
        if not information[a, a] > 0.0:
            return False
        scale[a] = 1.0 / math.sqrt(information[a, a])
    for a in range(p):
        for b in range(p):
            work[a, b] = information[a, b] * scale[a] * scale[b]
            work[a, p + b] = 1.0 if a == b else 0.0
    for q in range(p):
        pivot = work[q, q]
        if not pivot > 1e-11:  # of a matrix with a unit diagonal that is positive definite
            return False
        for b in range(2 * p):
            work[q, b] /= pivot
        for a in range(p):
            if a != q:
                factor = work[a, q]
                for b in range(2 * p):
                    work[a, b] -= factor * work[q, b]
    for a in range(out.size):
        out[a] = work[a, p + a] * scale[a] * scale[a]
    return True


@kernel
def rows_until(jacobian: Array, noise_rad2: float, seen: Array, wanted: Array, every: int, information: Array) -> float:
    """Rows until the deviations of log tau, log K and fc are within ``wanted`` (3,).

    ``jacobian`` is that of ``spread``, and ``noise_rad2`` the variance of a reading, rad^2. ``seen`` is the information
    before the first row. At the end ``information`` (5, 5) is all that there is. It looks
    after each ``every`` rows, and at the last; between two looks the logarithm of the deviation falls evenly. If the
    rows are too few: as many as it takes if information goes on as it came in until then.
    """
    n, width = jacobian.shape
    full = np.zeros((width, width))
    found = np.empty(wanted.size)
    ratio = before = math.inf
    for k in range(n):
        for a in range(width):
            for b in range(a + 1):
                full[a, b] += jacobian[k, a] * jacobian[k, b] / noise_rad2
        if (k + 1) % every == 0 or k + 1 == n:
            for a in range(width):
                for b in range(a):
                    full[b, a] = full[a, b]
            known(full, seen, information)
            before, ratio = ratio, math.inf
            if variances(information, found):
                ratio = 0.0
                for i in range(wanted.size):
                    ratio = max(ratio, math.sqrt(found[i]) / wanted[i])
            if ratio <= 1.0:
                share = math.log(before) / math.log(before / ratio) if before < math.inf else 1.0
                return float(k + 1 - every * (1.0 - share))
    return float(n * ratio * ratio)


@kernel
def bounds(states: Array, horizon_s: float) -> tuple[float, float, float, float, float]:
    """Lowest and highest position, rad, largest speed, rad/s, lowest and highest stop that a guard predicts, rad.

    ``states`` (n, 2): velocity, rad/s, and position, rad.
    """
    low = high = speed = first = last = 0.0
    for k in range(states.shape[0]):
        v, y = states[k, 0], states[k, 1]
        stop = y + v * horizon_s
        low, high, speed = min(low, y), max(high, y), max(speed, abs(v))
        first, last = min(first, stop), max(last, stop)
    return low, high, speed, first, last
