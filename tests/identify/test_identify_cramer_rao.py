"""The Cramer-Rao bound: what an efficient estimator scatters, and no less."""

from __future__ import annotations

import math

import numpy as np
import pytest
from synthetic import LSB_RAD, Bench, dcr, motor, record, simulate

from rig.identification import sampled_data
from rig.identification.cramer_rao import DELAY, PositionNoise, cramer_rao
from rig.identification.starts import Start
from rig.model.sensitivity import Theta, position_and_jacobian
from rig.run_folder.recording.series import Steps, TimeSeries, steps_of

TRUE = Theta(0.17, 6.5, 0.5, 0.02, 0.004, 0.0, 0.0)


def relay_record() -> tuple[TimeSeries, Theta, Steps, np.ndarray]:
    """A clean relay test, its true parameters, its drive, and the times of the samples that a fit uses."""
    samples = simulate(motor(asym_V=TRUE.asym_V), dcr(0.8, 1.0), 520, Bench(delay_s=TRUE.delay_s))
    one = record(samples, t_u_known=False, first=60)
    window = one.predictable(0.02)
    v0, y0, _ = samples.true[window.rows[0]]
    return one, TRUE._replace(v0_rad_per_s=v0, y0_rad=y0), window.steps, window.t_s


def test_it_is_the_inverse_of_the_information() -> None:
    _, theta, drive, t_s = relay_record()
    jacobian = position_and_jacobian(theta, *drive, t_s)[1]
    noise = PositionNoise(0.003, LSB_RAD)
    variance = 0.003**2 + LSB_RAD**2 / 12
    expected = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)) * variance)
    assert cramer_rao(theta, drive, t_s, noise) == pytest.approx(expected, rel=1e-6)


@pytest.mark.evidence
def test_estimates_scatter_as_much_as_the_bound_says() -> None:
    one, theta, drive, t_s = relay_record()
    bound = cramer_rao(theta, drive, t_s, PositionNoise(0.003))
    rng = np.random.default_rng(4)
    start = [Start(theta.tau_s, theta.K_rad_s_V, theta.fc_V)]
    ratios = []
    for _ in range(80):
        noisy = TimeSeries(one.t_s, one.y_rad + 0.003 * rng.standard_normal(one.t_s.size), None, one.u_V)
        found = sampled_data.fit([noisy], start)
        estimate = np.array([found.tau_s, found.K_rad_s_V, found.fc_V, found.asym_V, found.delay_s])
        ratios.append((estimate - theta[:5]) / bound[:5])
    scatter = np.std(ratios, axis=0)
    assert np.all((scatter > 0.75) & (scatter < 1.3)), scatter  # 1 +- 0.08 by chance


def test_a_known_delay_makes_the_others_no_worse_and_is_not_estimated() -> None:
    _, theta, drive, t_s = relay_record()
    noise = PositionNoise(0.003)
    unknown, known = cramer_rao(theta, drive, t_s, noise), cramer_rao(theta, drive, t_s, noise, delay_known=True)
    others = [k for k in range(7) if k != DELAY]
    assert known[DELAY] == 0.0
    assert np.all(known[others] <= unknown[others] * (1 + 1e-9))
    assert known[0] < 0.9 * unknown[0]  # delay and tau are confounded


def test_whitening_is_that_of_the_dense_covariance() -> None:
    n, noise = 60, PositionNoise(0.003, 0.002, 0.004, 0.9)
    lags = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    covariance = 0.004**2 * 0.9**lags + (0.003**2 + 0.002**2 / 12) * np.eye(n)
    columns = np.random.default_rng(1).standard_normal((n, 3))
    expected = columns.T @ np.linalg.solve(covariance, columns)
    white = noise.whitened(columns)
    assert white.T @ white == pytest.approx(expected, rel=1e-9)


def test_correlated_noise_of_no_memory_is_white_noise() -> None:
    _, theta, drive, t_s = relay_record()
    both = cramer_rao(theta, drive, t_s, PositionNoise(0.003, 0.0, 0.004, 0.0))
    assert both == pytest.approx(cramer_rao(theta, drive, t_s, PositionNoise(0.005)), rel=1e-9)


def test_what_the_experiment_does_not_tell_has_no_bound() -> None:
    """Under one drive in one direction only K (u + a - fc) shows, and no delay."""
    t_s = np.arange(200, dtype=float) * 0.01
    drive = steps_of(np.array([-1.0]), np.array([1.5]))
    bound = cramer_rao(TRUE, drive, t_s, PositionNoise(0.003))
    assert [name for name, b in zip(Theta._fields, bound, strict=True) if math.isinf(b)] == [
        "K_rad_s_V", "fc_V", "asym_V", "delay_s",
    ]  # fmt: skip
    assert np.all(bound[[0, 5, 6]] > 0.0)


@pytest.mark.parametrize("values", [(-0.001,), (0.003, -0.1), (0.003, 0.0, 0.001, 1.0), (0.0, 0.0, 0.01, 0.5)])
def test_senseless_noise_is_refused(values: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"must be|no bound"):
        PositionNoise(*values)
