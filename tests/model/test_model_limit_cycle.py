"""Theorems 2.1 and 2.2: the table of docs/theory.md 3.4, an ODE solver with events, and the stepped motor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from crossing import Crossing
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from rig.model.friction import coulomb
from rig.model.limit_cycle import NoLimitCycle, initial_state, limit_cycle
from rig.model.motor import Motor, State

# tau, K, fc, h1, h2; t1, t2, t3, y(t1); eigenvalues of J; largest eigenvalue of J3 (docs/theory.md 3.4)
TABLE = [
    (1, 1, 0.5, 0.8, 1.0, 0.046812, 0.837516, 0.927743, -0.351390, -0.620786, 0.148697, 1.482359),
    (1, 1, 0.5, 0.5, 1.2, 0.127438, 1.774867, 2.085097, -1.133248, -0.585929, 0.017267, 0.672361),
    (0.17, 6.5, 0.5, 0.8, 1.0, 0.007958, 0.142378, 0.157716, -0.388286, -0.620786, 0.148697, 1.482359),
    (0.35, 3.0, 0.4, 1.2, 1.35, 0.027935, 0.368297, 0.421179, -0.906205, -0.566496, 0.124492, 1.246701),
    (0.17, 6.5, 0.0, 0.8, 1.0, 0.031401, 0.282368, 0.345168, -1.692517, -0.526053, 0.039410, 0.764664),
]

motors = st.tuples(
    st.floats(0.08, 0.5), st.floats(1.0, 20.0), st.floats(0.1, 0.5), st.floats(0.3, 1.0), st.floats(0.4, 1.0)
)  # the grid of docs/theory.md 7.10: tau, K, fc, h2 - fc, h1 / h2


@pytest.mark.parametrize("row", TABLE)
def test_the_table_of_check_values(
    row: tuple[float, ...],
) -> None:
    cycle = limit_cycle(*row[:5])
    assert cycle.durations_s == pytest.approx(row[5:8], abs=0.6e-6)
    assert cycle.states[1, 1] == pytest.approx(row[8], abs=0.6e-6)
    eigenvalues = cycle.eigenvalues()
    assert np.abs(eigenvalues.imag).max() == 0.0
    assert eigenvalues.real == pytest.approx([row[9], row[10], 0.0], abs=0.6e-6)
    assert np.abs(np.linalg.eigvals(cycle.stage_jacobians()[2])).max() == pytest.approx(row[11], abs=0.6e-6)
    assert cycle.stable


@settings(max_examples=examples(60), deadline=None)
@given(motors)
def test_the_switching_conditions_hold_and_nothing_else_switches(parameters: tuple[float, ...]) -> None:
    tau, K, fc, beyond, share = parameters
    h2 = fc + beyond
    cycle = limit_cycle(tau, K, fc, share * h2, h2)
    size = cycle.amplitude_rad
    assert abs(cycle.states[1, 0]) < 1e-9 * cycle.speed_rad_s
    assert abs(cycle.states[2, 1]) < 1e-9 * size
    assert abs(cycle.states[0, 2]) < 1e-9 * size * cycle.period_s
    assert cycle.states[3] == pytest.approx(-cycle.states[0], abs=1e-9 * (size + cycle.speed_rad_s))
    assert initial_state(tau, K, cycle.durations_s, cycle.inputs_V) == pytest.approx(cycle.states[0])
    assert cycle.stable
    # The motor, stepped finely through a half period under the relay's drive, switches nowhere else.
    t1, t2, t3 = cycle.durations_s
    motor = Motor(tau, K, coulomb(fc))
    t = np.linspace(0.0, t1 + t2 + t3, 400)
    path = motor.response(State(*cycle.states[0]), t, [0.0, t1 + t2], [h2 * (1 + share), h2 * (1 - share)])
    inside = t[1:-1]
    v, y, z = path[1:-1].T
    tiny = 1e-7 * size
    assert np.all((v < tiny / tau) == (inside < t1 + 1e-7)) or np.all(v[inside < t1] < tiny)
    assert np.all(v[inside > t1 + 1e-6] > 0.0)
    assert np.all(y[inside < t1 + t2 - 1e-6] < 0.0)
    assert np.all(y[inside > t1 + t2 + 1e-6] > 0.0)
    assert np.all(z < tiny)


def test_shape_depends_on_the_gains_and_friction_alone() -> None:
    slow, fast = limit_cycle(1.0, 1.0, 0.5, 0.8, 1.0), limit_cycle(0.17, 6.5, 0.5, 0.8, 1.0)
    assert np.array(fast.durations_s) == pytest.approx(0.17 * np.array(slow.durations_s), rel=1e-9)
    assert fast.amplitude_rad == pytest.approx(6.5 * 0.17 * slow.amplitude_rad, rel=1e-9)
    assert fast.eigenvalues() == pytest.approx(slow.eigenvalues(), abs=1e-9)


def test_an_ode_solver_with_events_reaches_the_same_cycle() -> None:
    tau, K, fc, h1, h2 = 0.17, 6.5, 0.5, 0.8, 1.0
    cycle = limit_cycle(tau, K, fc, h1, h2)
    x, now = np.array([0.0, -0.2, -0.01]), 0.0
    signs = np.array([1.0, -1.0, -1.0])
    rises: list[tuple[float, np.ndarray, float]] = []
    while len(rises) < 40:
        u = -h1 * signs[1] - h2 * signs[2] - fc * signs[0]

        def slope(t: float, x: np.ndarray, u: float = u) -> list[float]:
            return [(K * u - x[0]) / tau, x[0], x[1]]

        events = [Crossing(k, -signs[k]) for k in range(3)]
        run = solve_ivp(slope, (now, now + 10.0), x, events=events, rtol=1e-11, atol=1e-13, method="DOP853")
        assert run.t_events is not None
        switched = [k for k in range(3) if run.t_events[k].size]
        now, x = run.t[-1], run.y[:, -1].copy()
        for k in switched:
            signs[k] = -signs[k]
            x[k] = 0.0
            if k == 2:
                rises.append((now, x.copy(), signs[2]))
    period = rises[-1][0] - rises[-3][0]
    assert period == pytest.approx(cycle.period_s, rel=1e-7)
    end = rises[-1][1] * (1.0 if rises[-1][2] < 0.0 else -1.0)
    assert end[:2] == pytest.approx(cycle.states[0, :2], rel=1e-6)


@pytest.mark.parametrize("tau", [0.17, 0.4])
def test_theorem_2_2_is_how_fast_the_stepped_motor_returns(tau: float) -> None:
    """Perturb the state at RC, run the exact half period with switching on the planes, compare with J."""
    K, fc, h1, h2 = 6.5, 0.5, 0.8, 1.0
    cycle = limit_cycle(tau, K, fc, h1, h2)
    motor = Motor(tau, K, coulomb(fc))

    def half_period(state: State) -> np.ndarray:
        for u, plane, span in ((h1 + h2, 1, sum(cycle.durations_s[:2])), (h2 - h1, 2, cycle.durations_s[2])):
            low, high = 0.6 * span, 1.4 * span
            for _ in range(200):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if motor.advance(state, u, middle)[plane] < 0.0 else (low, middle)
            state = motor.advance(state, u, high)
        return np.array(state)

    base = np.array(cycle.states[0])
    numeric = np.empty((3, 3))
    for k in range(3):
        step = np.zeros(3)
        step[k] = 1e-6 * max(1.0, abs(base[k]))
        numeric[:, k] = (half_period(State(*(base + step))) - half_period(State(*(base - step)))) / (2.0 * step[k])
    assert cycle.jacobian() == pytest.approx(numeric, abs=1e-4)


@pytest.mark.parametrize("fc", [0.0, 0.01, 0.5, 3.0])
@pytest.mark.parametrize("beyond", [0.01, 0.3, 10.0])
@pytest.mark.parametrize("h1", [0.01, 0.3, 10.0])
def test_the_solver_finds_the_cycle_far_from_the_usual_gains(fc: float, beyond: float, h1: float) -> None:
    cycle = limit_cycle(1.0, 1.0, fc, h1, fc + beyond)
    sine_period = 2.0 * math.pi * beyond / h1
    assert 0.4 * sine_period < cycle.period_s < 2.5 * sine_period
    assert cycle.stable


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ((0.17, 6.5, 0.5, 0.8, 0.5), "Property 3.1"),
        ((0.17, 6.5, 0.5, 0.8, 0.2), "Property 3.1"),
        ((0.17, 6.5, 0.5, 0.2, 0.6, 0.9), "sticks"),
    ],
)
def test_where_there_is_no_cycle_it_says_why(parameters: tuple[float, ...], words: str) -> None:
    with pytest.raises(NoLimitCycle, match=words):
        limit_cycle(*parameters)


def test_parameters_out_of_range_are_refused() -> None:
    for wrong in ((0.0, 1, 0.1, 1, 1), (1, 1, -0.1, 1, 1), (1, 1, 0.1, 0.0, 1), (1, 1, 0.5, 1, 1, 0.4)):
        with pytest.raises(ValueError, match="need"):
            limit_cycle(*wrong)
