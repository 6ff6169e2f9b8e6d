"""The relay loop in continuous time: Theorems 2.1 and 2.2, an ODE solver with events, and docs/theory.md 5.1."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from crossing import Crossing
from directional_friction import directional
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from paper.ideal_relay import Relay, RelayRun, ideal_relay, settled_cycle
from rig.model.friction import Friction, coulomb, tustin
from rig.model.limit_cycle import NoLimitCycle, limit_cycle
from rig.model.motor import Motor, State

# tau, K, fc, h1, h2 of the table of docs/theory.md 3.4
EXAMPLE = Motor(0.17, 6.5, coulomb(0.5))

Switching = tuple[float, str, np.ndarray]  # when, of what, and the state there


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.08, 0.5), st.floats(1.0, 20.0), st.floats(0.1, 0.5), st.floats(0.3, 1.0), st.floats(0.4, 1.0),
    st.floats(-3.0, 3.0), st.floats(0.3, 3.0), st.floats(-1.0, 1.0),
)  # fmt: skip
def test_from_wherever_it_starts_on_the_grid_it_settles_in_that_cycle(
    tau: float, K: float, fc: float, beyond: float, share: float, v: float, y: float, z: float
) -> None:
    h2 = fc + beyond
    theory = limit_cycle(tau, K, fc, share * h2, h2)
    size = theory.amplitude_rad
    start = State(v * theory.speed_rad_s, y * size, z * -theory.states[2, 2])
    cycle = settled_cycle(Motor(tau, K, coulomb(fc)), share * h2, h2, start)
    assert cycle.is_simple
    assert cycle.durations_s == pytest.approx(theory.durations_s, abs=1e-9)
    assert cycle.y_events_rad[1] == pytest.approx(theory.states[1, 1], abs=1e-9 * (1.0 + size))


def switched_by_an_ode_solver(motor: Motor, h1: float, h2: float, start: State, events: int) -> list[Switching]:
    """The same loop by solve_ivp, friction written out, each crossing found by its events."""
    f, K, tau = motor.friction, motor.K_rad_s_V, motor.tau_s
    x, now, signs = np.array(start, dtype=float), 0.0, np.sign(start)
    found: list[Switching] = []
    while len(found) < events:
        u = motor.bias_V - h1 * signs[1] - h2 * signs[2]

        def slope(t: float, x: np.ndarray, u: float = u, sign: float = signs[0]) -> list[float]:
            fc, fs = (f.plus_V, f.static_plus_V) if sign > 0 else (f.minus_V, f.static_minus_V)
            fade = math.exp(min(-sign * x[0] / f.stribeck_rad_s, 3.0)) if f.stribeck_rad_s else 0.0
            friction = sign * (fc + (fs - fc) * fade) + f.viscous_V_s_rad * x[0]
            return [(K * (u - friction) - x[0]) / tau, x[0], x[1]]

        planes = [Crossing(k, -signs[k]) for k in range(3)]
        run = solve_ivp(slope, (now, now + 10.0), x, events=planes, rtol=1e-12, atol=1e-14, method="DOP853")
        now, x = run.t[-1], run.y[:, -1].copy()
        assert run.t_events is not None
        (k,) = [k for k in range(3) if run.t_events[k].size]
        signs[k], x[k] = -signs[k], 0.0
        found.append((now, ("velocity", "position", "integral")[k], x.copy()))
    return found


@pytest.mark.parametrize(
    ("motor", "start"),
    [
        (EXAMPLE, State(0.5, -0.2, -0.01)),
        (Motor(0.17, 6.5, directional(0.55, 0.45), 0.02), State(-1.0, 0.3, 0.02)),
        (Motor(0.17, 6.5, tustin(0.5, 0.6, 0.2)), State(0.5, -0.2, -0.01)),
        (Motor(0.17, 6.5, tustin(0.4, 0.8, 0.4, 0.04)), State(-1.0, 0.3, 0.02)),
    ],
)
def test_every_switching_is_that_of_an_ode_solver_with_events(motor: Motor, start: State) -> None:
    expected = switched_by_an_ode_solver(motor, 0.8, 1.0, start, 18)
    run = ideal_relay(motor, Relay(0.8, 1.0), start, expected[-1][0] + 0.01)
    assert run.end == "time"
    assert [event.kind for event in run.events[:18]] == [kind for _, kind, _ in expected]
    for event, (t_s, _, x) in zip(run.events, expected, strict=False):
        assert event.t_s == pytest.approx(t_s, abs=1e-9)
        assert np.array(event.state) == pytest.approx(x, abs=1e-9)


@pytest.mark.parametrize("friction", [coulomb(0.5), tustin(0.5, 0.6, 0.2)])
def test_sampled_it_is_the_motor_under_the_drive_that_it_gave(friction: Friction) -> None:
    motor = Motor(0.17, 6.5, friction)
    run = ideal_relay(motor, Relay(0.8, 1.0), State(0.0, -0.2, -0.01), 1.5)
    t_s = np.linspace(0.0, run.duration_s, 301)
    edges = [(step.begin_s, step.u_V) for step in run.steps]
    replay = motor.response(State(0.0, -0.2, -0.01), t_s, [t for t, _ in edges], [u for _, u in edges])
    assert run.states(t_s) == pytest.approx(replay, abs=1e-10)
    u = run.drive_V(t_s)
    assert set(np.round(u, 9)) == {1.8, 0.2, -0.2, -1.8}
    with pytest.raises(ValueError, match="within the run"):
        run.states(np.array([2.0]))


def test_without_enough_integral_gain_there_is_no_cycle_and_it_says_what_happens() -> None:
    """Property 3.1 in motion: h2 <= fc ends at rest on the plane, or held by friction."""
    with pytest.raises(NoLimitCycle, match="switch ever faster"):
        settled_cycle(EXAMPLE, 0.8, 0.45, State(0.0, 0.2, 0.0))
    assert ideal_relay(EXAMPLE, Relay(0.8, 0.45), State(0.0, 0.2, 0.0), 20.0).end == "chatter"
    # h1 + h2 <= fs: from rest it never starts
    stiff = Motor(0.17, 6.5, coulomb(0.5, 1.9))
    with pytest.raises(NoLimitCycle, match="sticks"):
        settled_cycle(stiff, 0.8, 1.0, State(0.0, 0.2, 0.1))
    run = ideal_relay(stiff, Relay(0.8, 1.0), State(0.0, 0.2, 0.1), 5.0)
    assert run.end == "held" and run.events == ()
    assert run.states(np.array([5.0]))[0] == pytest.approx([0.0, 0.2, 1.1])
    with pytest.raises(NoLimitCycle, match="runs away"):
        settled_cycle(Motor(0.17, 6.5, coulomb(0.1), 5.0), 0.8, 1.0, State(0.0, 0.2, 0.1))


@pytest.mark.parametrize("fc", [0.0, 0.2])
def test_where_h1_exceeds_h2_and_friction_it_may_come_to_rest_at_the_centre_and_says_so(fc: float) -> None:
    """Beside the cycle of Theorem 2.1: the integral stands still on y = 0, where RB holds the motor."""
    motor = Motor(1.0, 1.0, coulomb(fc))
    z = 20.0 * abs(limit_cycle(1.0, 1.0, fc, 3.0, 1.0).states[2, 2])
    with pytest.raises(NoLimitCycle, match="comes to rest"):
        settled_cycle(motor, 3.0, 1.0, State(0.0, 0.1, z))


def test_a_motor_that_sticks_waits_for_the_integral_and_then_goes_on() -> None:
    """Static friction between |h1 - h2| and h1 + h2, and a start that stops early: the integral frees it."""
    motor = Motor(0.05, 6.5, coulomb(0.5, 1.6))
    run = ideal_relay(motor, Relay(0.8, 1.0), State(0.5, 0.3, -0.05), 3.0)
    kinds = [event.kind for event in run.events]
    assert kinds[:2] == ["held", "integral"]
    held, freed = run.events[:2]
    assert freed.t_s == pytest.approx(held.t_s - held.state.z / held.state.y, abs=1e-12)
    assert run.states(np.array([freed.t_s + 0.01]))[0, 0] < 0.0


# ------------------------------------------------------------------ Stribeck friction: docs/theory.md 8.1

# Chosen, and not the paper's, whose Stribeck parameters did not survive: with these the cycle has its digits.
# ------------------------------------------------------------------ the single hysteretic relay: docs/theory.md 5.1


def ideal_hysteretic_relay(
    motor: Motor, d_V: float, hysteresis_rad: float, start: State, duration_s: float, sign: float = -1.0
) -> RelayRun:
    """One relay of +-d on the position, with hysteresis; ``sign`` is s_y at the start: the first drive is -sign d."""
    return ideal_relay(motor, Relay(d_V, 0.0, hysteresis_rad), start, duration_s, (sign, 1.0))


def test_before_the_first_switching_runs_of_two_relays_are_in_the_ratio_of_their_excess() -> None:
    """From rest at zero y_i(t) = (d_i - fc) g(t), which is what the least squares of section 6 lives on."""
    t_s = np.linspace(0.0, 0.4, 50)
    runs = [ideal_hysteretic_relay(EXAMPLE, d, eps, State(), 3.0) for eps, d in ((0.5, 0.8), (0.3, 1.0))]
    first = min(run.events[0].t_s for run in runs)
    y1, y2 = (run.states(t_s[t_s < first])[:, 1] for run in runs)
    assert y1.size > 20 and y2[-1] > 0.1
    assert y2 * (0.8 - 0.5) == pytest.approx(y1 * (1.0 - 0.5), abs=1e-14)
    assert runs[0].events[0].state.y == 0.5 and runs[1].events[0].state.y == 0.3


def test_the_hysteretic_relay_oscillates_about_its_band() -> None:
    run = ideal_hysteretic_relay(EXAMPLE, 0.8, 0.5, State(), 8.0)
    switches = [event for event in run.events if event.kind == "position"]
    assert len(switches) >= 8
    for k, event in enumerate(switches):
        assert event.state.y == (0.5 if k % 2 == 0 else -0.5)
        assert event.u_V == (-0.8 if k % 2 == 0 else 0.8)
    assert [event.kind for event in run.events[:4]] == ["position", "velocity", "position", "velocity"]
    mirrored = ideal_hysteretic_relay(EXAMPLE, 0.8, 0.5, State(), 8.0, sign=1.0)
    assert [event.t_s for event in mirrored.events] == pytest.approx([event.t_s for event in run.events])


def test_an_integral_relay_beside_hysteresis_misses_no_crossing() -> None:
    """With hysteresis the position passes zero without a switching, and the integral turns there."""
    run = ideal_relay(EXAMPLE, Relay(0.3, 0.9, 0.2), State(0.0, 0.5, -0.02), 4.0)
    t_s = np.linspace(0.0, run.duration_s, 20_001)
    z = run.states(t_s)[:, 2]
    crossings = int(np.count_nonzero(np.sign(z[1:]) * np.sign(z[:-1]) < 0.0))
    assert crossings == sum(event.kind == "integral" for event in run.events) > 3


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ideal_relay(EXAMPLE, Relay(-0.1, 1.0), State(), 1.0), ">= 0"),
        (lambda: ideal_relay(EXAMPLE, Relay(0.8, 1.0), State(math.nan), 1.0), "finite"),
        (lambda: ideal_relay(EXAMPLE, Relay(0.8, 1.0), State(), 0.0), "duration"),
        (lambda: ideal_relay(EXAMPLE, Relay(0.8, 1.0), State(), 1.0, (0.0, 1.0)), "signs"),
    ],
)
def test_what_is_out_of_range_is_refused(call: Callable[[], RelayRun], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()
