"""Static friction from breakaway ramps, and what can and cannot be told from it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from synthetic import LSB_RAD, Bench, record, simulate

from rig.identification.breakaway import Ramp, breakaway, split
from rig.identification.estimate import Estimate
from rig.model.friction import Friction
from rig.model.motor import Motor
from rig.run_folder.recording.series import TimeSeries

NOISE = 0.003


class Ramps:
    """Ramp up until it moves, rest, ramp down until it moves, rest; in strokes or continuous."""

    def __init__(self, stroke_s: float, limit_V: float = 1.5) -> None:
        self.stroke_s, self.limit_V = stroke_s, limit_V
        self.sign, self.since, self.origin = 0.0, 0.0, 0.0
        self.todo = [1.0, -1.0]

    def __call__(self, t_s: float, y_rad: float, z_rad_s: float) -> float:
        if self.sign == 0.0:
            if t_s - self.since > 0.5 and self.todo:
                self.sign, self.since, self.origin = self.todo.pop(0), t_s, y_rad
            return 0.0
        level = 0.4 * (t_s - self.since)
        if abs(y_rad - self.origin) > 0.03 or level > self.limit_V:
            self.sign, self.since = 0.0, t_s
            return 0.0
        on = not self.stroke_s or (t_s - self.since) % (2.0 * self.stroke_s) < self.stroke_s
        return self.sign * level if on else 0.0


def plant(
    fs_plus: float = 0.54, fs_minus: float = 0.50, plus: float = 0.50, minus: float = 0.46, bias: float = 0.01
) -> Motor:
    return Motor(0.17, 6.5, Friction(plus, minus, fs_plus, fs_minus), bias)


def estimate_of(motor: Motor, error_V: float = 0.0005) -> Estimate:
    covariance = np.diag([1e-6, 1e-4, error_V**2, error_V**2, 0.0])
    return Estimate(
        "sampled-data", motor.tau_s, motor.K_rad_s_V, motor.friction.fc_V, motor.asym_V, 0.004, covariance=covariance
    )


def ramped(motor: Motor, stroke_s: float, seed: int = 1, limit_V: float = 1.5, **bench: Any) -> TimeSeries:
    bench = {"noise_rad": NOISE, "lsb_rad": LSB_RAD} | bench
    return record(simulate(motor, Ramps(stroke_s, limit_V), 600, Bench(seed=seed, **bench)))


@pytest.mark.parametrize("stroke_s", [0.0, 0.04])
def test_without_noise_the_drive_at_break_away_is_found_between_two_ticks_of_the_ramp(stroke_s: float) -> None:
    motor = plant()
    found = breakaway(ramped(motor, stroke_s, noise_rad=0.0, lsb_rad=0.0), estimate_of(motor), 1e-9)
    assert found.plus is not None
    assert found.minus is not None
    for ramp, true in ((found.plus, 0.53), (found.minus, 0.51)):
        assert ramp.low_V <= true <= ramp.high_V
        assert ramp.high_V - ramp.low_V < (0.005 if not stroke_s else 0.04)


@pytest.mark.parametrize("seed", range(4))
def test_with_noise_the_interval_holds_it(seed: int) -> None:
    motor = plant()
    found = breakaway(ramped(motor, 0.04, seed), estimate_of(motor), NOISE)
    assert found.plus is not None
    assert found.minus is not None
    assert found.plus.static_V == pytest.approx(0.53, abs=0.03)
    assert found.minus.static_V == pytest.approx(0.51, abs=0.03)
    for ramp, true in ((found.plus, 0.53), (found.minus, 0.51)):
        assert ramp.low_V <= ramp.static_V <= ramp.high_V
        assert ramp.low_V - 0.01 <= true <= ramp.high_V + 0.01
    assert found.level_V is not None
    level_V, error_V = found.level_V
    assert abs(level_V - 0.52) < 2.0 * error_V < 0.08


def test_equal_static_and_moving_friction_never_separate_bias_from_direction() -> None:
    for motor in (
        plant(0.5, 0.46),
        plant(0.48, 0.48, 0.48, 0.48, -0.01),
    ):  # the same asymmetry, made of different things
        found = breakaway(ramped(motor, 0.0), estimate_of(motor), NOISE)
        assert found.friction_V is None
        assert "cannot be told apart" in found.reason or "too little" in found.reason


def test_clearly_larger_static_friction_separates_them_under_one_ratio() -> None:
    motor = plant(0.50 * 1.6, 0.42 * 1.6, 0.50, 0.42, 0.03)
    found = breakaway(ramped(motor, 0.0, noise_rad=0.0005, lsb_rad=0.0), estimate_of(motor), 0.0005)
    assert found.friction_V == pytest.approx((0.50, 0.42, 0.03), abs=0.03)
    assert "one ratio" in found.reason
    slight = split(Ramp(0.53, 0.52, 0.54), Ramp(0.51, 0.50, 0.52), estimate_of(plant(), 0.002))
    assert slight[0] is None


def test_a_ramp_without_motion_tells_nothing_and_says_so() -> None:
    motor = plant()
    found = breakaway(ramped(motor, 0.0, limit_V=0.45), estimate_of(motor), NOISE)
    assert found.plus is None and found.level_V is None
    assert found.as_result().static_plus_V is None
    assert "ramp higher" in found.reason
