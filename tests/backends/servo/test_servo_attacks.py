"""What a hostile look at the servo driver found, once each: none of it may come back."""

from __future__ import annotations

import pytest
from servo_bench import PROTOCOLS, Bench

from rig.faults import Fault


def use_limit_of_config(bench: Bench) -> None:
    """Its owner's own limit is that of the run: after a restart nothing but the mode tells of it."""
    bench.servo.put("max_torque", bench.setup.max_units)
    bench.servo._keep(bench.servo.model["max_torque"])


@pytest.mark.parametrize("in_pause", [False, True])
def test_a_servo_that_restarted_before_it_is_armed_never_gets_its_torque_in_another_mode(in_pause: bool) -> None:
    """With the lock at 1 a Feetech forgets the mode: in its own it would go to a goal of its own under full drive."""
    bench = Bench("feetech")
    use_limit_of_config(bench)
    bench.opened()
    if in_pause:
        bench.driver.arm(bench.limits)
        bench.tick(0.3)
        assert bench.driver.safe_stop()
    bench.servo.power_cycle()
    bench.bus.sleep_until(bench.bus.now_s() + 0.3)
    with pytest.raises(Fault, match="DEVICE_RESET"):
        bench.driver.arm(bench.limits)
    assert not bench.servo.is_on and bench.wrong() == []


def test_a_servo_that_duty_0_does_not_stop_loses_its_torque_at_once() -> None:
    bench = Bench("feetech")
    bench.armed()
    bench.tick(0.3)
    bench.servo.put("mode", 0)  # somebody else's
    bench.servo.put("goal_position", 0)
    fault = bench.fault_within(20)
    assert fault is not None and fault.code == "DEVICE_RESET" and "mode" in fault.detail
    assert bench.driver.safe_stop() and not bench.servo.is_on


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("lost", [2, 5, 9, 11])
def test_one_lost_request_of_a_stop_leaves_no_torque_on(protocol: str, lost: int) -> None:
    bench = Bench(protocol)
    bench.armed()
    bench.tick(0.3)
    sent, left = bench.bus.write, lost

    def write(data: bytes) -> None:
        nonlocal left
        left -= 1
        if left != -1:
            sent(data)

    bench.bus.write = write  # type: ignore[method-assign]  # of this bus alone
    assert bench.driver.safe_stop()
    assert left < 0 and not bench.servo.is_on
