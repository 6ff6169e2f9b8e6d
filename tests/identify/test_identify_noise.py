"""The noise model: it finds what wanders, its filter whitens, and intervals grow by what repeats."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import cholesky, solve_triangular

from rig.identification.noise import WHITE, Noise, noise_of
from rig.identification.repetition import repeated_share, repetitions, with_repetition
from rig.run_folder.recording.series import TimeSeries, Window

PERIOD_S = 0.01


def wandering(rng: np.random.Generator, t_s: np.ndarray, memory_s: float, size: float) -> np.ndarray:
    """White noise of 1 and an Ornstein-Uhlenbeck process of standard deviation ``size``."""
    state = size * rng.standard_normal()
    out = np.empty(t_s.size)
    for k in range(t_s.size):
        if k:
            keep = math.exp(-(t_s[k] - t_s[k - 1]) / memory_s)
            state = keep * state + size * math.sqrt(1.0 - keep * keep) * rng.standard_normal()
        out[k] = state + rng.standard_normal()
    return out


def test_the_filter_is_the_inverse_root_of_the_covariance() -> None:
    """Against a Cholesky factor of the covariance matrix, on unevenly spaced samples and two pieces."""
    rng = np.random.default_rng(3)
    t_s = np.concatenate((np.cumsum(rng.uniform(0.005, 0.02, 40)), 5.0 + np.cumsum(rng.uniform(0.005, 0.02, 25))))
    noise = Noise(0.08, 5.0)
    columns = rng.standard_normal((65, 3))
    apart = np.abs(t_s[:, None] - t_s[None, :])
    together = np.kron(np.eye(2), np.ones((40, 40)))[:65, :65]
    covariance = np.eye(65) + 5.0 * np.exp(-apart / 0.08) * together
    expected = solve_triangular(cholesky(covariance, lower=True), columns, lower=True)
    assert noise.whiten(columns, t_s, [40, 25]) == pytest.approx(expected, abs=1e-12)
    assert noise.whiten(columns[:, 0], t_s, [40, 25]) == pytest.approx(expected[:, 0], abs=1e-12)


@pytest.mark.parametrize(("memory_s", "size"), [(0.05, 2.0), (0.3, 1.0), (20.0, 5.0)])
def test_what_wanders_is_found_and_whitened(memory_s: float, size: float) -> None:
    rng = np.random.default_rng(8)
    t_s = np.arange(2000, dtype=float) * PERIOD_S
    one = wandering(rng, t_s, memory_s, size)
    noise = noise_of(0.003 * one, t_s, [2000])
    # what counts over short times is the rate at which it wanders
    assert noise.ratio / noise.memory_s == pytest.approx(size * size / memory_s, rel=0.6)
    white = noise.whiten(one, t_s, [2000])
    lags = [float(white[lag:] @ white[:-lag]) / float(white @ white) for lag in (1, 2, 5, 20)]
    assert np.abs(lags).max() < 4.0 / math.sqrt(2000)
    assert abs(float(one[1:] @ one[:-1]) / float(one @ one)) > 0.3


def test_white_noise_is_rarely_taken_for_more() -> None:
    rng = np.random.default_rng(7)
    t_s = np.arange(500, dtype=float) * PERIOD_S
    assert sum(not noise_of(rng.standard_normal(500), t_s, [250, 250]).white for _ in range(200)) <= 6
    assert noise_of(np.zeros(500), t_s, [500]) == WHITE


def test_intervals_of_a_mean_hold_whatever_the_noise() -> None:
    """Generalised least squares for a mean: its scatter is what the whitened columns say."""
    rng = np.random.default_rng(12)
    t_s = np.arange(600, dtype=float) * PERIOD_S
    ones = np.ones((600, 1))
    scores = []
    for _ in range(150):
        y = wandering(rng, t_s, 0.1, 2.0)
        noise = noise_of(y - y.mean(), t_s, [600])
        column, value = noise.whiten(ones, t_s, [600])[:, 0], noise.whiten(y, t_s, [600])
        mean = float(column @ value) / float(column @ column)
        left = value - mean * column
        scores.append(mean / math.sqrt(float(left @ left) / 599 / float(column @ column)))
    assert 0.8 < float(np.std(scores)) < 1.25
    assert 0.9 < float(np.mean(np.abs(scores) < 1.96)) <= 0.99


def window_of(rows: int) -> Window:
    t_s = np.arange(rows, dtype=float) * PERIOD_S
    return Window(TimeSeries(t_s, np.zeros(rows), t_s, np.where(t_s < 1.0, 1.0, -1.0)), 0, rows)


def test_what_repeats_in_each_cycle_is_seen_and_does_not_average_out() -> None:
    rng = np.random.default_rng(4)
    pairs = repetitions([window_of(1000)], [1.0])
    assert [first.size for first, _ in pairs] == [900, 800, 700, 600, 500, 400, 300, 200, 100]
    assert all(np.all(later - first == 100 * (k + 1)) for k, (first, later) in enumerate(pairs))
    pattern = np.tile(rng.standard_normal(100), 10)
    assert repeated_share(pattern, pairs) == pytest.approx(1.0, abs=1e-9)
    assert repeated_share(rng.standard_normal(1000), pairs) < 0.05
    mixed = repeated_share(pattern + rng.standard_normal(1000), pairs)
    assert mixed == pytest.approx(float(pattern @ pattern) / (float(pattern @ pattern) + 1000.0), abs=0.08)
    assert repetitions([window_of(1000)], [None]) == []
    # a column that repeats itself, with an error that does: ten cycles tell as much as one
    column = np.tile(rng.standard_normal(100), 10)[:, None]
    covariance = np.array([[1.0 / float(column[:, 0] @ column[:, 0])]])
    grown = with_repetition(covariance, column, pairs, 1.0)
    assert grown[0, 0] == pytest.approx(10.0 * covariance[0, 0])
    assert with_repetition(covariance, column, pairs, 0.0)[0, 0] == covariance[0, 0]
