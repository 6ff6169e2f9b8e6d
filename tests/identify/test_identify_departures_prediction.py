"""Whether a law predicts what was not fitted: held to the densities of a normal distribution, and to random motors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from rig.identification.departures import DEPARTURES
from rig.identification.departures.fit import Rows, sums_of_pieces
from rig.identification.departures.prediction import Evidence

BACKLASH = next(law for law in DEPARTURES if law.name == "backlash")
FREE = ("tau_s", "K_rad_s_V", "backlash_rad")
SPREAD = np.array([1.0, 2.0, 0.5])  # standard deviations before the rows are seen


def rows_and_evidence(seed: int) -> tuple[list[np.ndarray], list[np.ndarray], Evidence]:
    """Rows y and derivatives J of six pieces, their starts taken out, and the evidence at some other numbers."""
    rng = np.random.default_rng(seed)
    truth, here = np.array([0.3, 1.0, 0.4]), np.array([0.35, 0.9, 0.37])
    begins, size = np.arange(0, 60, 10), 10
    jacobian, by_start = rng.normal(size=(60, 3)), rng.normal(size=(60, 2))
    starts = np.repeat(rng.normal(size=(6, 2)), size, axis=0)
    y = jacobian @ truth + np.sum(by_start * starts, axis=1) + rng.normal(size=60)
    residual = jacobian @ here - y
    matrix, gradient = sums_of_pieces(Rows(residual, residual, jacobian, by_start), begins)
    evidence = Evidence(FREE, here, matrix, gradient, np.array([-here[0], -here[1], -here[2]]), SPREAD**-2.0)
    seen, columns = [], []
    for at in begins:
        piece = slice(at, at + size)
        free_of_start = np.linalg.svd(by_start[piece])[0][:, 2:]
        seen.append(free_of_start.T @ y[piece])
        columns.append(free_of_start.T @ jacobian[piece])
    return seen, columns, evidence


def log_density(y: list[np.ndarray], jacobian: list[np.ndarray], numbers: list[int]) -> float:
    """Of rows with noise 1, and numbers that are normal around 0."""
    design = np.concatenate(jacobian)[:, numbers] * SPREAD[numbers]
    rows = np.concatenate(y)
    return float(multivariate_normal(np.zeros(rows.size), np.eye(rows.size) + design @ design.T).logpdf(rows))


@pytest.mark.parametrize("seed", range(3))
def test_rise_is_that_of_the_predictive_densities(seed: int) -> None:
    y, jacobian, evidence = rows_and_evidence(seed)
    shares = [np.array([0, 3]), np.array([1, 4, 5]), np.array([2])]
    expected = 0.0
    for share in shares:
        others = [k for k in range(6) if k not in share]
        for numbers, sign in (([0, 1, 2], 2.0), ([0, 1], -2.0)):
            whole = log_density(y, jacobian, numbers)
            expected += sign * (whole - log_density([y[k] for k in others], [jacobian[k] for k in others], numbers))
    assert evidence.rise(BACKLASH, shares) == pytest.approx(expected, rel=1e-9)
