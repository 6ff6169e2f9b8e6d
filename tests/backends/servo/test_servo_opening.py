"""Opening a servo: what is refused, with nothing written; what is set up; the watchdog is proven at the bridge."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import pytest
from evidence import evidence
from servo_bench import BYSTANDERS, PROTOCOLS, Bench, line_of

from rig.backends.registry import backend_of, connect
from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.opening import check_alone, check_others
from rig.config.schema import Experiment
from rig.core.faults import Fault
from rig.testing.line import on_device

COUNT_RAD = 2.0 * math.pi / 4096
ID_AT = 4  # in a Dynamixel's packet

REFUSED: list[tuple[str, str, dict[str, int], str, str]] = [
    ("dynamixel", "its torque is on", {"torque_enable": 1}, "SERVO_IN_USE", "torque is on"),
    ("dynamixel", "a goal switches the torque on", {"drive_mode": 8}, "SERVO_SETUP", "a goal switches"),
    ("dynamixel", "it follows another", {"drive_mode": 2}, "SERVO_SETUP", "follows"),
    ("dynamixel", "it obeys another id", {"secondary_id": 9}, "SERVO_SETUP", "obeys"),
    ("dynamixel", "it may drive at power-on", {"startup_configuration": 1}, "SERVO_SETUP", "as soon as"),
    ("dynamixel", "its RAM comes back at power-on", {"startup_configuration": 2}, "SERVO_SETUP", "as soon as"),
    ("dynamixel", "a hardware error", {"hardware_error_status": 0x20}, "SERVO_ERROR", "overload"),
    ("dynamixel", "its lowest voltage is near", {"min_voltage_limit": 50}, "SERVO_SUPPLY", "too near"),
    ("dynamixel", "its highest voltage is near", {"max_voltage_limit": 50}, "SERVO_SUPPLY", "too near"),
    ("feetech", "its torque is on", {"torque_enable": 1}, "SERVO_IN_USE", "torque is on"),
    ("feetech", "what is written stays", {"lock": 0}, "SERVO_SETUP", "for good"),
    ("dynamixel", "no answer to a write", {"status_return_level": 1}, "SERVO_SETUP", "does not answer"),
    ("feetech", "no answer to a write", {"response_level": 0}, "SERVO_SETUP", "does not answer"),
    ("feetech", "its position counts turns", {"phase": 0x10 | 0x0C}, "SERVO_SETUP", "counts turns"),
    ("dynamixel", "no protection from overload", {"shutdown": 0x14}, "SERVO_SETUP", "does not protect"),
    ("dynamixel", "its owner allows less duty", {"pwm_limit": 201}, "SERVO_SETUP", "allows 1.135 V; lower"),
    (
        "feetech",
        "its owner allows no duty",
        {"torque_limit": 0},
        "SERVO_SETUP",
        "allows 0 V; lower drive.max_V, or raise",
    ),
    ("feetech", "no protection from overload", {"unloading_condition": 0x04}, "SERVO_SETUP", "does not protect"),
    ("feetech", "no protection from heat", {"unloading_condition": 0x20}, "SERVO_SETUP", "does not protect"),
]


def writes(bench: Bench) -> list[int]:
    """Instructions that change anything, of all packets so far."""
    reading = {dynamixel.Instruction.PING, dynamixel.Instruction.READ}
    codes = [f.instruction if isinstance(f, dynamixel.Frame) else f.code for _, f in bench.bus.bus.log]
    return [code for code in codes if code not in reading]


def refused(bench: Bench) -> Fault:
    """The fault of an opening that must fail; its end writes nothing either."""
    with pytest.raises(Fault) as raised:
        bench.opened()
    bench.driver.safe_stop()
    bench.driver.close()
    assert writes(bench) == [] and bench.servo.eeprom_writes.total() == 0
    assert bench.store.load(bench.setup.model) is None
    return raised.value


@pytest.mark.parametrize(("protocol", "_what", "registers", "code", "words"), REFUSED)
def test_a_servo_that_could_move_unasked_is_refused_and_nothing_is_written(
    protocol: str, _what: str, registers: dict[str, int], code: str, words: str
) -> None:
    bench = Bench(protocol)
    for name, value in registers.items():
        bench.servo.put(name, value)
    if "hardware_error_status" in registers:
        bench.servo.put("hardware_error_status", registers["hardware_error_status"])
    fault = refused(bench)
    assert fault.code == code and words in fault.detail


@pytest.mark.parametrize("mute", [False, True])  # it answers pings alone, and obeys in silence
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_two_servos_of_one_id_are_refused_as_both_would_obey(protocol: str, mute: bool) -> None:
    bench = Bench(protocol)
    other = bench.bystanders[0]
    other.put("id", bench.own.id)
    if mute:
        other.put({"dynamixel": "status_return_level", "feetech": "response_level"}[protocol], 0)
    fault = refused(bench)
    assert fault.code == "LINK_UNIT" and f"two servos have id {bench.own.id}" in fault.detail


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_another_supply_than_the_configs_is_refused(protocol: str) -> None:
    bench = Bench(protocol)
    bench.servo.supply(0.9 * bench.setup.supply_V)
    assert refused(bench).code == "SERVO_SUPPLY"


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_hot_servo_is_refused(protocol: str) -> None:
    bench = Bench(protocol, ambient_degC=61.0)
    assert refused(bench).code == "SERVO_HOT"


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_another_model_is_refused_by_its_name(protocol: str) -> None:
    name = {"dynamixel": "xl330-m077", "feetech": "sts3250"}[protocol]
    fault = refused(Bench(protocol, model=name))
    assert fault.code == "CONFIG_MISMATCH" and name in fault.detail


@pytest.mark.parametrize("level", [2, 1, 0])  # at 0 it answers pings alone, and obeys in silence
@pytest.mark.parametrize("is_lost", [False, True])
def test_a_servo_that_has_our_id_as_its_second_is_found(level: int, is_lost: bool) -> None:
    """Also where its first answer is lost: unseen it would drive as rig's own does."""
    bench = Bench(others={"secondary_id": 1, "status_return_level": level})
    left = set(BYSTANDERS) if is_lost else set()

    def lost(direction: str, data: bytes, _: float) -> list[tuple[float, bytes]]:
        if direction == "reply" and data[ID_AT] in left:
            left.remove(data[ID_AT])
            return []
        return [(0.0, data)]

    bench.bus.bus.disturbance = lost
    assert refused(bench).code in ("SERVO_SETUP", "LINK_REPLY", "LINK_TIMEOUT")
    assert not left


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("adapter_s", [0.006, 0.018, 0.06])  # answers come while another id is asked
def test_behind_a_slow_adapter_the_others_are_found_or_it_is_refused(protocol: str, adapter_s: float) -> None:
    """Else what a run has left could not be put back there; and nobody is there only where that is sure."""
    bench = Bench(protocol)
    bench.bus.bus.line = dataclasses.replace(bench.bus.bus.line, adapter_s=adapter_s)
    if adapter_s > 0.05:
        with pytest.raises(Fault, match="LINK_UNIT"):
            check_others(bench.driver._link)
    else:
        assert "servo 4, 7;" in check_others(bench.driver._link)[0]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_another_master_on_the_bus_is_heard(protocol: str) -> None:
    bench = Bench(protocol)
    codec = {"dynamixel": dynamixel, "feetech": feetech}[protocol]
    address = {"dynamixel": 132, "feetech": 56}[protocol]
    for k in range(200):
        bench.bus.bus.another_master(codec.read(BYSTANDERS[0], address, 2), 0.005 + 0.01 * k)
    with pytest.raises(Fault) as raised:
        bench.opened()
    assert raised.value.code in ("SECOND_MASTER", "LINK_UNIT", "LINK_REPLY", "LINK_TIMEOUT")
    assert not bench.servo.is_on and bench.servo.eeprom_writes.total() == 0


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_bytes_that_nobody_asked_for_are_those_of_another_master(protocol: str) -> None:
    bench = Bench(protocol)
    codec = {"dynamixel": dynamixel, "feetech": feetech}[protocol]
    check_alone(bench.driver._link)
    bench.bus.bus.another_master(codec.ping(BYSTANDERS[0]), bench.bus.now_s() + 0.001)
    with pytest.raises(Fault, match="SECOND_MASTER"):
        check_alone(bench.driver._link)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_opening_tells_who_is_there_and_what_it_changes(protocol: str) -> None:
    bench = Bench(protocol)
    bench.bystanders[0].put("model_number", 9)
    info = bench.opened()
    told = " ".join(info.remarks)
    assert info.board == bench.setup.model.name and info.drive_units == bench.setup.model.full_drive
    assert "also on this bus: servo 4, 7" in told and "drives servo 1, and 1 of them, 7, is of the same model" in told
    assert bench.setup.model.roles["mode"] in told
    assert abs(info.supply_V - bench.setup.supply_V) <= 0.06
    assert not bench.servo.is_on and bench.servo.of("drive") == 0
    assert bench.servo.of("mode") == bench.setup.model.pwm_mode
    assert bench.servo.of("max_drive") == bench.setup.max_units
    assert bench.wrong() == []


@pytest.mark.parametrize("first", [0, *evidence(*range(1, 201, 50))])
@pytest.mark.parametrize(
    ("defect", "resumes", "stopped", "proven"),
    [(False, False, "brake", True), (False, True, "coast", True), (True, False, "brake", False),
     (True, True, "brake", False)],
)  # fmt: skip
def test_the_watchdog_is_believed_only_where_the_duty_went(
    defect: bool, resumes: bool, stopped: str, proven: bool, first: int
) -> None:
    """Firmware 51 says -1 and drives on. The shaft does not move by a count; at phases of the servo's step."""
    for phase in range(first, first + 50) if first else (0,):
        bench = Bench(watchdog_defect=defect, resumes=resumes, stopped_by_watchdog=stopped)
        bench.bus.sleep_until(bench.bus.now_s() + phase / 7.0 * 1e-3)
        before_rad = bench.servo.truth().y_rad
        info = bench.opened()
        assert (bench.driver.failsafe is not None) == proven, phase
        assert proven or any("the motor drives on" in remark for remark in info.remarks)
        assert abs(bench.servo.truth().y_rad - before_rad) < COUNT_RAD
        assert not bench.servo.is_on and bench.servo.value("bus_watchdog") == 0 == bench.servo.of("drive")
        assert bench.wrong() == []


def test_a_watchdog_that_has_acted_for_another_program_is_cleared() -> None:
    """It takes no goal, and rig left no file that says so."""
    bench = Bench()
    bench.armed()
    bench.tick(0.3)
    bench.bus.sleep_until(bench.bus.now_s() + 0.2)
    bench.servo.put("torque_enable", 0)
    assert bench.servo.value("bus_watchdog") == -1
    bench.store.clear()
    bench.another().open()
    assert bench.driver.failsafe is not None and bench.wrong() == []


def test_a_duty_that_does_not_act_proves_no_watchdog() -> None:
    bench = Bench()
    real = bench.servo._target
    bench.servo._target = lambda: 0.0 if abs(real()) <= 3.0 else real()  # type: ignore[method-assign]  # of this one
    info = bench.opened()
    assert bench.driver.failsafe is None
    assert any("nothing could be seen" in remark for remark in info.remarks)


def test_a_duty_that_went_for_another_reason_proves_no_watchdog() -> None:
    """As where the supply fails for an instant in the silence: its register tells that the watchdog has not acted."""
    bench = Bench()
    wait, client = bench.driver._client.wait, bench.driver._client

    def failing(wait_s: float) -> None:
        if bench.servo.value("bus_watchdog") == 1:
            bench.bus.power_cycle()
        wait(wait_s + 0.3)

    client.wait = failing  # type: ignore[method-assign]  # of this one
    bench.opened()
    assert bench.driver.failsafe is None and not bench.servo.is_on


def opened_by_config(bench: Bench, change: Callable[[Experiment], Experiment] = lambda e: e) -> None:
    e = change(bench.e)
    assert backend_of(e.device).name == "servo"
    with on_device(bench.bus), connect(e.device):
        pass


def test_a_servo_whose_watchdog_does_not_work_needs_leave() -> None:
    with pytest.raises(Fault, match="NO_WATCHDOG"):
        opened_by_config(bench := Bench(watchdog_defect=True))
    assert not bench.servo.is_on and bench.servo.of("mode") == 3
    accepts = bench.e.daq.model_copy(update={"accept_no_watchdog": True})
    opened_by_config(Bench(watchdog_defect=True), lambda e: e.model_copy(update={"daq": accepts}))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_bench_of_the_tests_is_the_configs(protocol: str) -> None:
    assert line_of(Bench(protocol)).emulated


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_an_adapter_that_echoes_is_found_and_its_echo_compared(protocol: str) -> None:
    bench = Bench(protocol)
    bench.bus.bus.line = dataclasses.replace(bench.bus.bus.line, echo=True)
    bench.armed()
    for _ in range(5):
        bench.tick(0.3)
    assert bench.driver._bus.echoes
    bench.bus.bus.line = dataclasses.replace(bench.bus.bus.line, echo=False)
    fault = bench.fault_within(2, 0.3)
    assert fault is not None and fault.code in ("LINK_REPLY", "LINK_TIMEOUT")


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_what_a_killed_run_has_left_is_not_taken_from_who_drives_it_now(protocol: str) -> None:
    bench = Bench(protocol)
    bench.store.save(bench.setup.model, bench.own.id, {bench.setup.model.roles["mode"]: 0})
    bench.servo._set("torque", 1)
    codec = {"dynamixel": dynamixel, "feetech": feetech}[protocol]
    for k in range(400):
        bench.bus.bus.another_master(codec.ping(BYSTANDERS[0]), 0.0053 + 0.01 * k)
    with pytest.raises(Fault):
        bench.opened()
    bench.driver.safe_stop()
    bench.driver.close()
    assert bench.servo.is_on and bench.store.load(bench.setup.model) is not None


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_servo_whose_goal_does_not_become_0_is_never_armed(protocol: str) -> None:
    bench = Bench(protocol)
    drive, real = bench.servo.model.roles["drive"], bench.servo.put

    def put(name: str, value: int) -> None:
        if (name, value) != (drive, 0):
            real(name, value)

    bench.servo.put = put  # type: ignore[method-assign]  # of this one
    with pytest.raises(Fault, match="ARM_READBACK"):
        bench.opened()
    assert bench.servo.value(drive) != 0 and not bench.servo.is_on and bench.wrong() == []


def test_a_servo_that_a_duty_switches_on_is_off_once_it_is_open() -> None:
    bench = Bench("feetech", torque_on_by_goal=True)
    bench.opened()
    assert not bench.servo.is_on
