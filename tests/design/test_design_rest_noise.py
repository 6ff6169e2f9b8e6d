"""The noise at rest, known better with each pause; a pause in which the shaft still moves teaches nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rig.design.stop_rule import RestNoise

RNG = np.random.default_rng(7)


def test_pauses_pull_a_wrong_noise_to_the_right_one_and_say_how_well_it_is_known() -> None:
    noise = RestNoise(0.0025, 0.06)
    for _ in range(20):
        assert noise.take(0.3 + 0.003 * RNG.standard_normal(200))
    assert noise.std_rad == pytest.approx(0.003, rel=0.04)
    assert noise.error == pytest.approx(1.0 / math.sqrt(2.0 * (0.5 / 0.06**2 + 20 * 118)))


@pytest.mark.parametrize(
    "moves_rad",
    [0.1 * np.exp(-0.02 * np.arange(200.0)), 1e-4 * np.arange(200.0), 0.007 * np.sin(0.1 * np.arange(200.0))],
)
def test_a_shaft_that_still_moves_teaches_nothing(moves_rad: np.ndarray) -> None:
    noise = RestNoise(0.003, 0.06)
    assert not noise.take(moves_rad + 0.003 * RNG.standard_normal(200))
    assert (noise.std_rad, noise.error) == (0.003, 0.06)


@pytest.mark.parametrize("share", [0.6, 0.9, -0.6])
def test_noise_whose_readings_depend_on_each_other_teaches_nothing(share: float) -> None:
    """As of a filter in the sensor: a pause shows too little of it, and the residual would seem too large for ever."""
    white, coloured = RNG.standard_normal(200), [0.0]
    for one in white:
        coloured.append(share * coloured[-1] + math.sqrt(1.0 - share**2) * float(one))
    noise = RestNoise(0.003, 0.06)
    assert not noise.take(0.3 + 0.003 * np.array(coloured[1:]))
    assert (noise.std_rad, noise.error) == (0.003, 0.06)
    assert noise.take(0.3 + 0.003 * white)


def test_a_known_noise_and_a_short_pause_change_nothing() -> None:
    assert not RestNoise(0.003, 0.0).take(0.003 * RNG.standard_normal(200))
    assert not RestNoise(0.003, 0.06).take(0.003 * RNG.standard_normal(30))
