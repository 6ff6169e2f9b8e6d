"""The exact motor against closed forms, an independent ODE solver, and itself in smaller steps."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from crossing import Crossing
from directional_friction import directional
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from rig.model.friction import NONE, Friction, coulomb
from rig.model.linear import input_vector, settled, transition
from rig.model.motor import Motor, State
from shared.physics import pieces, stopping_distance

taus = st.floats(0.02, 1.0)
gains = st.floats(0.5, 20.0)
levels = st.floats(0.0, 0.8)
drives = st.floats(-3.0, 3.0)
speeds = st.floats(-10.0, 10.0)
spans = st.floats(0.001, 2.0)


def integrate(motor: Motor, state: State, u_V: float, dt_s: float) -> np.ndarray:
    """The same by a general ODE solver that stops where the velocity crosses zero."""

    def field(direction: float) -> Callable[[float, np.ndarray], list[float]]:
        f = motor.friction

        def slope(t: float, x: np.ndarray) -> list[float]:
            friction = f.plus_V if direction > 0 else -f.minus_V
            return [(motor.K_rad_s_V * (u_V + motor.bias_V - friction) - x[0]) / motor.tau_s, x[0], x[1]]

        return slope

    stop = Crossing(0)
    x: np.ndarray = np.array(state, dtype=float)
    now = 0.0
    direction = math.copysign(1.0, x[0]) if x[0] else 0.0
    while True:
        if direction == 0.0:
            drive = u_V + motor.bias_V
            if -motor.friction.static_minus_V <= drive <= motor.friction.static_plus_V:
                return np.asarray(x + np.array([0.0, 0.0, x[1] * (dt_s - now)]))
            direction = math.copysign(1.0, drive)
        stop.direction = -direction
        run = solve_ivp(field(direction), (now, dt_s), x, events=stop, rtol=1e-10, atol=1e-12, method="DOP853")
        x = run.y[:, -1].copy()
        if run.status != 1:
            return x
        now, x[0], direction = run.t[-1], 0.0, 0.0


def test_first_order_step_response_has_its_textbook_values() -> None:
    motor = Motor(0.2, 5.0)
    state = motor.advance(State(), 2.0, 0.2)
    assert state.v == pytest.approx(10.0 * (1.0 - math.exp(-1.0)), rel=1e-14)
    assert state.y == pytest.approx(10.0 * 0.2 - 10.0 * 0.2 * (1.0 - math.exp(-1.0)), rel=1e-14)
    assert state.z == pytest.approx(10.0 * 0.02 - 10.0 * (0.04 - 0.04 * (1.0 - math.exp(-1.0))), rel=1e-13)


def test_reversal_time_is_the_zero_of_the_velocity() -> None:
    tau, v, target = 0.17, 3.0, -6.5
    motor = Motor(tau, 1.0)
    first, second = pieces(motor, State(v), target, 10.0)
    assert first.duration_s == pytest.approx(-tau * math.log(target / (target - v)), rel=1e-14)
    assert second.start.v == 0.0
    assert [piece.duration_s for piece in pieces(motor, State(v), 1.0, 10.0)] == [10.0]
    assert [piece.duration_s for piece in pieces(motor, State(), -1.0, 10.0)] == [10.0]


def test_at_zero_volts_it_stops_after_the_distance_of_the_closed_form() -> None:
    motor = Motor(0.17, 6.5, coulomb(0.5))
    v, decel = 4.8, 6.5 * 0.5
    stop_s = 0.17 * math.log1p(v / decel)
    assert stopping_distance(motor, v) == pytest.approx(0.17 * v - decel * stop_s, rel=1e-12)
    assert stopping_distance(motor, -v) == pytest.approx(-stopping_distance(motor, v))


@pytest.mark.parametrize(("u_V", "moves"), [(0.5, 0), (0.61, 1), (-0.5, 0), (-0.71, -1)])
def test_static_friction_holds_up_to_its_level_and_then_gives_way_to_the_moving_one(u_V: float, moves: int) -> None:
    motor = Motor(0.1, 4.0, Friction(0.4, 0.5, 0.6, 0.7))
    end = motor.advance(State(), u_V, 3.0)
    if moves:
        assert end.v == pytest.approx(4.0 * (u_V - 0.4 if moves > 0 else u_V + 0.5), rel=1e-9)
    else:
        assert end == State()


def test_bias_and_direction_show_in_motion_only_as_asymmetry() -> None:
    one = Motor(0.17, 6.5, Friction(0.5, 0.4, 0.6, 0.6), 0.02)
    other = Motor(0.17, 6.5, Friction(0.45, 0.45, 0.6, 0.6), 0.02 - 0.05)
    assert one.asym_V == pytest.approx(other.asym_V)
    assert one.friction.fc_V == pytest.approx(other.friction.fc_V)
    for u_V in (1.5, -1.5):
        assert one.advance(State(2.0), u_V, 0.5) == pytest.approx(other.advance(State(2.0), u_V, 0.5))


@settings(max_examples=examples(60), deadline=None)
@given(taus, gains, levels, levels, st.floats(1.0, 1.5), st.floats(-0.2, 0.2), speeds, drives, spans)
def test_advance_is_the_solution_of_the_differential_equation(
    tau: float, K: float, plus: float, minus: float, ratio: float, bias: float, v: float, u_V: float, dt_s: float
) -> None:
    motor = Motor(tau, K, directional(plus, minus, ratio), bias)
    state = State(v, 0.3, -0.1)
    if abs(abs(u_V + bias) - max(plus, minus)) < 1e-6:
        u_V += 1e-3
    expected = integrate(motor, state, u_V, dt_s)
    scale = 1.0 + abs(v) + K * (abs(u_V) + 1.0)
    assert np.array(motor.advance(state, u_V, dt_s)) == pytest.approx(expected, abs=1e-7 * scale)


def test_energy_never_grows_without_drive() -> None:
    motor = Motor(0.17, 6.5, coulomb(0.4))
    t = np.linspace(0.0, 3.0, 200)
    v = motor.response(State(5.0), t, [0.0], [0.0])[:, 0]
    assert np.all(np.diff(np.abs(v)) <= 0.0)
    assert v[-1] == 0.0


@pytest.mark.parametrize(
    ("t_s", "edges", "u"),
    [([1.0, 0.0], [0.0], [1.0]), ([0.0, 1.0], [0.5], [1.0]), ([0.0], [0.0, 1.0], [1.0]), ([0.0], [], [])],
)
def test_unordered_times_and_unknown_drive_are_refused(t_s: list[float], edges: list[float], u: list[float]) -> None:
    with pytest.raises(ValueError, match=r"times|drive|one-dimensional"):
        Motor(0.1, 1.0).response(State(), t_s, edges, u)


def test_parameters_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="tau_s"):
        Motor(0.0, 1.0)
    with pytest.raises(ValueError, match=">= 0"):
        coulomb(-0.1)
    with pytest.raises(ValueError, match="static"):
        coulomb(0.5, 0.4)
    assert NONE.fc_V == 0.0


@settings(max_examples=examples(60), deadline=None)
@given(taus, gains, st.floats(0.001, 0.05), st.floats(1e-4, 0.03), st.floats(0.01, 1.0))
def test_a_filter_settles_as_scipy_says(
    tau_s: float, K: float, h_s: float, noise_rad: float, noise_rad_s: float
) -> None:
    A, B = transition(tau_s, h_s)[:2, :2], input_vector(tau_s, K, h_s)[:2]
    H, R = np.outer(B, B) * 0.02 + 1e-8 * np.eye(2), np.diag([noise_rad**2, noise_rad_s**2])
    C = np.array([[0.0, 1.0], [1.0, 0.0]])
    for seen in (1, 2):  # the position alone; the tachometer, too
        by, noise = C[:seen], R[:seen, :seen]
        found = settled(A, by.T @ np.linalg.inv(noise) @ by, H)
        np.testing.assert_allclose(found, solve_discrete_are(A.T, by.T, H, noise), rtol=1e-6)
    np.testing.assert_allclose(settled(0.9 * A, np.zeros((2, 2)), H), solve_discrete_lyapunov(0.9 * A, H), rtol=1e-9)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_what_does_not_settle_is_no_filter() -> None:
    with pytest.raises(ArithmeticError, match="does not settle"):
        settled(1.1 * np.eye(2), np.zeros((2, 2)), np.eye(2))
