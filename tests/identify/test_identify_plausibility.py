"""What a recording's columns are compared with: where a reading that stands still is the end of a sensor."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.identify.plausibility import judge_records
from rig.recording.series import TimeSeries

STEP_RAD = 2.0 * np.pi / 3200.0


def to_and_fro(noise_rad: float, end_rad: float = np.inf) -> TimeSeries:
    """A millisecond's rows of a shaft that turns back again and again, read in steps, up to the end of a sensor."""
    t_s: NDArray[np.float64] = np.linspace(0.0, 3.0, 3001)
    noise = noise_rad * np.random.default_rng(1).normal(size=t_s.size)
    y_rad = STEP_RAD * np.round((0.25 * np.sin(12.0 * t_s) + noise) / STEP_RAD)
    return TimeSeries(t_s, np.minimum(y_rad, end_rad), t_s, np.sign(np.sin(12.0 * t_s)))


@pytest.mark.parametrize("noise_rad", [0.0, 0.3 * STEP_RAD, 0.7 * STEP_RAD])
def test_a_turn_within_a_step_is_no_end_of_a_sensor(noise_rad: float) -> None:
    assert judge_records([to_and_fro(noise_rad)]) == []


@pytest.mark.parametrize("noise_rad", [0.7 * STEP_RAD, 2.0 * STEP_RAD])
def test_a_reading_cut_off_in_spite_of_noise_is_one(noise_rad: float) -> None:
    (objection,) = judge_records([to_and_fro(noise_rad, 100 * STEP_RAD)])
    assert "stays at exactly" in objection.reason
