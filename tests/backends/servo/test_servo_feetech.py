"""The emulated Feetech servo does what its tables say, and notes what a host must never do."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import further_requests
import pytest
from servo_host import FeetechHost

from rig.backends.servo import feetech
from rig.backends.servo.emulated.servo import STS3215_M1, TICK_S
from rig.backends.servo.feetech import HEAT, OVERLOAD, VOLTAGE
from rig.model.bench import BenchParameters
from rig.model.motor import State

BENCH = BenchParameters(STS3215_M1, stop_rad=(-math.inf, math.inf), supply_V=7.4)


def _host(**options: Any) -> FeetechHost:
    return FeetechHost(**{"bench": BENCH} | options)


def test_a_ping_and_the_number() -> None:
    host = _host()
    assert host.status(feetech.ping(1)) == feetech.Status(1, 0, b"")
    assert host.read("model_number") == 777
    assert host.ask(feetech.ping(2)) == []


def test_the_duty_moves_the_shaft_as_the_model_says() -> None:
    host = _host()
    host.ready()
    host.write("goal_duty", -500)
    changes = host.bus.outputs[0][-1:]
    host.sleep(0.4)
    (begins_s, u_V) = changes[0]
    assert u_V == pytest.approx(-3.7)
    state = STS3215_M1.advance(State(), u_V, host.bus.now_s() - begins_s)
    assert host.truth.y_rad == pytest.approx(state.y, abs=1e-9)
    assert host.read("present_load") == -500
    assert host.read("present_speed") == pytest.approx(state.v / (2 * math.pi / 4096), abs=2)
    assert host.violations == []


def test_the_position_is_one_turn_or_goes_on() -> None:
    for phase, most in ((12, 4095), (12 | 16, 99_999)):
        host = _host(registers={"phase": phase})
        host.ready(1000)
        seen = []
        for _ in range(60):
            host.sleep(0.05)
            seen.append(host.read("present_position"))
        assert (max(seen) > 4095) is (most > 4095)
        assert min(seen) >= 0
        assert (min(b - a for a, b in pairwise(seen)) < -2048) is (most == 4095)


def test_the_unit_of_speed_is_a_bit_of_phase() -> None:
    speeds = []
    for phase in (12, 8):
        host = _host(registers={"phase": phase})
        host.ready(800)
        host.sleep(0.5)
        speeds.append(host.read("present_speed"))
    assert speeds[0] == pytest.approx(50 * speeds[1], abs=50) and speeds[1] > 10


def test_what_does_not_fit_is_ignored_without_a_word() -> None:
    host = _host()
    for register, raw in (
        (5, b"\xfe"),
        (33, b"\x09"),
        (48, b"\xe9\x03"),
        (56, b"\x01\x01"),
        (44, b"\x00\x08"),
        (40, b"\x03"),
    ):
        before = host.servo.peek(0, 56)
        assert host.status(feetech.write(1, register, raw)).errors == 0
        assert host.servo.peek(0, 56) == before
    assert host.status(feetech.write(1, 43, b"\x07")).errors == 0 and host.read("goal_position") == 0, "half a register"


def test_behind_the_lock_nothing_is_kept() -> None:
    host = _host()
    host.write("mode", 2)
    assert host.read("mode") == 2 and host.servo.eeprom_writes == {}
    host.bus.power_cycle()
    host.sleep(0.3)
    assert host.read("mode") == 0 and host.read("lock") == 1
    host.write("lock", 0)
    host.write("mode", 2)
    assert host.servo.eeprom_writes == {"mode": 1}
    host.bus.power_cycle()
    host.sleep(0.3)
    assert host.read("mode") == 2 and host.servo.saved("mode") == 2


def test_the_goal_after_power_on_may_be_full_duty() -> None:
    host = _host()
    host.write("mode", 2)
    assert host.read("goal_duty") == 1000
    host.write("torque_enable", 1)
    assert host.violations == ["torque on with goal 1000"]
    assert FeetechHost(goal_at_boot=0).read("goal_duty") == 0


def test_128_to_register_40_makes_here_the_middle() -> None:
    host = _host(bench=replace(BENCH, start_rad=1.0))
    before = host.read("present_position")
    assert host.write("torque_enable", 128).errors == 0
    assert host.violations == ["128 to register 40: here is the middle now"]
    assert before != 2048 and host.read("present_position") == 2048
    assert host.servo.eeprom_writes == {"homing_offset": 1}


def test_other_violations() -> None:
    host = _host()
    host.write("torque_enable", 1)
    host.write("mode", 2)
    assert host.violations == ["torque on in mode 0", "mode 2 while the torque is on"]


def test_a_goal_may_switch_the_torque_on() -> None:
    for switches in (False, True):
        host = _host(torque_on_by_goal=switches)
        host.write("mode", 2)
        host.write("goal_duty", 300)
        assert host.read("torque_enable") == int(switches)
        assert bool(host.violations) is switches


def test_the_torque_limit_holds_the_duty() -> None:
    host = _host()
    host.ready(800)
    host.write("torque_limit", 250)
    host.sleep(2 * TICK_S)
    assert host.truth.duty == 250.0
    host.bus.power_cycle()
    host.sleep(0.3)
    assert host.read("torque_limit") == 1000


def test_damped_brakes_and_off_coasts() -> None:
    speeds = []
    for value in (2, 0):
        host = _host()
        host.ready(800)
        host.sleep(0.5)
        host.write("torque_enable", value)
        host.sleep(0.03)
        speeds.append(host.truth.v_rad_per_s)
        assert host.truth.motor_V == 0.0
    assert 0.0 < speeds[0] < 0.75 * speeds[1]


def test_nothing_watches_over_the_host() -> None:
    host = _host()
    host.ready(600)
    host.sleep(5.0)
    assert host.truth.duty == 600.0


def test_overload_protects_in_pwm_mode_only_where_it_is_said_to() -> None:
    for protects, duty in ((False, 900.0), (True, 200.0)):
        host = _host(protects_in_pwm=protects)
        host.ready(900)
        host.sleep(1.9)
        assert host.truth.duty == 900.0
        host.sleep(0.2)
        assert host.truth.duty == duty
        assert bool(host.status(feetech.ping(1)).errors & OVERLOAD) is protects


@pytest.mark.parametrize("is_protected", [True, False])
def test_heat_takes_the_torque_where_its_protection_has_it(is_protected: bool) -> None:
    host = _host(registers={"unloading_condition": HEAT if is_protected else 0})
    host.ready(300)
    host.servo.temperature_degC = 71.0
    host.sleep(0.01)
    assert host.truth.is_on is not is_protected
    assert host.status(feetech.ping(1)).errors == HEAT and host.read("present_temperature") == 71
    host.servo.temperature_degC = 50.0
    host.sleep(0.01)
    assert host.status(feetech.ping(1)).errors == 0


def test_its_supply_and_a_failure() -> None:
    host = _host()
    host.servo.supply(3.0)
    host.sleep(0.01)
    assert host.status(feetech.ping(1)).errors == VOLTAGE and host.read("present_voltage") == 30
    host.servo.supply(7.4)
    host.servo.fail(feetech.CURRENT)
    assert host.status(feetech.ping(1)).words == ["its current is too large"]
    host.servo.is_mute = True
    assert host.ask(feetech.ping(1)) == []


def test_instructions() -> None:
    host = _host()
    assert host.status(further_requests.reg_write(feetech, 1, 41, b"\x09")).errors == 0
    assert (host.read("async_write"), host.read("acceleration")) == (1, 0)
    assert host.ask(further_requests.action(feetech)) == []
    assert (host.read("async_write"), host.read("acceleration")) == (0, 9)
    assert host.ask(feetech.Frame(1, 0x77).encode()) == []
    assert host.ask(feetech.read(1, 0, 250)) == [], "more than an answer holds"
    host.ask(feetech.write(1, 8, b"\x00"))
    assert host.ask(feetech.write(1, 41, b"\x05")) == [] and host.read("acceleration") == 5
    host.ask(further_requests.reset(1))
    assert host.read("response_level") == 1
    assert host.ask(feetech.reboot(1)) == [] and host.ask(feetech.ping(1)) == []
    host.sleep(0.3)
    assert len(host.ask(feetech.ping(1))) == 1


def test_a_position_is_held_in_mode_0() -> None:
    host = _host()
    host.write("goal_position", 2500)
    host.write("torque_enable", 1)
    host.sleep(2.0)
    assert host.read("present_position") == pytest.approx(2500, abs=25)
