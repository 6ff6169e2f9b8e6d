"""Motion under Tustin's friction: against quadrature, an ODE solver, closed forms in the limits, and its own bound."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from crossing import Crossing
from evidence import examples
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from rig.model.friction import Friction, coulomb, tustin
from rig.model.motor import Motor, State
from rig.run_folder.recording.series import steps_of
from shared import physics
from shared.physics import Arc, Glide, pieces, stopping_distance, terminal_velocity

taus = st.floats(0.05, 0.5)
gains = st.floats(1.0, 20.0)
levels = st.floats(0.0, 0.6)
drops = st.floats(0.001, 0.5)  # fs - fc
widths = st.floats(0.01, 2.0)  # vs
viscous = st.sampled_from([0.0, 0.01, 0.1])
drives = st.integers(-3000, 3000).map(lambda mV: mV / 1e3)
speeds = st.integers(-10_000, 10_000).map(lambda mrad_s: mrad_s / 1e3)
spans = st.floats(0.001, 1.0)


@st.composite
def motors(draw: st.DrawFn) -> Motor:
    fc_plus, fc_minus, ratio = draw(levels), draw(levels), draw(st.floats(1.0, 2.0))
    friction = Friction(
        fc_plus, fc_minus, fc_plus + draw(drops), fc_minus * ratio, draw(widths), draw(viscous)
    )  # the second way may be without Stribeck effect
    return Motor(draw(taus), draw(gains), friction, draw(st.floats(-0.1, 0.1)))


def slope(motor: Motor, u_V: float, sign: float) -> Callable[[float, np.ndarray], list[float]]:
    """Right side of the plant's equations while it moves one way, friction written out, smooth a little beyond rest."""
    f = motor.friction
    fc, fs = (f.plus_V, f.static_plus_V) if sign > 0 else (f.minus_V, f.static_minus_V)

    def right_side(t: float, x: np.ndarray) -> list[float]:
        friction = (
            sign * (fc + (fs - fc) * np.exp(min(-sign * x[0] / f.stribeck_rad_s, 3.0))) + f.viscous_V_s_rad * x[0]
        )
        return [(motor.K_rad_s_V * (u_V + motor.bias_V - friction) - x[0]) / motor.tau_s, x[0], x[1]]

    return right_side


def integrate(motor: Motor, state: State, u_V: float, dt_s: float) -> np.ndarray:
    """The same by a general ODE solver that stops where the velocity crosses zero."""
    stop = Crossing(0)
    x: np.ndarray = np.array(state, dtype=float)
    now = 0.0
    while True:
        drive = u_V + motor.bias_V
        if x[0] != 0.0:
            sign = math.copysign(1.0, x[0])
        elif -motor.friction.static_minus_V <= drive <= motor.friction.static_plus_V:
            return np.asarray(x + np.array([0.0, 0.0, x[1] * (dt_s - now)]))
        else:
            sign = math.copysign(1.0, drive)
        stop.direction = -sign
        run = solve_ivp(slope(motor, u_V, sign), (now, dt_s), x, events=stop, rtol=1e-12, atol=1e-13, method="DOP853")
        x = run.y[:, -1].copy()
        if run.status != 1:
            return x
        now, x[0] = run.t[-1], 0.0


def well_posed(motor: Motor, v: float, u_V: float) -> None:
    """Leave out where the smallest change decides whether it sticks: no solver can be held to anything there."""
    f, drive = motor.friction, u_V + motor.bias_V
    assume(min(abs(drive - f.static_plus_V), abs(drive + f.static_minus_V)) > 0.02)
    if v != 0.0:
        sign = math.copysign(1.0, v)
        net = sign * motor.K_rad_s_V * (drive - f.level(v)) - abs(v)
        assume(abs(net) > 0.02 * motor.K_rad_s_V)


@settings(max_examples=examples(60), deadline=None)
@given(motors(), speeds, drives, spans)
def test_advance_is_the_solution_of_the_differential_equation(motor: Motor, v: float, u_V: float, dt_s: float) -> None:
    well_posed(motor, v, u_V)
    scale = 1.0 + abs(v) + motor.K_rad_s_V * (abs(u_V) + 1.0)
    state = State(v, 0.3, -0.1)
    assert np.array(motor.advance(state, u_V, dt_s)) == pytest.approx(
        integrate(motor, state, u_V, dt_s), abs=1e-8 * scale
    )


@pytest.mark.parametrize(
    ("v0", "v1", "u_V"),
    [(4.0, 0.5, 0.2), (4.0, 0.02, -1.5), (0.5, 1e-3, 0.3), (0.0, 5.0, 1.5), (0.0, 0.2, 0.62), (1e-3, 2.0, 1.2)],
)
@pytest.mark.parametrize("width", [0.02, 0.2, 2.0])
def test_time_path_and_integral_between_two_speeds_are_those_of_quadrature(
    v0: float, v1: float, u_V: float, width: float
) -> None:
    """The velocity's equation is separable: t = int dv/a(v), y = int v dv/a(v); an independent peer to 1e-12."""
    motor = Motor(0.17, 6.5, tustin(0.4, 0.6, width, 0.02))

    def acceleration(v: float) -> float:
        return (6.5 * (u_V - 0.4 - 0.2 * math.exp(-v / width) - 0.02 * v) - v) / 0.17

    points = [p for p in (width, 5.0 * width, 20.0 * width) if min(v0, v1) < p < max(v0, v1)]

    def total(integrand: Callable[[float], float]) -> float:
        value, error = quad(integrand, v0, v1, points=points or None, epsabs=1e-14, epsrel=1e-13, limit=400)
        assert error < 1e-11
        return float(value)

    t_s = total(lambda v: 1.0 / acceleration(v))
    y_rad = total(lambda v: v / acceleration(v))
    end = motor.advance(State(v0), u_V, t_s)
    assert end.v == pytest.approx(v1, abs=1e-11 + 1e-11 * abs(acceleration(v1)))
    assert end.y == pytest.approx(y_rad, abs=2e-12)


@settings(max_examples=examples(60), deadline=None)
@given(st.floats(0.0, 30.0), st.floats(-60.0, 60.0), st.floats(1e-3, 1e3))
@example(0.0, 1e-9, 50.0)
@example(3.0, 0.0, 50.0)
def test_a_step_is_as_good_as_its_bound_says(x: float, e: float, b: float) -> None:
    """A step of the series against twice as many quarter steps, and its terms against Cauchy's estimate."""
    if x == 0.0:
        e = abs(e) + 1e-9
    step, c = physics.expand(x, e, b)
    assume(step < 50.0)
    slope = abs(c[1])
    radius = math.log1p((1.0 + slope) / (b * math.exp(-x)))
    rho = step * physics.RATIO
    for k in range(1, physics.ORDER + 1):
        assert abs(c[k]) * rho**k <= radius * (1.0 + 1e-9)
    small = x
    for _ in range(8):
        _, finer = physics.expand(small, e, b)
        small = physics.speed_at(finer, step / 8.0)
    # rounding of the right side is amplified where its slope is positive, by at most the growth over the step
    rounding = 4e-15 * (1.0 + x + abs(e) + b) * (1.0 + step * (1.0 + b)) * math.exp(min(step * b * math.exp(-x), 3.0))
    assert abs(physics.speed_at(c, step) - small) <= physics.TRUNCATION * radius + rounding


def test_the_error_falls_with_the_order_as_the_bound_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same step cut off earlier: the error is below R RATIO^-p/(RATIO - 1) at every order p."""
    x, e, b = 0.5, -3.0, 4.0
    step, c = physics.expand(x, e, b)
    radius = math.log1p((1.0 + abs(c[1])) / (b * math.exp(-x)))
    exact = physics.speed_at(c, step)
    errors = [abs(sum(c[k] * step**k for k in range(p + 1)) - exact) for p in range(2, 13)]
    bounds = [radius * physics.RATIO**-p / (physics.RATIO - 1.0) for p in range(2, 13)]
    assert all(error <= bound for error, bound in zip(errors, bounds, strict=True))
    assert errors[-1] < 1e-6 * errors[0]


@settings(max_examples=examples(40), deadline=None)
@given(taus, gains, levels, widths, viscous, speeds, drives, spans)
def test_without_a_drop_of_friction_it_is_the_closed_form(
    tau: float, K: float, fc: float, width: float, fv: float, v: float, u_V: float, dt_s: float
) -> None:
    """With fs = fc, whatever the Stribeck velocity; and viscous friction as effective parameters."""
    shown = Motor(tau / (1.0 + K * fv), K / (1.0 + K * fv), coulomb(fc))
    motor = Motor(tau, K, tustin(fc, fc, width, fv))
    assert motor.has_closed_form
    assert motor.advance(State(v), u_V, dt_s) == pytest.approx(shown.advance(State(v), u_V, dt_s), rel=1e-12, abs=1e-12)
    assert motor.tau_eff_s / motor.K_eff_rad_s_V == pytest.approx(tau / K)
    almost = Motor(tau, K, tustin(fc, fc + 1e-12, width, fv))
    assert not almost.has_closed_form
    assume(abs(abs(u_V) - fc) > 1e-6)
    assert np.array(almost.advance(State(v), u_V, dt_s)) == pytest.approx(
        np.array(shown.advance(State(v), u_V, dt_s)), abs=1e-8 * (1.0 + abs(v) + 4.0 * K)
    )


@settings(max_examples=examples(40), deadline=None)
@given(taus, gains, levels, st.floats(0.01, 0.3), speeds, drives, spans)
def test_with_a_vanishing_stribeck_velocity_it_is_static_friction_at_rest_only(
    tau: float, K: float, fc: float, drop: float, v: float, u_V: float, dt_s: float
) -> None:
    assume(min(abs(abs(u_V) - fc), abs(abs(u_V) - fc - drop)) > 1e-3)
    limit = Motor(tau, K, coulomb(fc, fc + drop))
    motor = Motor(tau, K, tustin(fc, fc + drop, 1e-9))
    scale = 1.0 + abs(v) + 4.0 * K
    assert np.array(motor.advance(State(v), u_V, dt_s)) == pytest.approx(
        np.array(limit.advance(State(v), u_V, dt_s)), abs=1e-6 * scale
    )


@settings(max_examples=examples(40), deadline=None)
@given(motors(), speeds, drives, spans, st.integers(2, 5))
def test_many_small_steps_are_one_large_step(motor: Motor, v: float, u_V: float, dt_s: float, steps: int) -> None:
    well_posed(motor, v, u_V)
    whole = motor.advance(State(v), u_V, dt_s)
    state = State(v)
    for _ in range(steps):
        state = motor.advance(state, u_V, dt_s / steps)
    assert np.array(state) == pytest.approx(np.array(whole), abs=1e-10 * (1.0 + abs(v) + motor.K_rad_s_V * 4.0))


@settings(max_examples=examples(40), deadline=None)
@given(motors(), speeds, drives)
def test_the_mirrored_motor_moves_in_the_mirror(motor: Motor, v: float, u_V: float) -> None:
    f = motor.friction
    mirrored = Friction(f.minus_V, f.plus_V, f.static_minus_V, f.static_plus_V, f.stribeck_rad_s, f.viscous_V_s_rad)
    other = Motor(motor.tau_s, motor.K_rad_s_V, mirrored, -motor.bias_V)
    one = motor.advance(State(v, 0.2, 0.1), u_V, 0.3)
    assert other.advance(State(-v, -0.2, -0.1), -u_V, 0.3) == pytest.approx([-q for q in one], abs=1e-14)


# ------------------------------------------------------------------ sticking, and the two equilibria

# K (u - f(v)) = v at 0.55 V has two solutions here: an unstable one near 0.03 rad/s, a stable one near 0.92.
TWO = Motor(0.17, 6.5, tustin(0.4, 0.6, 0.1))
U_TWO = 0.55


def equilibria() -> tuple[float, float]:
    v = np.linspace(1e-6, 2.0, 200_001)
    net = 6.5 * (U_TWO - 0.4 - 0.2 * np.exp(-v / 0.1)) - v
    crossings = np.flatnonzero(np.sign(net[1:]) != np.sign(net[:-1]))
    assert crossings.size == 2
    return float(v[crossings[0]]), float(v[crossings[1]])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_above_the_unstable_speed_it_runs_on_and_below_it_creeps_to_a_stop_and_sticks(sign: float) -> None:
    unstable, stable = equilibria()
    above = TWO.advance(State(sign * unstable * 1.02), sign * U_TWO, 6.0)
    assert abs(above.v) == pytest.approx(stable, abs=1e-4)
    below = TWO.advance(State(sign * unstable * 0.98), sign * U_TWO, 6.0)
    assert below.v == 0.0
    assert 0.0 < sign * below.y < unstable  # it crept on a little
    assert TWO.advance(below, sign * U_TWO, 5.0) == State(0.0, below.y, below.z + 5.0 * below.y)
    for v in (unstable * 1.02, stable * 2.0):
        assert terminal_velocity(TWO, sign * v, sign * U_TWO) == pytest.approx(sign * stable, abs=2e-5)
    assert terminal_velocity(TWO, sign * unstable * 0.98, sign * U_TWO) == 0.0


def test_on_the_unstable_speed_it_stays_for_as_long_as_rounding_lets_it() -> None:
    low, high = 0.02, 0.05
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if terminal_velocity(TWO, middle, U_TWO) == 0.0 else (low, middle)
    held = TWO.advance(State(high), U_TWO, 0.2)
    assert held.v == pytest.approx(high, rel=1e-9)


def test_from_rest_it_gives_way_above_the_static_level_only() -> None:
    assert TWO.advance(State(), 0.6, 10.0) == State()
    assert TWO.advance(State(), -0.6, 10.0) == State()
    released = TWO.advance(State(), 0.6 + 1e-6, 10.0)
    assert released.v == pytest.approx(terminal_velocity(TWO, 0.0, 0.6 + 1e-6), rel=1e-6)
    # once it moves, less than the static level keeps it going; the same drive does not start it
    assert TWO.advance(State(released.v), 0.5, 10.0).v > 0.5
    assert TWO.advance(State(), 0.5, 10.0).v == 0.0


def test_without_drive_it_comes_to_rest_and_stays() -> None:
    t = np.linspace(0.0, 3.0, 300)
    v = TWO.response(State(5.0), t, [0.0], [0.0])[:, 0]
    assert np.all(np.diff(v) <= 0.0)
    assert v[-1] == 0.0
    distance = stopping_distance(TWO, 5.0)
    assert 0.0 < distance < stopping_distance(Motor(0.17, 6.5, coulomb(0.4)), 5.0)
    assert stopping_distance(TWO, -5.0) == -distance


@settings(max_examples=examples(60), deadline=None)
@given(motors(), speeds, drives)
def test_terminal_velocity_is_where_long_motion_ends(motor: Motor, v: float, u_V: float) -> None:
    well_posed(motor, v, u_V)
    end = terminal_velocity(motor, v, u_V)
    # a reversal ends where the motion from rest does, and that is well posed as well
    assert motor.advance(State(v), u_V, 300.0 * motor.tau_s).v == pytest.approx(end, abs=1e-3)


@settings(max_examples=examples(60), deadline=None)
@given(motors(), speeds, drives, spans)
def test_pieces_meet_and_velocity_keeps_its_sign_within_each(motor: Motor, v: float, u_V: float, dt_s: float) -> None:
    state, total = State(v, 0.1, 0.0), 0.0
    for piece in pieces(motor, state, u_V, dt_s):
        assert np.array(piece.start) == pytest.approx(np.array(state), abs=1e-10 * (1.0 + abs(v)))
        inside = [piece.at(share * piece.duration_s).v for share in (0.01, 0.5, 0.99)]
        assert min(inside) >= 0.0 or max(inside) <= 0.0
        total += piece.duration_s
        state = piece.at(piece.duration_s)
    assert total == pytest.approx(dt_s, rel=1e-9)
    assert np.array(state) == pytest.approx(np.array(motor.advance(State(v, 0.1, 0.0), u_V, dt_s)), abs=1e-12)


def test_far_from_rest_it_uses_the_closed_form() -> None:
    kinds = [type(piece) for piece in pieces(Motor(0.17, 6.5, tustin(0.4, 0.6, 0.01)), State(4.0), -1.0, 1.0)]
    assert kinds[0] is Glide and Arc in kinds and kinds[-1] is Glide


def test_a_glide_that_ends_where_the_effect_begins_is_followed_by_it_whatever_the_rounding() -> None:
    rng = np.random.default_rng(1)
    for width in rng.uniform(0.001, 0.1, 300).tolist():
        motor = Motor(0.17, 6.5, tustin(0.4, 0.6, width))
        found = list(pieces(motor, State(60.0 * width), -3.0, 0.3))
        assert [type(piece) for piece in found[:2]] == [Glide, Arc]
        assert len(found) < 100 and motor.advance(State(60.0 * width), -3.0, 0.3).v < 0.0


@pytest.mark.parametrize("width", [1e-300, 1e-14, 1e30])
def test_a_stribeck_velocity_beyond_all_measure_is_static_friction_at_rest_or_at_every_speed(width: float) -> None:
    motor, limit = Motor(0.17, 6.5, tustin(0.4, 0.6, width)), Motor(0.17, 6.5, coulomb(0.6 if width > 1 else 0.4, 0.6))
    for u_V in (-1.5, 0.5, 2.0):
        assert np.array(motor.advance(State(3.0), u_V, 0.5)) == pytest.approx(
            np.array(limit.advance(State(3.0), u_V, 0.5)), abs=1e-9
        )


def test_the_law_is_that_of_the_theory() -> None:
    f = Friction(0.4, 0.5, 0.6, 0.8, 0.1, 0.02)
    assert f.level(0.1) == pytest.approx(0.4 + 0.2 / math.e + 0.002)
    assert f.level(-0.2) == pytest.approx(-0.5 - 0.3 / math.e**2 - 0.004)
    assert f.level(0.0) == 0.0
    assert coulomb(0.4, 0.6).level(1e-9) == 0.4
    for wrong in (
        {"stribeck_rad_s": -0.1},
        {"viscous_V_s_rad": -0.1},
        {"stribeck_rad_s": math.nan},
        {"viscous_V_s_rad": math.inf},
    ):
        with pytest.raises(ValueError, match=">= 0"):
            Friction(0.4, 0.4, 0.6, 0.6, **wrong)
    with pytest.raises(ValueError, match="static"):
        tustin(0.5, 0.4, 0.1)


# ------------------------------------------------------------------ whole records


@settings(max_examples=examples(30), deadline=None)
@given(
    taus, gains, levels, st.sampled_from([0.0, 0.05, 0.3]), widths, st.floats(-0.1, 0.1), st.floats(0.0, 0.02), speeds,
    st.lists(st.tuples(drives, st.floats(0.0, 0.3)), min_size=1, max_size=8), st.integers(1, 40),
)  # fmt: skip
def test_a_record_is_advance_repeated(
    tau: float,
    K: float,
    fc: float,
    drop: float,
    width: float,
    asym: float,
    delay: float,
    v0: float,
    plan: list[tuple[float, float]],
    samples: int,
) -> None:
    edges = np.concatenate(([0.0], np.cumsum([span for _, span in plan])[:-1]))
    drive = steps_of(edges, np.array([level for level, _ in plan]))
    t_s = np.sort(np.linspace(0.01, float(edges[-1]) + 0.4, samples))
    motor = Motor(tau, K, tustin(fc, fc + drop, width), asym)
    shifted = drive.edge_s + delay
    shifted[0] = min(shifted[0], 0.0)
    states = motor.response(State(v0, 0.3), t_s, shifted, drive.u_V)
    state, now = State(v0, 0.3), float(t_s[0])
    for k, stop in enumerate(t_s):
        cuts = [edge for edge in shifted if now < edge < stop]
        for until in [*cuts, stop]:
            acting = drive.u_V[int(np.searchsorted(shifted, now, side="right")) - 1]
            state = motor.advance(state, acting, until - now)
            now = until
        assert states[k] == pytest.approx(np.array(state), abs=1e-8 * (1.0 + abs(v0) + 4.0 * K))
