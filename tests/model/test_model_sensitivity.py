"""Motion with derivatives: the motion is the motor's, the derivatives are those of the motion."""

from __future__ import annotations

import numpy as np
import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import Bench, dcr, motor, simulate

from rig.model.motor import State
from rig.model.sensitivity import Theta, position, position_and_jacobian
from rig.run_folder.recording.series import steps_of

STEP = 1e-6


def test_position_is_the_recorded_one() -> None:
    samples = simulate(motor(asym_V=0.03), dcr(0.8, 1.0), 400, Bench(jitter_s=0.002))
    drive = steps_of(samples.t_u_s, samples.u_V)
    v0, y0, _ = samples.true[50]
    y = position(Theta(0.17, 6.5, 0.5, 0.03, 0.0, v0, y0), *drive, samples.t_s[50:])
    assert y == pytest.approx(samples.true[50:, 1], abs=1e-11)


@settings(max_examples=examples(40), deadline=None)
@given(
    st.floats(0.05, 0.6), st.floats(1.0, 10.0), st.floats(0.0, 0.7), st.floats(-0.1, 0.1), st.floats(0.0, 0.015),
    st.floats(0.2, 3.0), st.integers(0, 1000),
)  # fmt: skip
def test_jacobian_is_that_of_finite_differences(
    tau: float, K: float, fc: float, asym: float, delay: float, v0: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    edges = np.cumsum(rng.uniform(0.08, 0.3, 12))
    levels = rng.choice([-1.0, 1.0], 12) * rng.uniform(1.0, 2.0, 12)
    t_s = np.linspace(edges[0] + 0.02, edges[-1], 60)
    theta = Theta(tau, K, fc, asym, delay, v0, 0.1)
    y, jacobian = position_and_jacobian(theta, edges, levels, t_s)
    expected = motor(tau, K, fc, asym).response(State(v0, 0.1), t_s, edges + delay, levels)[:, 1]
    assert y == pytest.approx(expected, abs=1e-10)
    for k in range(7):
        above, below = list(theta), list(theta)
        above[k] += STEP
        below[k] -= STEP
        numeric = (position(Theta(*above), edges, levels, t_s) - position(Theta(*below), edges, levels, t_s)) / (
            2.0 * STEP
        )
        # second derivatives jump at reversals, so that differences are good to their step
        assert jacobian[:, k] == pytest.approx(numeric, abs=2e-4 * (1.0 + np.abs(jacobian[:, k]).max()))


def test_a_motor_held_by_friction_does_not_depend_on_its_parameters() -> None:
    y, jacobian = position_and_jacobian(
        Theta(0.2, 5.0, 0.5, 0.0, 0.0, 0.0, 0.4),
        np.array([0.0, 1.0]),
        np.array([0.3, -0.3]),
        np.linspace(0, 2, 9),
    )
    assert np.all(y == 0.4)
    assert np.all(jacobian[:, :5] == 0.0)
    assert np.all(jacobian[:, 6] == 1.0)
