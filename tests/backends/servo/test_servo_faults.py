"""Whatever happens to a servo that drives: a fault by its name within two ticks, and duty 0."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from evidence import evidence
from servo_bench import PERIOD_S, PROTOCOLS, Bench

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.bus import Ask
from rig.backends.servo.emulated.faults import ReplyFault

PHASES, BATCH = 201, 50
TICKS = 3  # the tick under way, and two more


def heat(bench: Bench) -> None:
    bench.servo.temperature_degC = bench.setup.hot_degC + 1.0


def weak(bench: Bench) -> None:
    bench.servo.supply(0.7 * bench.setup.supply_V)


def strong(bench: Bench) -> None:
    bench.servo.supply(1.3 * bench.setup.supply_V)


def restart(bench: Bench) -> None:
    bench.servo.power_cycle()
    bench.servo._awake_s = 0.0  # at once: else it does not answer, which is told as such


def torque_off(bench: Bench) -> None:
    bench.servo._set("torque", 0)


def protects(bench: Bench) -> None:
    real = bench.servo._target
    bench.servo._target = lambda: 0.2 * real()  # type: ignore[method-assign]  # of this one


def alert(bench: Bench) -> None:
    bench.bus.bus.reply_fault = ReplyFault("alert", servo=bench.own.id)


def gone(bench: Bench) -> None:
    bench.bus.unplug()


def mute(bench: Bench) -> None:
    bench.servo.is_mute = True


def another_id(bench: Bench) -> None:
    bench.bus.bus.reply_fault = ReplyFault("id", servo=bench.own.id, id=9)


def short(bench: Bench) -> None:
    bench.bus.bus.reply_fault = ReplyFault("short", servo=bench.own.id)


CASES: list[tuple[Callable[[Bench], None], set[str]]] = [
    (heat, {"SERVO_HOT"}),
    (weak, {"SERVO_SUPPLY"}),
    (strong, {"SERVO_SUPPLY"}),
    (alert, {"SERVO_ERROR", "SERVO_HOT"}),
    (restart, {"DEVICE_RESET"}),
    (torque_off, {"DEVICE_RESET"}),
    (protects, {"SERVO_OVERLOAD"}),
    (gone, {"LINK_LOST"}),
    (mute, {"LINK_TIMEOUT"}),
    (another_id, {"LINK_UNIT"}),
    (short, {"LINK_REPLY"}),
]


def happens_at(phase: int, protocol: str, happens: Callable[[Bench], None], codes: set[str]) -> None:
    """At a phase of the tick, behind its reading or behind its drive, after some of them; phase 0: behind a tick."""
    rng, bench = random.Random(phase), Bench(protocol)
    bench.armed()
    for _ in range(rng.randrange(2, 20) if phase else 6):
        bench.tick(0.8)
    ticks = TICKS
    if phase % 3:
        begins_s = bench.bus.now_s()
        bench.driver.read()
        if phase % 3 == 1:
            bench.driver.write(0.8)
        bench.bus.sleep_until(begins_s + rng.uniform(0.2, 0.9) * PERIOD_S)
    happens(bench)
    if phase % 3:
        bench.bus.sleep_until(begins_s + PERIOD_S)
        ticks -= 1  # this one was under way
    fault = bench.fault_within(ticks, 0.8)
    assert fault is not None and fault.code in codes, (phase, fault)
    bench.driver.safe_stop()
    if happens in (gone, mute):  # the servo's own watchdog is what is left, where it has one
        return
    bench.bus.bus.reply_fault = None
    assert bench.driver.safe_stop(), phase
    assert bench.servo.truth().duty == 0.0 and not bench.servo.is_on
    assert bench.wrong() == []


@pytest.mark.parametrize("first", [0, *evidence(*range(1, PHASES, BATCH))])
@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(("happens", "codes"), CASES)
def test_it_is_a_fault_by_its_name_within_two_ticks(
    protocol: str, happens: Callable[[Bench], None], codes: set[str], first: int
) -> None:
    for phase in range(first, first + BATCH) if first else (0,):
        happens_at(phase, protocol, happens, codes)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_an_alert_in_an_answer_ends_the_run(protocol: str) -> None:
    bench = Bench(protocol)
    bench.armed()
    for _ in range(3):
        bench.tick(0.3)
    alert(bench)
    fault = bench.fault_within(TICKS, 0.3)
    assert fault is not None and fault.code == {"dynamixel": "SERVO_ERROR", "feetech": "SERVO_HOT"}[protocol]
    bench.driver.safe_stop()
    assert bench.servo.truth().duty == 0.0


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("answers", [1, 99])
def test_an_alert_that_the_servos_register_denies_is_believed_the_second_time(
    protocol: str, answers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(protocol)
    bench.armed()
    bench.tick(0.3)
    left, expected = iter([0x80] * answers), bench.driver._bus.expected

    def damaged(data: bytes, request: Ask) -> bytes | None:
        pdu = expected(data, request)
        return pdu and bytes((pdu[0] | next(left, 0), *pdu[1:]))

    monkeypatch.setattr(bench.driver._bus, "expected", damaged)
    fault = bench.fault_within(5, 0.3)
    assert (fault is None) if answers == 1 else (fault is not None and fault.code == "SERVO_ERROR")


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_what_is_quickly_seen_to_be_the_reply_is_the_reply(protocol: str) -> None:
    """As the codec sees it: damaged, longer, shorter but as long on the wire, of another servo, or an echo."""
    bus, codec = Bench(protocol).driver._bus, dynamixel if protocol == "dynamixel" else feetech
    ask, rng = bus.reading(60, 4, "four"), random.Random(1)
    sound, shorter = codec.status(bus.id, b"\x01\xff\xff\xfe"), codec.status(bus.id, b"\xff\xff\xfd")
    assert (whole := bus.take(sound, ask)) is not None and bus.expected(sound, ask) == whole.pdu
    others = [shorter, sound + b"\0", codec.status(bus.id + 1, bytes(4)), codec.status(bus.id, bytes(4), 0x20)]
    others += [bytes(byte ^ (rng.random() < 0.1) << rng.randrange(8) for byte in sound) for _ in range(300)]
    for data in others:
        if (seen := bus.expected(data, ask)) is not None:  # one damaged packet of a Feetech in 256 passes
            assert (frame := bus.take(data, ask)) and frame.pdu == seen and seen[0] == 0 and len(seen) == 5
    two = bus.reading(2, 2, "two")
    assert bus.expected(two.data, two) is None and bus.take(two.data, two) is None and bus.echoes
    assert bus.expected(sound, ask) is None  # its echo comes first


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_one_damaged_reading_of_heat_is_no_fault(protocol: str) -> None:
    bench = Bench(protocol)
    bench.armed()
    bench.tick(0.3)
    heat(bench)
    bench.tick(0.3)
    bench.servo.temperature_degC = 25.0
    assert bench.fault_within(5, 0.3) is None


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_somebody_who_switches_the_torque_on_in_a_pause_ends_the_run(protocol: str) -> None:
    bench = Bench(protocol)
    bench.armed()
    bench.tick(0.3)
    assert bench.driver.safe_stop()
    bench.driver.read()
    bench.servo._set("torque", 1)
    with pytest.raises(Exception, match="SECOND_MASTER"):
        bench.driver.read()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_restart_in_a_pause_is_found_when_it_is_armed_again(protocol: str) -> None:
    bench = Bench(protocol)
    bench.armed()
    bench.tick(0.3)
    assert bench.driver.safe_stop()
    restart(bench)
    with pytest.raises(Exception, match="DEVICE_RESET"):
        bench.driver.arm(bench.limits)
    assert not bench.servo.is_on and bench.wrong() == []


@pytest.mark.parametrize("brakes", [True, False])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_stop_brakes_to_rest_before_the_torque_goes_off_unless_it_is_to_coast(protocol: str, brakes: bool) -> None:
    bench = Bench(protocol, setup={"brakes": brakes})
    bench.armed()
    for _ in range(8):
        bench.tick(bench.limits.max_u_V)
    speed = abs(bench.servo.truth().v_rad_per_s)
    seen: list[float] = []
    real = bench.servo._set

    def put(name: str, value: int) -> None:
        real(name, value)

    torque = bench.servo.model.role("torque")
    bench.servo.on_output = None
    watched = bench.bus.write

    def write(data: bytes) -> None:
        ask = bench.driver._bus.writing(torque.address, bytes((0,)), "")
        if data == ask.data and not seen:
            seen.append(abs(bench.servo.truth().v_rad_per_s))
        watched(data)

    bench.bus.write = write  # type: ignore[method-assign]  # of this bus alone
    assert bench.driver.safe_stop() and put is not None
    assert speed > 0.5
    assert (seen[0] < 0.02 * speed) == brakes
    assert not bench.servo.is_on
