"""The emulated I/O block on its RTU line in virtual time: framing, wire times, faults of device and line."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from modbus_device import (
    APPLIED,
    CONTROL,
    DRIVE,
    POSITION,
    SETTINGS,
    STATUS,
    WATCHDOG,
    Master,
    Mishap,
    emulated,
    modbus,
    read,
    read_write,
    words,
    write,
    write_one,
)
from pymodbus.client.mixin import ModbusClientMixin
from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest

from rig.backends.emulated.line_faults import Corruption
from rig.backends.modbus.emulated.reply_faults import ReplyFault
from rig.backends.modbus.emulated.rtu_slave import LineTimes, check_sum, frame
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.backends.modbus.section import Modbus
from rig.core.faults import Fault

TICK = read_write(POSITION, 4, DRIVE, 500, 1)


def device(plain: Modbus | None = None, **options: Any) -> VirtualIoBlock:
    return VirtualIoBlock(plain or modbus(), emulated(), **options)


def armed(**options: Any) -> tuple[VirtualIoBlock, Master]:
    it = device(**options)
    master = Master(it)
    master.arm()
    return it, master


# ------------------------------------------------------------------ framing


def test_frames_are_those_of_pymodbus() -> None:
    request = ReadHoldingRegistersRequest(dev_id=17, address=107, count=3)
    assert frame(17, read(107, 3)) == FramerRTU(DecodePDU(True)).buildFrame(request)
    assert check_sum(bytes.fromhex("1103006b0003")) == bytes.fromhex("7687")


def test_a_frame_in_parts_is_one_as_long_as_no_pause_is_its_silence() -> None:
    it = device()
    whole = frame(1, read(POSITION, 1))
    it.write(whole[:3])
    it.sleep_until(it.line.wire_s(3) + it.line.silence_s - 1e-6)
    it.write(whole[3:])
    assert it.read(0.1) == frame(1, b"\x03\x02" + struct.pack(">H", 512))


def test_a_pause_as_long_as_its_silence_breaks_a_frame() -> None:
    it = device()
    whole = frame(1, read(POSITION, 1))
    it.write(whole[:3])
    it.sleep_until(it.line.wire_s(3) + it.line.silence_s + 1e-6)
    it.write(whole[3:])
    assert it.read(0.1) == b""
    assert it.requests == {"executed": 0, "damaged": 2, "foreign": 0}


def test_two_requests_without_silence_between_are_none() -> None:
    it = device()
    it.write(frame(1, read(POSITION, 1)) + frame(1, read(STATUS, 1)))
    assert it.read(0.1) == b""
    it.write(frame(1, read(POSITION, 1)))
    assert it.read(0.1) != b""


def test_every_damaged_bit_of_a_request_leaves_it_unanswered_and_unexecuted() -> None:
    it, _ = armed()
    whole = frame(1, TICK)
    for bit in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        it.write(bytes(damaged))
        assert it.read(0.01) == b""
    assert it.executed == [] and it.requests["damaged"] == 8 * len(whole)


def test_another_unit_s_request_is_ignored_and_a_broadcast_is_executed_in_silence() -> None:
    it, master = armed()
    it.write(frame(2, TICK))
    assert it.read(0.02) == b"" and it.executed == []
    it.write(frame(0, TICK))
    assert it.read(0.02) == b"" and [drive.value for drive in it.executed] == [500.0]
    assert words(master.ask(read(APPLIED, 2))) == [500, 1]


def test_its_unit_id_is_the_config_s() -> None:
    it = device(modbus(unit=247))
    assert Master(it, 1).ask(read(POSITION, 1)) == b""
    assert words(Master(it, 247).ask(read(POSITION, 1))) == [512]


@settings(max_examples=examples(150), deadline=None)
@given(sent=st.lists(st.tuples(st.binary(max_size=300), st.floats(0.0, 0.01)), max_size=8))
def test_noise_on_the_line_moves_nothing_and_the_next_request_is_answered(sent: list[tuple[bytes, float]]) -> None:
    it = device()
    for data, pause_s in sent:
        it.write(data)
        it.read(pause_s)
    it.sleep_until(it.now_s() + 1.0)
    it.read(0.0)
    assert words(Master(it).ask(read(POSITION, 1))) == [512]
    assert it.outputs == [(0.0, 0.0)]


# ------------------------------------------------------------------ times


@pytest.mark.parametrize(
    ("changed", "baud", "bits", "silence_s"),
    [
        ({}, 115200, 10, 0.00175),
        ({}, 9600, 10, 3.5 * 10 / 9600),
        ({}, 19200, 10, 3.5 * 10 / 19200),
        ({"parity": "even"}, 115200, 11, 0.00175),
        ({"stop_bits": 2}, 38400, 11, 0.00175),
        ({"parity": "odd", "stop_bits": 2}, 9600, 12, 3.5 * 12 / 9600),
        ({"silence_s": 0.0004, "turnaround_s": 0.0}, 1_000_000, 10, 0.0004),
    ],
)
def test_a_reply_is_there_after_wire_silence_turnaround_and_wire(
    changed: dict[str, Any], baud: int, bits: int, silence_s: float
) -> None:
    plain = modbus(**changed)
    it = device(plain, baud=baud)
    it.sleep_until(0.123)
    request = frame(1, read_write(POSITION, 4, DRIVE, 0, 7))
    it.write(request)
    reply = it.read(1.0)
    assert (len(request), len(reply)) == (17, 13)
    executed_s = 0.123 + 17 * bits / baud + silence_s
    assert it.executed[0].t_s == pytest.approx(executed_s, abs=1e-12)
    assert it.now_s() == pytest.approx(executed_s + plain.turnaround_s + 13 * bits / baud, abs=1e-12)
    assert it.line == LineTimes(baud, bits, it.line.silence_s, plain.turnaround_s)
    assert it.line.silence_s == pytest.approx(silence_s)


def test_reading_waits_no_longer_than_it_was_told_and_then_finds_the_late_reply() -> None:
    it = device()
    it.write(frame(1, read(POSITION, 1)))
    assert it.read(0.001) == b"" and it.now_s() == 0.001
    assert it.read(0.0) == b"" and it.now_s() == 0.001
    it.sleep_until(0.5)
    assert len(it.read(0.0)) == 7 and it.now_s() == 0.5
    it.sleep_until(0.4)
    assert it.now_s() == 0.5


def test_the_drive_of_a_silent_host_ends_in_virtual_time_too() -> None:
    it, master = armed()
    master.ask(TICK)
    it.sleep_until(it.now_s() + 1.0)
    (_, zero), (on_s, on_V), (off_s, off_V) = it.outputs
    assert (zero, off_V) == (0.0, 0.0) and on_V == pytest.approx(0.6)
    assert 0.1 <= off_s - on_s < 0.101


def test_an_unplugged_device_is_a_lost_link() -> None:
    it = device()
    it.unplug()
    with pytest.raises(Fault, match="unplugged"):
        it.write(b"x")
    with pytest.raises(Fault, match="unplugged"):
        it.read(0.0)


def test_the_same_seed_gives_the_same_device() -> None:
    bench = emulated(potentiometer={"noise_rad": 0.02})

    def run(seed: int) -> list[bytes]:
        master = Master(VirtualIoBlock(modbus(), bench, seed))
        return [master.ask(read(POSITION, 1)) for _ in range(20)]

    assert run(3) == run(3) != run(4)


# ------------------------------------------------------------------ what may go wrong


def test_a_device_that_answers_late() -> None:
    it, master = armed()
    it.inject(ReplyFault("late", by_s=0.03, times=1))
    begin_s = it.now_s()
    assert words(master.ask(TICK))[2] == 500
    assert it.now_s() - 0.002 - begin_s == pytest.approx(30 * 10 / 115200 + 0.00175 + 0.0005 + 0.03)
    begin_s = it.now_s()
    master.ask(TICK)
    assert it.now_s() - 0.002 - begin_s == pytest.approx(30 * 10 / 115200 + 0.00175 + 0.0005)


def test_a_device_that_answers_with_an_exception_does_not_execute() -> None:
    it, master = armed()
    it.inject(ReplyFault("exception", code=6))
    assert master.ask(TICK) == b"\x97\x06"
    assert it.executed == [] and it.truth().output_V == 0.0


def test_a_device_that_answers_as_another_unit_executes() -> None:
    it, _ = armed()
    it.inject(ReplyFault("unit", unit=7))
    it.write(frame(1, TICK))
    assert it.read(0.1)[:2] == b"\x07\x17" and len(it.executed) == 1


@pytest.mark.parametrize("request_pdu", [TICK, read(POSITION, 2), write_one(DRIVE, 5), write(DRIVE, 5, 6)])
def test_a_device_that_answers_wrong_sends_a_sound_frame_that_does_not_fit(request_pdu: bytes) -> None:
    it, master = armed()
    right = master.ask(request_pdu)
    it.inject(ReplyFault("wrong"))
    wrong = master.ask(request_pdu)
    assert wrong[:1] == right[:1] and wrong != right
    assert len(wrong) == (len(right) - 2 if request_pdu[0] in (3, 23) else len(right))


def test_a_device_that_falls_silent_runs_into_its_own_watchdog() -> None:
    it, master = armed()
    begin_s = it.truth().t_s
    it.inject(ReplyFault("silent", after_s=0.2))
    answered = 0
    while master.ask(TICK, timeout_s=0.009):
        answered += 1
    assert it.truth().t_s - begin_s == pytest.approx(0.2, abs=0.02) and answered > 20
    for _ in range(20):
        assert master.ask(TICK, timeout_s=0.009) == b""
    assert it.truth().fault == "DEVICE_WATCHDOG" and it.outputs[-1][1] == 0.0


def test_misbehaviour_waits_for_the_first_arming() -> None:
    it = device(reply_fault=ReplyFault("silent"))
    master = Master(it)
    assert master.ask(write(WATCHDOG, *SETTINGS)) != b""
    assert master.ask(write_one(CONTROL, 1)) != b""
    assert master.ask(TICK) == b""


def test_the_line_loses_delays_and_doubles() -> None:
    it, master = armed()
    it.disturb(Mishap("request", delay_s=None))
    assert master.ask(TICK) == b"" and it.executed == []
    it.disturb(Mishap("request", delay_s=0.01))
    begin_s = it.now_s()
    master.ask(TICK)
    assert it.executed[-1].t_s - begin_s == pytest.approx(0.01 + 17 * 10 / 115200 + 0.00175)
    it.disturb(Mishap("request", copy_s=0.02))
    n = len(it.executed)
    master.ask(TICK)
    it.sleep_until(it.now_s() + 0.05)
    assert len(it.executed) == n + 2
    assert it.read(0.0) != b""  # the answer to the copy, which nobody waits for


def test_a_lost_reply_was_executed() -> None:
    it, master = armed()
    it.disturb(Mishap("reply", delay_s=None))
    assert master.ask(TICK) == b"" and [drive.value for drive in it.executed] == [500.0]
    assert master.ask(TICK) != b""


def test_a_minute_of_20_damaged_bytes_a_second_executes_no_drive_that_nobody_sent() -> None:
    corruption = Corruption(20.0, seed=11)
    it, _ = armed()
    it.disturb(corruption)
    draw, sent, answered = random.Random(2), set(), 0
    begin_s = it.now_s()
    while it.now_s() < begin_s + 60.0:
        drive = draw.randrange(-50, 51)
        sent.add(drive)
        it.write(frame(1, read_write(POSITION, 4, DRIVE, drive, draw.randrange(65536))))
        got = it.read(0.008)
        answered += got != b"" and check_sum(got[:-2]) == got[-2:]
        if not it.truth().armed:
            it.write(frame(1, write_one(CONTROL, 1)))
            it.read(0.01)
        it.sleep_until(it.now_s() + 0.003)
    assert corruption.done == pytest.approx(1200, abs=2)
    assert 0.5 < it.requests["damaged"] / 600 < 1.5 and answered > 4000
    assert {drive.value for drive in it.executed} <= sent
    assert {round(u_V / 12.0 * 10000) for _, u_V in it.outputs} <= sent | {0}


def test_damage_comes_at_its_rate_and_changes_one_byte() -> None:
    corruption, whole = Corruption(50.0, seed=3, after_s=1.0), bytes(range(40))
    changed = 0
    for k in range(1000):
        ((delay_s, got),) = corruption("reply" if k % 2 else "request", whole, 0.01 * k)
        assert delay_s == 0.0
        if got != whole:
            changed += 1
            assert abs(len(got) - 40) <= 1 and k >= 100
            if len(got) == 40:
                assert sum(a != b for a, b in zip(got, whole, strict=True)) == 1
    assert changed == corruption.done == pytest.approx(450, abs=1)


def test_the_position_follows_the_drive_over_the_line() -> None:
    it, master = armed()
    got = []
    for k in range(40):
        got.append(words(master.ask(read_write(POSITION, 4, DRIVE, 300, k)))[0])
    assert got == sorted(got) and got[0] == 512 and got[-1] > 540
    decoded = ModbusClientMixin.convert_from_registers([got[-1]], ModbusClientMixin.DATATYPE.UINT16)
    assert decoded == got[-1]
    assert abs(got[-1] - (512 + it.truth().y_rad * 1024 / 4.2)) < 3
