"""The compiled relay test against the law of the loop on the motor of the model, tick by tick."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.control.relay import DualChannelRelay
from rig.core.signals import Sample
from rig.model.friction import Friction, coulomb, tustin
from rig.model.motor import Motor, State
from rig.model.sampled_relay import Disturbance, relay_test


def by_hand(
    motor: Motor,
    h1_V: float,
    h2_V: float,
    t_s: np.ndarray,
    t_u_s: np.ndarray,
    noise_rad: np.ndarray,
    torque_V: np.ndarray,
    lsb_rad: float,
    start: State,
) -> np.ndarray:
    """The same with the classes that the real loop and the simulated driver use."""
    relay, state, acting, applied = DualChannelRelay(h1_V, h2_V, 1e9), start, 0.0, 0
    drives: list[float] = []
    rows = []
    for k, t in enumerate(t_s):
        read = state.y + noise_rad[k]
        if lsb_rad:
            read = np.floor(read / lsb_rad + 0.5) * lsb_rad
        drives.append(relay.step(Sample(float(t), float(read), 0)))
        rows.append((read, drives[-1], relay.z_rad_s, state.v, state.y))
        if k + 1 == len(t_s):
            break
        now = t
        while applied <= k and t_u_s[applied] < t_s[k + 1]:
            at = max(t_u_s[applied], now)
            state = motor.advance(state, acting + torque_V[k], at - now)
            acting, now, applied = drives[applied], at, applied + 1
        state = motor.advance(state, acting + torque_V[k], t_s[k + 1] - now)
    return np.array(rows)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    latency_periods=st.floats(0.0, 1.9),
    lsb_rad=st.sampled_from([0.0, 4.2 / 1024]),
    static=st.floats(1.0, 1.5),
)
def test_it_is_the_loops_own_law_on_the_models_own_motor(
    seed: int, latency_periods: float, lsb_rad: float, static: float
) -> None:
    rng = np.random.default_rng(seed)
    plus, minus = rng.uniform(0.1, 0.5, 2)
    motor = Motor(rng.uniform(0.08, 0.5), rng.uniform(2, 8), Friction(plus, minus, plus * static, minus * static), 0.02)
    t = np.cumsum(rng.uniform(0.008, 0.012, 400))
    latency = 0.01 * latency_periods + rng.uniform(0.0, 0.001, t.size)
    noise, torque = 0.003 * rng.standard_normal(t.size), 0.05 * rng.standard_normal(t.size)
    start = State(y=rng.uniform(-0.5, 0.5))
    test = relay_test(motor, 0.8, 1.0, t, latency, disturbance=Disturbance(noise, torque, lsb_rad), start=start)
    expected = by_hand(motor, 0.8, 1.0, t, test.t_u_s, noise, torque, lsb_rad, start)
    found = np.column_stack([test.y_rad, test.u_V, test.z_rad_s, test.true_v_rad_s, test.true_y_rad])
    assert np.array_equal(found[:, 1], expected[:, 1])
    assert np.allclose(found, expected, rtol=0.0, atol=1e-10)


def test_what_cannot_be_is_refused() -> None:
    motor, t = Motor(0.2, 5.0), np.arange(10, dtype=float) * 0.01
    with pytest.raises(ValueError, match="increase"):
        relay_test(motor, 0.8, 1.0, t[::-1], 0.001)
    with pytest.raises(ValueError, match="latencies"):
        relay_test(motor, 0.8, 1.0, t, -0.001)
    with pytest.raises(ValueError, match="order"):
        relay_test(motor, 0.8, 1.0, t, np.where(np.arange(10) == 3, 0.03, 0.0))
    with pytest.raises(ValueError, match="Stribeck"):
        relay_test(Motor(0.2, 5.0, tustin(0.4, 0.5, 0.1)), 0.8, 1.0, t, 0.001)


def test_viscous_friction_shows_as_a_smaller_tau_and_gain() -> None:
    t = np.arange(200, dtype=float) * 0.01
    tests = [
        relay_test(motor, 0.8, 1.0, t, 0.001, start=State(y=-0.2))
        for motor in (Motor(0.2, 5.0, tustin(0.4, 0.4, 0.0, 0.1)), Motor(0.2 / 1.5, 5.0 / 1.5, coulomb(0.4)))
    ]
    assert np.allclose(tests[0].true_y_rad, tests[1].true_y_rad, rtol=0.0, atol=1e-12)
    assert np.ptp(tests[0].true_y_rad) > 0.1
