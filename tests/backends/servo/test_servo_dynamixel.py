"""The emulated Dynamixel does what its manual says, and notes what a host must never do."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import further_requests
import pytest
from servo_host import DynamixelHost

from rig.backends.emulated.errors import EmulationError
from rig.backends.servo import dynamixel
from rig.backends.servo.dynamixel import ACCESS, FAILED, LENGTH, LIMIT, NO_INSTRUCTION, RANGE
from rig.backends.servo.emulated.bus import ServoBus
from rig.backends.servo.emulated.dynamixel_servo import HEAT, OVERLOAD, SHOCK, VOLTAGE
from rig.backends.servo.emulated.servo import TICK_S, XL330_M1, ServoOptions
from rig.backends.servo.models import MODELS
from rig.model.bench import BenchParameters
from rig.model.motor import State

FREE = (-math.inf, math.inf)
BENCH = BenchParameters(XL330_M1, stop_rad=FREE, supply_V=5.0)


def test_a_ping_tells_model_and_firmware() -> None:
    status = DynamixelHost(firmware=47).status(dynamixel.ping(1))
    assert status.data == (1200).to_bytes(2, "little") + b"\x2f" and status.error == 0 and not status.alert


@pytest.mark.parametrize(
    ("write", "error"),
    [
        ((64, b"\x02"), RANGE),
        ((100, b"\x76\x03"), RANGE),  # 886
        ((100, b"\x01"), LENGTH),
        ((101, b"\x01"), LENGTH),
        ((100, b"\x00\x00\x00"), LENGTH),
        ((132, b"\x00\x00\x00\x00"), ACCESS),  # read-only
        ((71, b"\x00"), ACCESS),  # none is there
        ((500, b"\x00"), ACCESS),
        ((11, b"\x02"), RANGE),  # a mode that is none
        ((104, (2000).to_bytes(4, "little")), LIMIT),
        ((7, b"\xfd"), RANGE),
        ((98, b"\x80"), RANGE),
    ],
)
def test_what_a_write_may_not(write: tuple[int, bytes], error: int) -> None:
    host = DynamixelHost()
    before = host.servo.peek(0, 119)
    assert host.status(dynamixel.write(1, *write)).error == error
    assert host.servo.peek(0, 119) == before


def test_a_write_of_several_registers_is_all_or_nothing() -> None:
    host = DynamixelHost()
    assert host.status(dynamixel.write(1, 64, b"\x00\x02")).error == RANGE  # the light has no 2
    assert host.status(dynamixel.write(1, 64, b"\x01\x01")).error == 0
    assert (host.read("torque_enable"), host.read("led")) == (1, 1)


def test_a_read_is_what_is_there() -> None:
    host = DynamixelHost()
    assert host.status(dynamixel.read(1, 0, 8)).data[6:] == b"\x34\x01"
    assert host.status(dynamixel.read(1, 71, 5)).data == bytes(5)  # a gap
    assert host.status(dynamixel.read(1, 140, 100)).error == ACCESS
    assert host.status(dynamixel.read(1, 0, 0)).error == ACCESS
    assert host.ask(dynamixel.read(9, 0, 1)) == []


def test_the_eeprom_is_locked_while_the_torque_is_on_and_counts_its_writes() -> None:
    host = DynamixelHost()
    host.ready()
    assert host.write("return_delay_time", 0).error == ACCESS
    host.write("torque_enable", 0)
    assert host.write("return_delay_time", 0).error == 0
    assert host.servo.eeprom_writes == {"operating_mode": 1, "return_delay_time": 1}
    host.write("led", 1)
    host.bus.power_cycle()
    host.sleep(0.3)
    assert host.read("return_delay_time") == 0 and host.read("led") == 0 and host.read("operating_mode") == 16


def test_a_change_of_mode_puts_the_goal_to_the_limit() -> None:
    host = DynamixelHost(registers={"pwm_limit": 600})
    host.write("goal_pwm", 5)
    host.write("position_p_gain", 7)
    host.write("operating_mode", 16)
    assert host.read("goal_pwm") == 600 and host.read("position_p_gain") == 400
    assert host.violations == []
    host.write("torque_enable", 1)
    assert host.violations == ["torque on with goal 600"]
    host.write("pwm_limit", 100)
    assert host.read("goal_pwm") == 600, "locked while the torque is on"


def test_a_limit_holds_the_goal() -> None:
    host = DynamixelHost()
    host.write("operating_mode", 16)
    host.write("pwm_limit", 300)
    assert host.read("goal_pwm") == 300
    assert host.write("goal_pwm", 301).error == LIMIT and host.write("goal_pwm", -300).error == 0


def test_torque_on_in_another_mode_is_a_violation_and_holds_the_position() -> None:
    host = DynamixelHost()
    host.write("torque_enable", 1)
    assert host.violations == ["torque on in mode 3"]
    before = host.read("present_position")
    host.write("goal_position", before + 400)
    host.sleep(2.0)
    assert host.read("present_position") == pytest.approx(before + 400, abs=30)


def test_the_duty_moves_the_shaft_as_the_model_says() -> None:
    """The slope at its steepest: a ramp of some milliseconds, and then the exact motor."""
    host = DynamixelHost(registers={"return_delay_time": 0, "pwm_slope": 255}, bench=BENCH)
    host.ready()
    begins_s = host.bus.now_s()
    host.write("goal_pwm", 400)
    host.bus.sleep_until(begins_s + 0.5)
    volts = 400 / 885 * 5.0
    changes = [(t_s, u_V) for t_s, u_V in host.bus.outputs[0] if t_s > begins_s]
    rise = 255 * 1.977e-3  # V in a millisecond
    assert [u_V for _, u_V in changes[:2]] == pytest.approx([0.5 * rise, 1.5 * rise])
    assert changes[-1][1] == pytest.approx(volts)
    state, t_s = State(), changes[0][0]
    ends = [*(t for t, _ in changes[1:]), host.bus.now_s()]
    for end_s, (_, u_V) in zip(ends, changes, strict=True):
        state, t_s = XL330_M1.advance(state, u_V, end_s - t_s), end_s
    assert host.truth.y_rad == pytest.approx(state.y, abs=1e-9)


@pytest.mark.parametrize(("slope", "ms"), [(140, 18.06), (255, 9.92)])
def test_the_ramp_takes_its_time(slope: int, ms: float) -> None:
    """e-Manual: 0 to full duty at 5 V in 18 ms as shipped."""
    host = DynamixelHost(registers={"return_delay_time": 0, "pwm_slope": slope})
    host.ready()
    begins_s = host.bus.now_s()
    host.write("goal_pwm", 885)
    host.sleep(0.1)
    reached_s = host.bus.outputs[0][-1][0]
    assert host.bus.outputs[0][-1][1] == pytest.approx(5.0)
    assert 1e3 * (reached_s - begins_s) == pytest.approx(ms + 0.5, abs=1.5)
    host.write("torque_enable", 0)
    host.sleep(2 * TICK_S)
    assert host.truth.motor_V == 0.0, "torque off is no ramp"


def test_a_servo_without_slope_jumps() -> None:
    host = DynamixelHost(model="xl430-w250", bench=replace(BENCH, supply_V=12.0))
    host.ready(885)
    assert [u_V for _, u_V in host.bus.outputs[0]] == [0.0, 12.0]


def test_torque_off_coasts_and_duty_0_brakes() -> None:
    speeds = {}
    for how in ("brake", "coast"):
        host = DynamixelHost(registers={"return_delay_time": 0, "pwm_slope": 255})
        host.ready(600)
        host.sleep(0.5)
        host.write(*(("goal_pwm", 0) if how == "brake" else ("torque_enable", 0)))
        host.sleep(0.03)
        speeds[how] = host.truth.v_rad_per_s
    assert 0.0 < speeds["brake"] < 0.75 * speeds["coast"]


def test_the_position_goes_on_over_turns_and_falls_back() -> None:
    host = DynamixelHost()
    host.ready(800)
    host.sleep(3.0)
    turned = host.read("present_position")
    assert turned > 3 * 4096
    assert host.status(further_requests.clear_turns(1)).error == FAILED, "it moves"
    host.write("goal_pwm", 0)
    host.sleep(1.0)
    before = host.read("present_position")
    assert host.status(further_requests.clear_turns(1)).error == 0
    assert host.read("present_position") == before % 4096
    host.write("goal_pwm", 800)
    host.sleep(2.0)
    host.write("goal_pwm", 0)
    host.sleep(1.0)
    assert host.read("present_position") > 4096
    host.write("torque_enable", 0)
    host.status(dynamixel.reboot(1))
    host.sleep(0.5)
    assert 0 <= host.read("present_position") < 4096


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("drive_mode", [0, 1])
def test_the_drive_mode_reverses_all_of_it(drive_mode: int, polarity: int) -> None:
    """Seen from the bus a servo is the same, reversed or not; the shaft turns the other way."""
    host = DynamixelHost(polarity=polarity, registers={"drive_mode": drive_mode})
    before = host.read("present_position")
    host.ready(400)
    host.sleep(0.5)
    seen = {name: host.read(name) for name in ("present_pwm", "present_velocity", "present_position")}
    assert seen["present_pwm"] == 400
    expected = 1 if polarity > 0 else -1  # a motor that is mounted the other way round is seen to go backwards
    assert seen["present_velocity"] * expected > 0 and (seen["present_position"] - before) * expected > 0
    assert host.truth.y_rad > 0.0 if drive_mode == 0 else host.truth.y_rad < 0.0


def test_a_goal_can_switch_the_torque_on() -> None:
    """Drive mode bit 3."""
    host = DynamixelHost(registers={"drive_mode": 8, "operating_mode": 16})
    host.write("goal_pwm", 300)
    assert host.read("torque_enable") == 1 and host.violations == ["torque on with goal 300"]


def test_a_slave_ignores_its_goals() -> None:
    host = DynamixelHost(model="xm540-w270", registers={"drive_mode": 2, "min_voltage_limit": 0})
    host.ready(500)
    host.sleep(0.1)
    assert host.read("goal_pwm") == 500 and host.truth.duty == 0.0


def test_the_torque_may_be_on_at_power_on() -> None:
    host = DynamixelHost(registers={"startup_configuration": 1, "operating_mode": 16})
    assert host.read("torque_enable") == 1 and host.violations == ["torque on with goal 885"]


def test_a_shadow_id_makes_it_obey_without_a_word() -> None:
    host = DynamixelHost(ServoOptions(id=2, registers={"secondary_id": 1, "operating_mode": 16}))
    assert host.write("led", 1).error == 0
    assert host.read("led", id=2) == 1
    host.write("return_delay_time", 100)
    assert host.read("return_delay_time", id=2) == 250, "no EEPROM by its shadow id"
    assert host.ask(further_requests.sync_write(dynamixel, 65, {1: b"\x00"})) == []
    assert host.read("led", id=2) == 0
    shadow = DynamixelHost(registers={"secondary_id": 100})
    assert shadow.ask(dynamixel.write(100, 65, b"\x01")) == [] and shadow.read("led") == 1


# ---------------------------------------------------------------------- the watchdog


def _driven(duty: int = 300, units: int = 3, **options: Any) -> DynamixelHost:
    host = DynamixelHost(registers={"return_delay_time": 0, "pwm_slope": 255}, **options)
    host.ready(duty)
    host.write("bus_watchdog", units)
    host.sleep(0.9 * 0.02 * units)
    assert host.truth.duty == duty
    return host


def test_the_watchdog_stops_a_servo_that_hears_nothing() -> None:
    host = _driven()
    host.sleep(0.1)
    assert host.truth.duty == 0.0 and host.truth.motor_V == 0.0
    assert host.read("bus_watchdog") == -1 and host.read("present_pwm") == 0
    assert host.write("goal_pwm", 10).error == RANGE and host.write("bus_watchdog", 3).error == RANGE
    assert host.write("bus_watchdog", 0).error == 0 and host.write("goal_pwm", 10).error == 0
    host.sleep(0.2)
    assert host.truth.duty == 10.0


def test_any_instruction_feeds_it_or_only_its_own() -> None:
    for fed_by, goes_on in (("any", True), ("own", False)):
        host = _driven(watchdog_fed_by=fed_by)
        for _ in range(20):
            host.bus.write(dynamixel.ping(77))
            host.sleep(0.01)
        assert (host.truth.duty != 0.0) is goes_on


def test_it_watches_only_while_the_torque_is_on() -> None:
    host = DynamixelHost()
    host.write("bus_watchdog", 1)
    host.sleep(1.0)
    assert host.read("bus_watchdog") == 1


def test_the_defect_says_that_it_has_acted_and_drives_on() -> None:
    host = _driven(watchdog_defect=True)
    host.sleep(0.1)
    assert host.read("bus_watchdog") == -1 and host.truth.duty == 300.0 and host.read("present_pwm") == 300
    assert host.write("goal_pwm", 0).error == RANGE, "not even a stop is taken"


@pytest.mark.parametrize("how", ["brake", "coast"])
def test_what_its_bridge_does_then_is_an_option(how: Any) -> None:
    host = _driven(stopped_by_watchdog=how)
    host.sleep(0.02)
    assert host.servo.bench.parameters.coasting is (how == "coast")


def test_the_old_goal_may_drive_again() -> None:
    for resumes, goal in ((False, 0), (True, 300)):
        host = _driven(resumes=resumes)
        host.sleep(0.1)
        host.write("bus_watchdog", 0)
        assert host.read("goal_pwm") == goal


# ---------------------------------------------------------------------- what goes wrong


@pytest.mark.parametrize(
    ("happens", "bit"),
    [
        (lambda servo: servo.supply(3.3), VOLTAGE),
        (lambda servo: servo.supply(7.3), VOLTAGE),
        (lambda servo: setattr(servo, "temperature_degC", 71.0), HEAT),
        (lambda servo: servo.fail(OVERLOAD), OVERLOAD),
        (lambda servo: servo.fail(SHOCK), SHOCK),
    ],
)
def test_an_error_takes_the_torque_until_a_reboot(happens: Any, bit: int) -> None:
    host = DynamixelHost()
    host.ready(200)
    happens(host.servo)
    host.sleep(2 * TICK_S)
    assert host.truth.duty == 0.0 and not host.truth.is_on
    status = host.status(dynamixel.read(1, 70, 1))
    assert status.alert and status.data == bytes((bit,))
    assert host.write("torque_enable", 1).alert and host.read("torque_enable") == 0
    host.servo.supply(5.0)
    host.servo.temperature_degC = 25.0
    assert host.status(dynamixel.reboot(1)).error == 0
    assert host.ask(dynamixel.ping(1)) == [], "it starts"
    host.sleep(0.3)
    assert host.read("hardware_error_status") == 0
    host.ready(100)
    assert host.read("torque_enable") == 1


def test_an_error_that_its_shutdown_has_not_only_alerts() -> None:
    host = DynamixelHost(registers={"shutdown": 52})
    host.ready(200)
    host.servo.supply(3.3)
    host.sleep(0.01)
    assert host.truth.is_on and host.status(dynamixel.ping(1)).alert


def test_it_warms_up_under_current_and_its_supply_sags() -> None:
    host = DynamixelHost(bench=replace(BENCH, stop_rad=(-0.1, 0.1)), heating_degC_s=10.0, sag_V=0.6)
    host.ready(885)
    host.sleep(3.0)  # against the stop: the current of the stall
    voltage, temperature = host.read("present_input_voltage"), host.read("present_temperature")
    held_V = 5.0 / (1.0 + 0.6 / 5.0)
    assert voltage == round(10 * held_V) and temperature == pytest.approx(25 + 3 * 10 * (held_V / 5.0) ** 2, abs=1.5)
    host.write("goal_pwm", 0)
    host.sleep(0.5)
    assert host.read("present_input_voltage") == 50


def test_the_tick_counts_milliseconds() -> None:
    host = DynamixelHost()
    first = host.read("realtime_tick")
    host.sleep(1.0)
    assert (host.read("realtime_tick") - first) % 32_768 == pytest.approx(1000, abs=60)


# ---------------------------------------------------------------------- instructions


def test_a_registered_write_waits_for_the_action() -> None:
    host = DynamixelHost()
    assert host.status(further_requests.action(dynamixel, 1)).error == NO_INSTRUCTION
    assert host.status(further_requests.reg_write(dynamixel, 1, 65, b"\x02")).error == RANGE
    assert host.status(further_requests.reg_write(dynamixel, 1, 65, b"\x01")).error == 0
    assert (host.read("registered_instruction"), host.read("led")) == (1, 0)
    assert host.ask(further_requests.action(dynamixel)) == []
    assert (host.read("registered_instruction"), host.read("led")) == (0, 1)


def test_an_instruction_that_is_none() -> None:
    assert DynamixelHost().status(dynamixel.Frame(1, 0x30).encode()).error == NO_INSTRUCTION


@pytest.mark.parametrize(("level", "answered"), [(0, (1, 0, 0)), (1, (1, 1, 0)), (2, (1, 1, 1))])
def test_its_return_level(level: int, answered: tuple[int, int, int]) -> None:
    host = DynamixelHost()
    host.ask(dynamixel.write(1, 68, bytes((level,))))
    asked = (dynamixel.ping(1), dynamixel.read(1, 7, 1), dynamixel.write(1, 65, b"\x01"))
    assert tuple(len(host.ask(data)) for data in asked) == answered
    assert host.servo.value("led") == 1


def test_a_factory_reset_keeps_what_it_is_told_to() -> None:
    host = DynamixelHost(id=5)
    host.write("pwm_slope", 9)
    host.write("torque_enable", 1)
    assert host.status(further_requests.factory_reset(5, "id and baud")).error == FAILED, "the torque is on"
    host.write("torque_enable", 0)
    assert host.status(further_requests.factory_reset(5, "id and baud")).error == 0
    host.sleep(0.3)
    assert host.read("pwm_slope") == 140 and host.read("return_delay_time") == 250
    host.status(further_requests.factory_reset(5, "id"))
    host.sleep(0.3)
    assert host.ask(dynamixel.ping(5)) == [], "it has the baud of a new one"
    host.bus.set_baud(57_600)
    assert len(host.ask(dynamixel.ping(5))) == 1
    host.ask(further_requests.factory_reset(dynamixel.BROADCAST, "nothing"))
    assert len(host.ask(dynamixel.ping(5))) == 1, "not for all at once"


def test_a_new_baud_is_heard_at_once() -> None:
    host = DynamixelHost()
    host.ask(dynamixel.write(1, 8, b"\x04"))
    assert host.ask(dynamixel.ping(1)) == []
    host.bus.set_baud(2_000_000)
    assert len(host.ask(dynamixel.ping(1))) == 1


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"model": "xl320"}, "no servo that rig knows"),
        ({"baud": 12_345}, "no baud 12345"),
        ({"registers": {"nonsense": 1}}, "no register nonsense"),
        ({"registers": {"led": 256}}, "cannot hold 256"),
    ],
)
def test_a_servo_that_cannot_be(options: dict[str, Any], match: str) -> None:
    with pytest.raises(EmulationError, match=match):
        ServoBus([ServoOptions(**options)])


@pytest.mark.parametrize("name", MODELS)
def test_every_model_can_be_emulated(name: str) -> None:
    servos = ServoBus([ServoOptions(model=name, bench=replace(BENCH, supply_V=sum(MODELS[name].supply_V) / 2.0))])
    servos.advance_to(1.0)
    servo = servos.servo(1)
    for register in servo.model.registers.values():
        assert len(servo.peek(register.address, register.size)) == register.size
    assert servo.of("errors") == 0
