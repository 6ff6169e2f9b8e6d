"""Homing on simulated motors: brings the shaft to rest at zero, or says that it could not."""

from __future__ import annotations

import pytest
from directional_friction import directional
from simulated_bench import CALIBRATION, DEMO, LIMITS, PERIOD_S, SimulatedBench, break_away, simulated_bench

from rig.control.homing import Homing
from rig.faults import Fault
from rig.model.friction import coulomb
from rig.model.motor import Motor

LSB_RAD = CALIBRATION.lsb_rad
OFFSET_RAD = 0.02

MOTORS = {
    "demo": DEMO.motor,
    "quick": Motor(0.09, 6.0, coulomb(0.4, 0.44)),
    "slow": Motor(0.35, 4.0, coulomb(0.35)),
    "stiff": Motor(0.15, 5.0, coulomb(0.7, 0.9)),
    "slipping": Motor(0.1, 9.0, coulomb(0.4, 0.9)),
    "one-sided": Motor(0.17, 6.5, directional(0.55, 0.40), 0.03),
    "slick": Motor(0.3, 8.0, coulomb(0.1)),
}


def home(bench: SimulatedBench, tolerance_rad: float, timeout_s: float = 40.0) -> Homing:
    with bench.loop.armed(LIMITS):
        check = break_away(bench.loop)
        homing = Homing(check.plus_V, check.minus_V, 3.0, check.noise_rad, tolerance_rad, PERIOD_S, timeout_s)
        bench.loop.run(homing, "homing")
    return homing


@pytest.mark.parametrize("start_rad", [0.0, 0.9, -0.5, 0.03])
@pytest.mark.parametrize("noise_rad", [0.0, 0.003])
@pytest.mark.parametrize("name", MOTORS)
def test_it_comes_to_rest_at_zero(name: str, start_rad: float, noise_rad: float) -> None:
    bench = simulated_bench(motor=MOTORS[name], start_rad=start_rad, noise_rad=noise_rad, offset_rad=OFFSET_RAD)
    homing = home(bench, 0.6 * LSB_RAD)
    assert abs(homing.rest_rad) <= 0.6 * LSB_RAD
    shaft = bench.driver.bench.state
    # the zero that counts is the sensor's; a mean of 20 readings and half a step of the sensor is what it can know
    assert abs(shaft.y + OFFSET_RAD) < 0.6 * LSB_RAD + 0.5 * LSB_RAD + 3.5 * noise_rad / 20**0.5
    assert shaft.v == 0.0
    rows = [row for row in bench.record.rows if row["stage"] == "homing"]
    assert max(abs(row["y_rad"]) for row in rows) < abs(rows[0]["y_rad"]) + 0.05  # never swings out
    assert homing.strokes <= 15


def test_a_shaft_that_stands_at_zero_is_left_alone() -> None:
    bench = simulated_bench(noise_rad=0.0, offset_rad=0.0)
    homing = Homing(0.54, 0.5, 3.0, 0.0, 0.6 * LSB_RAD, PERIOD_S, 5.0)
    with bench.loop.armed(LIMITS):
        bench.loop.run(homing, "homing")
    assert homing.strokes == 0
    assert all(row["asked_V"] == 0.0 for row in bench.record.rows)


def test_a_level_that_turns_out_too_low_is_raised() -> None:
    bench = simulated_bench(start_rad=0.3, offset_rad=0.0)
    bench.guard.sign_proven = True
    homing = Homing(0.30, 0.28, 3.0, 0.003, 0.6 * LSB_RAD, PERIOD_S, 40.0)  # 0.54 and 0.50 V would be true
    with bench.loop.armed(LIMITS):
        bench.loop.run(homing, "homing")
    assert abs(homing.rest_rad) <= 0.6 * LSB_RAD


def test_it_gives_up_with_its_numbers_where_the_time_is_over() -> None:
    bench = simulated_bench(start_rad=0.6)
    with pytest.raises(Fault) as caught:
        home(bench, 0.6 * LSB_RAD, timeout_s=1.0)
    assert caught.value.code == "NOT_HOME"
    assert "strokes in 1 s" in caught.value.detail
    assert bench.driver.bench.pin_counts == 0


@pytest.mark.parametrize(("plus_V", "tolerance_rad"), [(0.0, 0.002), (0.5, 0.0)])
def test_senseless_settings_are_refused(plus_V: float, tolerance_rad: float) -> None:
    with pytest.raises(ValueError, match="homing needs"):
        Homing(plus_V, 0.5, 3.0, 0.003, tolerance_rad, PERIOD_S, 5.0)
