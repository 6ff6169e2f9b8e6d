"""A motor with departures from the plain model, simulated in small fixed steps. It shares no code with ``rig.model``.

    tau dv/dt = K (w + bias - G(y) - F) - v - K (beta |v| + c v|v|),   y' = v,   reading = S(play(y)) + noise

This is a peer for the model and the estimators of rig: another integrator, another way to meet a reversal, another
author's reading of the same table (docs/theory.md 12). Each step of 50 us freezes the forces at its middle and lets the
velocity tend exponentially to its end value. Halving the step moves a position by some 1e-5 rad in ten seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 5e-5


@dataclass(frozen=True)
class Departures:
    """Sizes of what the plain model leaves out; all zero by default.

    dead_band_V         drive that the bridge loses around zero, V
    gain_by_sign        half the relative difference of the gain of positive and negative drives, 1
    sag_per_V           relative loss of drive per volt of drive, 1/V
    lag_s               electrical time constant, s
    viscous_V_s_rad     half the difference of the viscous friction of both directions, V s/rad
    static_V            static friction above the moving one, at rest only, V
    stribeck_V, stribeck_rad_s    excess of friction at low speed, V, and the speed over which it falls, rad/s
    drag_V_s2_rad2      quadratic drag, V s^2/rad^2
    bristle_V_rad       stiffness of the bristles (LuGre), V/rad; 0: Coulomb
    force_V, force_phase_rad      force over position, once a turn
    friction_share, friction_phase_rad   friction over position, relative to fc, once a turn
    cogging_V, cogging_per_rad, cogging_phase_rad    force of the poles, V, and its order, 1/rad
    backlash_rad        play between the motor and the sensor, whole width, rad
    linearity_rad, linearity_per_rad, linearity_phase_rad   error of the sensor over position
    drift               relative change of the friction over the record, 1
    random_V            standard deviation of a random force of 0.1 s memory, V
    """

    dead_band_V: float = 0.0
    gain_by_sign: float = 0.0
    sag_per_V: float = 0.0
    lag_s: float = 0.0
    viscous_V_s_rad: float = 0.0
    static_V: float = 0.0
    stribeck_V: float = 0.0
    stribeck_rad_s: float = 1.0
    drag_V_s2_rad2: float = 0.0
    bristle_V_rad: float = 0.0
    force_V: float = 0.0
    force_phase_rad: float = 0.0
    friction_share: float = 0.0
    friction_phase_rad: float = 0.0
    cogging_V: float = 0.0
    cogging_per_rad: float = 12.0
    cogging_phase_rad: float = 0.0
    backlash_rad: float = 0.0
    linearity_rad: float = 0.0
    linearity_per_rad: float = 1.0
    linearity_phase_rad: float = 0.0
    drift: float = 0.0
    random_V: float = 0.0

    def numbers(self) -> tuple[float, ...]:
        """All of them, in this order."""
        return tuple(float(getattr(self, one.name)) for one in fields(self))


@dataclass(frozen=True)
class PlainMotor:
    """The plain motor under the departures: tau, s; K, (rad/s)/V; friction, V; bias, V."""

    tau_s: float
    K_rad_s_V: float
    fc_V: float
    bias_V: float = 0.0


@dataclass(frozen=True)
class Bench:
    """How the motor is driven and read.

    period_s, delay_s   of the samples, and from a sample to its drive, s; delay_s is below period_s
    noise_rad, lsb_rad  of the sensor, rad
    offset_rad          of the sensor, rad
    """

    period_s: float = 0.010
    delay_s: float = 0.005
    noise_rad: float = 0.003
    lsb_rad: float = 4.2 / 1024
    offset_rad: float = 0.0


@dataclass(frozen=True)
class Record:
    """A simulated relay test, n rows: times, s; positions as read, rad; drives, V; true positions, rad."""

    t_s: Array
    y_rad: Array
    u_V: Array
    true_y_rad: Array
    true_v_rad_s: Array
    z_rad_s: Array = field(repr=False)


def relay_test(
    motor: PlainMotor,
    departures: Departures,
    bench: Bench,
    gains_V: tuple[float, float],
    rows: int,
    begin_and_whole_s: tuple[float, float],
    seed: np.random.SeedSequence,
    step_s: float = STEP_S,
) -> Record:
    """A relay test from rest at 0.

    gains_V             h1 and h2, V
    begin_and_whole_s   when this test begins, and how long the whole record is, s: friction drifts over the whole
    seed                of noise and random force
    """
    rng = np.random.default_rng(seed)
    noise: Array = bench.offset_rad + bench.noise_rad * rng.standard_normal(rows)
    force = np.zeros(rows)
    if departures.random_V > 0.0:
        keep = np.exp(-bench.period_s / 0.1)
        force[0] = rng.standard_normal()
        for k in range(1, rows):
            force[k] = keep * force[k - 1] + np.sqrt(1.0 - keep * keep) * rng.standard_normal()
    out = np.empty((rows, 5))
    _run(
        (motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V),
        departures.numbers(),
        (bench.period_s, bench.delay_s, bench.lsb_rad, begin_and_whole_s[0], begin_and_whole_s[1], step_s),
        (float(gains_V[0]), float(gains_V[1])),
        noise,
        departures.random_V * force,
        out,
    )
    columns = [np.ascontiguousarray(column, dtype=np.float64) for column in out.T]
    t_s = np.asarray(bench.period_s * np.arange(rows), dtype=np.float64)
    return Record(t_s, columns[0], columns[1], columns[2], columns[3], columns[4])


def reading(y_rad: Array, departures: Departures) -> Array:
    """What the sensor shows at the positions ``y_rad``, without noise, steps, play and offset, rad."""
    d = departures
    return y_rad + d.linearity_rad * np.sin(d.linearity_per_rad * y_rad + d.linearity_phase_rad)


class MovingShaft:
    """The same motor, one span of constant drive after the other: for a law of rig's own, in its closed loop.

    begin_and_whole_s   when the run's time 0 is, and how long the friction's drift takes, s
    """

    def __init__(
        self,
        motor: PlainMotor,
        departures: Departures,
        begin_and_whole_s: tuple[float, float],
        step_s: float = STEP_S,
    ) -> None:
        self._motor = (motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V)
        self._departures = departures
        self._numbers = departures.numbers()
        self._begin_s, self._whole_s = begin_and_whole_s
        self._step_s = step_s
        self._state = (0.0, 0.0, 0.0, 0.0, 0.0)

    def advance(self, u_V: float, force_V: float, t_s: float, dt_s: float) -> None:
        """Let ``dt_s`` pass from ``t_s``, s, on, under the drive ``u_V`` and the random force ``force_V``, V."""
        self._state = _advance(
            self._motor,
            self._numbers,
            (self._begin_s + t_s, self._whole_s, self._step_s),
            (u_V, force_V),
            dt_s,
            self._state,
        )

    @property
    def reading_rad(self) -> float:
        """What the sensor shows, without noise, steps and offset, rad."""
        return float(reading(np.array([self._state[3]]), self._departures)[0])

    @property
    def y_rad(self) -> float:
        """The true position, rad."""
        return self._state[1]


@njit(cache=True)
def _run(motor, departures, timing, gains, noise, force, out):  # type: ignore[no-untyped-def]
    play, lA, ln, lphi = departures[17], departures[18], departures[19], departures[20]
    period, delay, lsb, begin, whole, step = timing
    h1, h2 = gains
    state = (0.0, 0.0, 0.0, 0.0, 0.0)
    u = 0.0
    z = 0.0
    last = 0.0
    sy = sz = 0
    for k in range(noise.size):
        # the sample
        v, y, z_bristle, held, w = state
        held = _played(y, held, play)
        state = (v, y, z_bristle, held, w)
        read = held + lA * np.sin(ln * held + lphi) + noise[k]
        if lsb > 0.0:
            read = lsb * np.floor(read / lsb + 0.5)
        if k == 0:
            sy = sz = 1 if read >= 0.0 else -1
        else:
            z += 0.5 * period * (read + last)
        last = read
        if read > 0.0:
            sy = 1
        elif read < 0.0:
            sy = -1
        if z > 0.0:
            sz = 1
        elif z < 0.0:
            sz = -1
        new = -h1 * sy - h2 * sz
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = read, new, y, v, z
        # to the next sample: the old drive, then the new one
        begins = begin + k * period
        state = _advance(motor, departures, (begins, whole, step), (u, force[k]), delay, state)
        u = new
        state = _advance(motor, departures, (begins + delay, whole, step), (u, force[k]), period - delay, state)


@njit(cache=True)
def _played(y, held, play):  # type: ignore[no-untyped-def]
    """The sensor's side of the play."""
    if y - held > 0.5 * play:
        return y - 0.5 * play
    if held - y > 0.5 * play:
        return y + 0.5 * play
    return held


@njit(cache=True)
def _advance(motor, departures, timing, drive, span, state):  # type: ignore[no-untyped-def]
    """The state v, y, bristles, sensor's side of the play and drive behind the lag, after ``span`` seconds."""
    tau, K, fc, bias = motor
    (dead, by_sign, sag, lag, beta, static, strib, vs, drag, sigma, fA, fphi, qA, qphi, cA, cn, cphi,
     play, _, _, _, drift, _) = departures  # fmt: skip
    begin, whole, step = timing
    u, extra = drive
    v, y, z_bristle, held, w = state
    count = max(1, int(np.ceil(span / step)))
    h = span / count
    goal = 0.0
    if u > dead:
        goal = u - dead
    elif u < -dead:
        goal = u + dead
    goal *= 1.0 + (by_sign if goal > 0.0 else -by_sign)
    goal *= 1.0 - sag * abs(goal)
    share = np.exp(-0.5 * h / lag) if lag > 0.0 else 0.0
    for i in range(count):
        t = begin + (i + 0.5) * h
        w_mid = goal + (w - goal) * share
        w = goal + (w - goal) * share * share
        left = h
        for _ in range(3):
            ym = y + 0.5 * left * v
            level = fc * (1.0 + drift * (t / whole - 0.5)) * (1.0 + qA * np.sin(ym + qphi))
            push = w_mid + bias + extra - fA * np.sin(ym + fphi) - cA * np.sin(cn * ym + cphi)
            if sigma > 0.0:
                # bristles: the excess of a Stribeck effect is in their level
                g = level + strib * np.exp(-abs(v) / vs)
                a = sigma * abs(v) / g
                end = v / a if a > 1e-9 else 0.0
                if a > 1e-9:
                    middle = end + (z_bristle - end) * np.exp(-0.5 * a * left)
                    z_bristle = end + (z_bristle - end) * np.exp(-a * left)
                else:
                    middle = z_bristle + 0.5 * v * left
                    z_bristle += v * left
                acceleration = (K * (push - sigma * middle - beta * abs(v) - drag * v * abs(v)) - v) / tau
                vm = v + 0.5 * left * acceleration
                acceleration = (K * (push - sigma * middle - beta * abs(vm) - drag * vm * abs(vm)) - vm) / tau
                y += left * (v + 0.5 * left * acceleration)
                v += left * acceleration
                break
            sign = 0.0
            if v != 0.0:
                sign = 1.0 if v > 0.0 else -1.0
            elif push > level + static + strib:
                sign = 1.0
            elif push < -(level + static + strib):
                sign = -1.0
            if sign == 0.0:
                break
            # speed at the middle, for what depends on it
            f0 = level + strib * np.exp(-abs(v) / vs)
            a0 = (K * (push - sign * f0 - beta * abs(v) - drag * v * abs(v)) - v) / tau
            vm = v + 0.5 * left * a0
            if vm * sign < 0.0:
                vm = 0.0
            f = level + strib * np.exp(-abs(vm) / vs)
            target = K * (push - sign * f - beta * abs(vm) - drag * vm * abs(vm))
            decay = -np.expm1(-left / tau)
            next_v = v + (target - v) * decay
            if v != 0.0 and next_v * sign < 0.0:
                # it comes to rest within the step: go to there, then on from rest
                stop = tau * np.log1p(-v / target)
                part = -np.expm1(-stop / tau)
                y += target * stop + (v - target) * tau * part
                v = 0.0
                left -= stop
                if left <= 0.0:
                    break
                if y - held > 0.5 * play:
                    held = y - 0.5 * play
                elif held - y > 0.5 * play:
                    held = y + 0.5 * play
                continue
            y += target * left + (v - target) * tau * decay
            v = next_v
            break
        if y - held > 0.5 * play:
            held = y - 0.5 * play
        elif held - y > 0.5 * play:
            held = y + 0.5 * play
    return v, y, z_bristle, held, w
