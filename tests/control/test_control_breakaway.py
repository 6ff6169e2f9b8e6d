"""The breakaway check finds every way a bench can be wired wrong before a relay runs."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from simulated_bench import DEMO_MOTOR, LIMITS, simulated_bench

from rig.control.breakaway import BreakawayCheck
from rig.faults import Fault
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.signals import Sample


def check() -> BreakawayCheck:
    return BreakawayCheck(ramp_V_s=0.4, max_V=1.2, motion_rad=0.02, rest_s=0.4)


def test_it_measures_both_levels_and_the_noise_and_hardly_moves_the_shaft() -> None:
    bench = simulated_bench()
    law = check()
    with bench.loop.armed(LIMITS):
        bench.loop.run(law, "breakaway")
    friction, bias = DEMO_MOTOR.friction, DEMO_MOTOR.bias_V
    # the ramp gains up to 0.15 V until the motion is seen
    assert friction.static_plus_V - bias < law.plus_V < friction.static_plus_V - bias + 0.15
    assert friction.static_minus_V + bias < law.minus_V < friction.static_minus_V + bias + 0.15
    assert 0.002 < law.noise_rad < 0.005
    assert max(abs(row["y_rad"]) for row in bench.record.rows) < 0.15


@pytest.mark.parametrize(
    ("wiring", "code"),
    [
        ({"drive": "reversed"}, "POLARITY"),
        ({"sensor": "reversed"}, "POLARITY"),
        ({"drive": "dead"}, "NO_MOTION"),
        ({"sensor": "stuck"}, "NO_MOTION"),
        ({"sensor": "broken_low"}, "DEVICE_SENSOR"),
        ({"sensor": "broken_high"}, "DEVICE_SENSOR"),
        ({"motor": Motor(0.17, 6.5, coulomb(1.5))}, "NO_MOTION"),
        ({"noise_rad": 0.05}, "SENSOR_NOISY"),
    ],
)
def test_each_wrong_bench_is_named_and_left_at_zero(wiring, code: str) -> None:
    bench = simulated_bench(**wiring)
    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        bench.loop.run(check(), "breakaway")
    assert caught.value.code == code
    assert bench.driver.bench.pin_counts == 0
    # a stuck sensor cannot show the motion: the strokes keep it short
    assert abs(bench.driver.bench.state.y) < 0.5


def test_one_reading_beyond_the_noise_is_no_motion_and_two_are() -> None:
    for seen in ({100}, {100, 101}):
        law = check()
        drives = [law.step(Sample(0.01 * k, 0.1 if k in seen else 0.0, 512)) for k in range(120)]
        goes_on = max(drives[102:]) > max(drives[:100]) > 0.0
        assert goes_on == math.isnan(law.plus_V) == (len(seen) == 1)


def test_a_drive_that_is_stuck_on_is_noticed_though_no_software_can_stop_it() -> None:
    bench = simulated_bench(drive="stuck_on", motor=Motor(0.17, 0.4, coulomb(0.5)))
    with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
        bench.loop.run(check(), "breakaway")
    assert caught.value.code in ("DRIVE_STUCK_ON", "TRAVEL_HARD", "DEVICE_TRAVEL")


def test_a_shaft_that_still_turns_at_the_start_is_waited_for() -> None:
    bench = simulated_bench()
    bench.driver.bench.state = bench.driver.bench.state._replace(v=2.0, y=-0.5)
    law = check()
    with bench.loop.armed(LIMITS):
        bench.loop.run(law, "breakaway")
    assert law.finished


def drives(law: BreakawayCheck, y_rad: Callable[[float], float], until_s: float) -> list[float]:
    return [law.step(Sample(0.01 * k, y_rad(0.01 * k), 512)) for k in range(round(until_s / 0.01))]


@pytest.mark.parametrize(("drift", "waits"), [(2.0, True), (1.5, False)])
def test_a_shaft_that_drifts_by_more_than_the_noise_explains_is_waited_for(drift: float, waits: bool) -> None:
    """Of 20 readings the means of the halves differ by 0.45 standard deviations: four times that is no noise."""
    noise_rad = 0.005

    def y_rad(t_s: float) -> float:
        flicker = noise_rad * math.sqrt(6.0) / 4.0  # which second differences find to be of noise_rad
        return flicker * (-1) ** round(t_s / 0.01) + drift * noise_rad * t_s / 0.1  # the halves are 0.1 s apart

    assert (max(drives(check(), y_rad, 1.0)) == 0.0) is waits


def test_no_motion_says_which_way() -> None:
    with pytest.raises(Fault, match="NO_MOTION") as caught:
        drives(check(), lambda t_s: 0.0, 10.0)
    assert "up to 1.20 V towards rising positions" in caught.value.detail
    with pytest.raises(Fault, match="NO_MOTION") as caught:
        drives(check(), lambda t_s: 0.0 if t_s < 1.0 else 0.1, 10.0)  # it moved, and stands now
    assert "towards falling positions" in caught.value.detail
