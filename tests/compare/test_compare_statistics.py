"""Weighted means, the odd one, the scatter between runs and trends, on numbers whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from rig.output.compare.statistics import agreement, between_runs, holm, odd_ones, off_the_others, slope

Array = NDArray[np.float64]
SHAPE = np.array([[1.0, 0.6, 0.3], [0.6, 1.0, -0.2], [0.3, -0.2, 1.0]])


def blocks(*covariances: Array) -> Array:
    n = len(covariances)
    whole = np.zeros((3 * n, 3 * n))
    for k, one in enumerate(covariances):
        whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = one
    return whole


def test_two_runs_differ_as_their_difference_says_and_what_they_share_cancels() -> None:
    values = np.array([[0.0, 0.0, 0.0], [1.0, -2.0, 2.0]])
    covariance = blocks(SHAPE, 2.0 * SHAPE)
    by = values[1] - values[0]
    square = float(by @ np.linalg.solve(3.0 * SHAPE, by))
    for shared in (0.0, 100.0):  # a supply that both have
        found = agreement(values, covariance + shared * np.kron(np.ones((2, 2)), np.eye(3)))
        assert found.chance == pytest.approx(chi2.sf(square, 3), rel=1e-6)
        assert found.off[1] == pytest.approx(by)
        assert found.error[1] == pytest.approx(np.sqrt(3.0 * np.diag(SHAPE)))


def test_runs_with_the_same_numbers_agree_whatever_rounding_makes_of_their_squares() -> None:
    random = np.random.default_rng(3)
    for _ in range(300):
        values = np.tile(random.normal(size=3) * 10.0 ** random.uniform(-3.0, 3.0), (2, 1))
        shape = SHAPE * np.outer(size := 10.0 ** random.uniform(-4.0, 0.0, 3), size)
        found = agreement(values, blocks(shape, shape))
        assert found.chance == pytest.approx(1.0, abs=1e-3)
        assert found.alone == pytest.approx(1.0, abs=1e-3)


def test_false_alarms_are_as_rare_as_asked_for() -> None:
    random = np.random.default_rng(1)
    root, times = np.linalg.cholesky(SHAPE), 1000
    differ = odd = 0
    for _ in range(times):
        size = random.uniform(0.5, 2.0, 4)
        values = np.array([s * root @ random.normal(size=3) for s in size])
        covariance = blocks(*(s**2 * SHAPE for s in size))
        differ += agreement(values, covariance).chance < 0.05
        odd += bool(odd_ones(values, covariance, 0.05))
    assert 0.036 < differ / times < 0.064  # 5 % and two standard errors
    assert odd / times < 0.05


def test_the_odd_ones_are_named_however_far_off_they_are() -> None:
    values, covariance = np.zeros((5, 3)), blocks(*[SHAPE] * 5)
    values[1] = 1e4  # the chances of all of them underflow
    assert odd_ones(values, covariance, 0.05) == [1]
    values[3] = -50.0
    assert sorted(odd_ones(values, covariance, 0.05) or ()) == [1, 3]
    values[4] = 700.0
    assert odd_ones(values, covariance, 0.05) is None  # two that agree are no majority of five
    assert odd_ones(values[:2], covariance[:6, :6], 0.05) is None  # of two nobody can tell


def test_the_variance_between_runs_is_what_their_own_leaves_over() -> None:
    values, ones = np.array([-3.0, -1.0, 1.0, 3.0]), np.ones((4, 1))
    assert between_runs(ones, values, np.full(4, 2.0)) == pytest.approx(np.var(values, ddof=1) - 2.0)
    assert between_runs(ones, values, np.full(4, 9.0)) == 0.0
    assert between_runs(ones, values, np.full(4, 1e-9)) == pytest.approx(np.var(values, ddof=1))


def test_a_run_beyond_the_scatter_of_the_others_is_seen_and_false_alarms_are_rare() -> None:
    random, times = np.random.default_rng(2), 120
    false = seen = 0
    for _ in range(times):
        values = 2.0 * random.normal(size=6) + random.normal(size=6)
        false += min(holm([off_the_others(values, np.ones(6), k, None).chance for k in range(6)])) < 0.05
        values[3] += 30.0
        seen += off_the_others(values, np.ones(6), 3, None).chance < 0.05 / 6
    assert false / times < 0.09  # 5 % and two standard errors
    assert seen / times > 0.95
    known = off_the_others(np.array([0.0, 3.0]), np.array([1.0, 1.0]), 1, 7.0)
    assert (known.by, known.error) == (3.0, 4.0)  # 1 + 1 of the noise, 2 x 7 of the scatter
    assert known.half == pytest.approx(1.96 * 4.0, rel=1e-3)


def test_the_interval_of_a_trend_holds_the_slope() -> None:
    random, times = np.random.default_rng(3), 400
    x = np.array([0.0, 1.0, 2.0, 5.0, 9.0])
    held = 0
    for _ in range(times):
        found = slope(x, 0.7 * x + 2.0 * random.normal(size=5), np.full(5, 0.01))
        held += abs(found.slope - 0.7) < found.half
    assert 0.92 < held / times < 0.98
    exact = slope(x, 0.7 * x, np.full(5, 1e-6))
    assert exact.slope == pytest.approx(0.7)
    assert exact.chance < 1e-3


def test_many_looks_are_corrected() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert math.isclose(holm([0.02])[0], 0.02)
