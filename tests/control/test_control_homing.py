"""Homing on simulated motors: brings the shaft to rest at zero, or says that it could not."""

from __future__ import annotations

import pytest
from directional_friction import directional
from evidence import evidence
from simulated_bench import CALIBRATION, DEMO, LIMITS, PERIOD_S, BenchModel, break_away, simulated_bench

from rig.control.breakaway import BreakawayFound
from rig.control.homing import Homing
from rig.core.faults import Fault
from rig.core.signals import Sample
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


def home(bench: BenchModel, tolerance_rad: float, timeout_s: float = 40.0) -> Homing:
    with bench.loop.armed(LIMITS):
        check = break_away(bench.loop)
        homing = Homing(
            BreakawayFound(check.plus_V, check.minus_V, check.noise_rad), 3.0, tolerance_rad, PERIOD_S, timeout_s
        )
        bench.loop.run(homing, "homing")
    return homing


@pytest.mark.parametrize("start_rad", [0.0, 0.9, *evidence(-0.5, 0.03)])
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
    homing = Homing(BreakawayFound(0.54, 0.5, 0.0), 3.0, 0.6 * LSB_RAD, PERIOD_S, 5.0)
    with bench.loop.armed(LIMITS):
        bench.loop.run(homing, "homing")
    assert homing.strokes == 0
    assert all(row["asked_V"] == 0.0 for row in bench.record.rows)


def test_a_level_that_turns_out_too_low_is_raised() -> None:
    bench = simulated_bench(start_rad=0.3, offset_rad=0.0)
    bench.guard.sign_proven = True
    homing = Homing(
        BreakawayFound(0.30, 0.28, 0.003), 3.0, 0.6 * LSB_RAD, PERIOD_S, 40.0
    )  # 0.54 and 0.50 V would be true
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


def stroke(homing: Homing, stands_rad: float) -> tuple[int, float]:
    """Have it look at a shaft that stands there, and give its stroke: how many ticks, and at what drive, V."""
    at = [homing.step(Sample(0.0, stands_rad, 512))]
    while at[-1] == 0.0:
        at.append(homing.step(Sample(0.0, stands_rad, 512)))
        assert len(at) < 40
    drive_V, ticks = at[-1], 0
    while at[-1] == drive_V:
        ticks += 1
        at.append(homing.step(Sample(0.0, stands_rad, 512)))
    assert at[-1] == 0.0
    return ticks, drive_V


def a_homing() -> Homing:
    return Homing(BreakawayFound(0.5, 0.4, 0.0), 3.0, 0.004, PERIOD_S, 40.0)


@pytest.mark.parametrize(("stands_rad", "ticks", "drive_V"), [(-0.3, 12, 0.575), (0.05, 3, -0.46), (-0.05, 3, 0.575)])
def test_the_first_stroke_is_short_and_inward_and_longer_from_afar(
    stands_rad: float, ticks: int, drive_V: float
) -> None:
    assert stroke(a_homing(), stands_rad) == pytest.approx((ticks, drive_V))


def test_a_stroke_tells_how_long_the_next_one_should_be() -> None:
    """The way grows with the square of the time: 12 ticks moved it by 0.144 rad, so one moves it by 1 mrad."""
    homing = a_homing()
    assert stroke(homing, 0.25)[0] == 12
    ticks, _ = stroke(homing, 0.25 - 0.144)
    assert ticks == 10  # the root of 106
    # these 10 ticks moved it by 0.156 rad; what one way has shown serves the other, until that has shown its own
    assert stroke(homing, -0.05) == pytest.approx((5, 0.575))  # the root of 50 over 1.56


def test_a_long_stroke_that_moves_nothing_makes_the_next_stronger() -> None:
    homing = a_homing()
    assert stroke(homing, 0.25) == pytest.approx((12, -0.46))
    assert stroke(homing, 0.25) == pytest.approx((12, -0.46 * 1.1))


def test_the_shortest_stroke_that_goes_too_far_makes_the_next_weaker() -> None:
    homing = a_homing()
    stroke(homing, 0.05)
    stroke(homing, 0.05 - 0.045)  # 3 ticks moved it by 45 mrad: one by 5
    assert stroke(homing, -0.006)[0] == 1
    stroke(homing, 0.007)
    _, drive_V = stroke(homing, 0.006)
    assert abs(drive_V) < 0.46


@pytest.mark.parametrize(("plus_V", "tolerance_rad"), [(0.0, 0.002), (0.5, 0.0)])
def test_senseless_settings_are_refused(plus_V: float, tolerance_rad: float) -> None:
    with pytest.raises(ValueError, match="homing needs"):
        Homing(BreakawayFound(plus_V, 0.5, 0.003), 3.0, tolerance_rad, PERIOD_S, 5.0)
