"""The emulated Modbus I/O block by itself: the bench behind its registers, the protocol, and its safety rules."""

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
    ECHO,
    HIGH,
    LOW,
    MAX_DRIVE,
    POSITION,
    RAIL_LOW,
    SEQUENCE,
    SETTINGS,
    STATUS,
    WATCHDOG,
    armed_block,
    emulated,
    modbus,
    read,
    read_write,
    state,
    words,
    write,
    write_one,
)
from pymodbus.client.mixin import ModbusClientMixin

from rig.backends.emulated.bench_of_config import bench_parameters
from rig.backends.emulated.errors import EmulationError
from rig.backends.modbus.emulated.io_block import ExecutedDrive, IoBlock
from rig.model.bench import BenchModel

WATCHDOG_FAULT, TRAVEL, SENSOR, DRIVE_RANGE, NOT_ARMED = 2, 3, 4, 5, 6


def exception(function: int, code: int) -> bytes:
    return bytes((function | 0x80, code))


# ------------------------------------------------------------------ the bench behind it


def test_the_motor_moves_as_the_bench_does_under_the_drives_that_were_written() -> None:
    plain = emulated(fc_plus_V=0.5, fc_minus_V=0.45, fs_plus_V=0.6, fs_minus_V=0.5, bias_V=0.02)
    outputs: list[tuple[float, float]] = []
    block = armed_block(bench=plain, on_output=lambda t_s, u_V: outputs.append((t_s, u_V)))
    bench = BenchModel(bench_parameters(plain), 1)
    draw, t_s, then_s, u_V = random.Random(5), 0.0, 0.0, 0.0
    for _ in range(300):
        t_s += draw.uniform(0.0005, 0.02)
        units = draw.randrange(-1500, 1500) if abs(block.truth().y_rad) < 1.0 else 0
        block.request(write_one(DRIVE, units), t_s)
        bench.pin_counts = u_V / 12.0 * bench.parameters.drive_counts
        bench.advance(t_s - then_s)
        truth = block.truth()
        assert truth.y_rad == pytest.approx(bench.state.y, abs=1e-9)
        assert truth.v_rad_per_s == pytest.approx(bench.state.v, abs=1e-9)
        then_s, u_V = t_s, truth.output_V
        assert truth.output_V == pytest.approx(units / 10000 * 12.0)
    assert [t for t, _ in outputs] == sorted(t for t, _ in outputs) and len(outputs) > 200


def test_one_exchange_writes_the_drive_and_then_reads() -> None:
    executed: list[ExecutedDrive] = []
    block = armed_block(on_drive=executed.append)
    assert words(block.request(read_write(POSITION, 4, DRIVE, 1000, 7), 0.010)) == [512, 7, 1000, 1]
    block.advance_to(0.060)
    counts = round(512 + block.truth().y_rad * 1024 / 4.2)
    assert counts > 512
    assert words(block.request(read_write(POSITION, 4, DRIVE, -200, 8), 0.060)) == [counts, 8, -200, 1]
    assert executed == [(0.010, 1000.0, True), (0.060, -200.0, True)]


def test_wiring_faults_begin_after_the_arming_and_reach_the_position_register() -> None:
    block = armed_block(bench=emulated({"sensor": "broken_high", "fault_after_s": 0.05}))
    assert words(block.request(read(POSITION, 1), 0.049)) == [512]
    assert words(block.request(read(POSITION, 4), 0.051)) == [1023, 0, 0, SENSOR]


@pytest.mark.parametrize("order", ["high-first", "low-first"])
@pytest.mark.parametrize("kind", ["int16", "int32", "float32"])
def test_drive_applied_and_largest_drive_are_of_the_drive_s_type_and_order(kind: str, order: str) -> None:
    data_type = ModbusClientMixin.DATATYPE[kind.upper()]
    plain = modbus(
        {
            "drive": {"address": 40, "type": kind, "full": 20000},
            "sequence": {"address": 42},
            "applied": {"address": 20, "type": kind},
            "max_drive": {"address": 50},
        },
        word_order=order,
    )
    pymodbus_order: Any = {"high-first": "big", "low-first": "little"}[order]
    block = IoBlock.of(plain, emulated(), 1)

    def packed(value: float) -> list[int]:
        return ModbusClientMixin.convert_to_registers(value, data_type, pymodbus_order)

    n = len(packed(0))
    block.request(write(WATCHDOG, *SETTINGS[:3]), 0.0)
    block.request(write(RAIL_LOW, *SETTINGS[4:]), 0.0)
    assert block.request(write(50, *packed(15000)), 0.0)[0] == 16
    block.request(write_one(CONTROL, 1), 0.0)
    for value in (12345, -4321, 0):
        block.request(write(40, *packed(value)), 0.0)
        got = [word & 0xFFFF for word in words(block.request(read(20, n), 0.0))]
        assert ModbusClientMixin.convert_from_registers(got, data_type, pymodbus_order) == value
        assert block.truth().output_V == pytest.approx(12.0 * value / 20000)
    block.request(write(40, *packed(15001)), 0.001)
    assert words(block.request(read(STATUS, 1), 0.001)) == [DRIVE_RANGE]


@pytest.mark.parametrize("order", ["high-first", "low-first"])
@pytest.mark.parametrize("kind", ["int16", "uint16", "int32", "uint32", "float32"])
def test_the_position_is_of_its_type_scaled(kind: str, order: str) -> None:
    plain = modbus(
        {
            "position": {"address": 30, "type": kind, "scale": 0.5, "offset_counts": -10.0},
            "limits": None,
            "rails": None,
        },
        word_order=order,
    )
    block = IoBlock.of(plain, emulated(), 1)
    block.place(0.3)
    pymodbus_order: Any = {"high-first": "big", "low-first": "little"}[order]
    data_type = ModbusClientMixin.DATATYPE[kind.upper()]
    got = words(block.request(read(30, data_type.value[1]), 0.0))
    value = ModbusClientMixin.convert_from_registers([w & 0xFFFF for w in got], data_type, pymodbus_order)
    assert value == (round(512 + 0.3 * 1024 / 4.2) + 10) / 0.5


def test_input_registers_are_read_by_fc04_alone() -> None:
    block = IoBlock.of(modbus({"position": {"table": "input"}}, requests="separate"), emulated(), 1)
    assert words(block.request(read(POSITION, 4, function=4), 0.0)) == [512, 0, 0, 0]
    assert block.request(read(POSITION, 1), 0.0) == exception(3, 2)
    assert words(block.request(read(DRIVE, 2), 0.0)) == [0, 0]
    assert block.request(read(DRIVE, 1, function=4), 0.0) == exception(4, 2)


def test_a_register_that_cannot_hold_what_it_is_for_is_refused() -> None:
    with pytest.raises(EmulationError, match=r"position runs from 0 to 102300, which uint16 cannot hold"):
        IoBlock.of(modbus({"position": {"scale": 0.01}}), emulated(), 1)
    wide = {"drive": {"address": 40, "type": "int32", "full": 100_000}, "sequence": {"address": 42}}
    with pytest.raises(EmulationError, match="applied runs from -100000 to 100000, which int16 cannot hold"):
        IoBlock.of(modbus(wide), emulated(), 1)


# ------------------------------------------------------------------ the protocol


def test_what_was_written_reads_back_and_what_is_between_reads_0() -> None:
    block = IoBlock.of(modbus(), emulated(), 1)
    assert block.request(write(WATCHDOG, *SETTINGS), 0.0) == struct.pack(">BHH", 16, WATCHDOG, 6)
    assert words(block.request(read(0, 20), 0.0)) == [0] * 9 + [*SETTINGS, 0, 512, 0, 0, 0]


REQUESTS = {
    "unknown function": (b"\x07", 1),
    "function above 127": (b"\x90\x00", 1),
    "reserved function 0": (b"\x00", 1),
    "no data": (b"\x03", 3),
    "a byte too many": (read(16, 4) + b"\0", 3),
    "0 registers": (read(16, 0), 3),
    "126 registers": (read(16, 126), 3),
    "before the first": (read(65535, 1), 2),
    "beyond the last": (read(16, 5), 2),
    "no input registers": (read(16, 1, function=4), 2),
    "written too short": (b"\x06\x00\x00\x00", 3),
    "written to nothing": (write_one(3, 1), 2),
    "written to what is read": (write_one(POSITION, 1), 2),
    "byte count wrong": (struct.pack(">BHHBHH", 16, 0, 2, 3, 1, 1), 3),
    "fewer words than said": (struct.pack(">BHHBH", 16, 0, 2, 4, 1), 3),
    "124 registers written": (write(0, *([0] * 124)), 3),
    "across a gap": (write(0, 0, 0, 0), 2),
    "122 registers written in one": (read_write(16, 4, 0, *([0] * 122)), 3),
    "reads nothing": (read_write(16, 0, 0, 0, 0), 3),
    "reads beyond, writes well": (read_write(17, 4, 0, 5, 6), 2),
    "writes beyond, reads well": (read_write(16, 4, 20, 5), 2),
    "control value unknown": (write_one(CONTROL, 2), 3),
    "watchdog of 0": (write_one(WATCHDOG, 0), 3),
    "watchdog of 20 s": (write_one(WATCHDOG, 20000), 3),
    "largest drive of 0": (write_one(MAX_DRIVE, 0), 3),
    "largest drive beyond full": (write_one(MAX_DRIVE, 10001), 3),
    "armed before it has its settings": (write_one(CONTROL, 1), 4),
    "another interface": (b"\x2b\x0d\x00", 1),
    "identification of no kind": (b"\x2b\x0e\x05\x00", 3),
    "identification cut short": (b"\x2b\x0e\x01", 3),
    "no such object": (b"\x2b\x0e\x04\x03", 2),
}


@pytest.mark.parametrize("name", REQUESTS)
def test_bad_requests_get_their_exception_and_change_nothing(name: str) -> None:
    request, code = REQUESTS[name]
    block = IoBlock.of(modbus(), emulated(), 1)
    before = block.request(read(0, 20), 0.0)
    assert block.request(request, 0.0) == exception(request[0], code)
    assert block.request(read(0, 20), 0.0) == before


def test_one_bad_value_of_several_and_nothing_is_written() -> None:
    block = IoBlock.of(modbus(), emulated(), 1)
    block.request(write(WATCHDOG, *SETTINGS), 0.0)
    assert block.request(write(WATCHDOG, 200, 60, 900, 0, 5, 1018), 0.0) == exception(16, 3)
    assert words(block.request(read(WATCHDOG, 6), 0.0)) == list(SETTINGS)


def test_half_of_a_32_bit_drive_is_not_written() -> None:
    plain = modbus({"drive": {"type": "float32", "full": 1.0, "address": 30}, "sequence": None, "applied": None})
    block = IoBlock.of(plain, emulated(), 1)
    assert block.request(write_one(30, 0x3F80), 0.0) == exception(6, 2)
    assert block.request(write(31, 1), 0.0) == exception(16, 2)


@pytest.mark.parametrize("drive", [float("nan"), float("inf"), -float("inf")])
def test_a_drive_that_is_no_number_is_refused(drive: float) -> None:
    plain = modbus(
        {
            "drive": {"type": "float32", "full": 1.0, "address": 30},
            "sequence": None,
            "max_drive": None,
            "applied": {"address": 20, "type": "float32"},
        }
    )
    block = IoBlock.of(plain, emulated(), 1)
    block.request(write(WATCHDOG, *SETTINGS[:3]), 0.0)
    block.request(write(RAIL_LOW, *SETTINGS[4:]), 0.0)
    block.request(write_one(CONTROL, 1), 0.0)
    half = struct.unpack(">2H", struct.pack(">f", 0.5))
    assert block.request(write(30, *half), 0.0)[0] == 16
    bad = struct.unpack(">2H", struct.pack(">f", drive))
    assert block.request(write(30, *bad), 0.0) == exception(16, 3)
    assert block.truth().output_V == 6.0


def test_it_says_who_it_is() -> None:
    block = IoBlock.of(modbus(), emulated(), 1, revision="1.2")
    objects = b"\x00\x03rig\x01\x12emulated I/O block\x02\x031.2"
    assert block.request(b"\x2b\x0e\x01\x00", 0.0) == b"\x2b\x0e\x01\x81\x00\x00\x03" + objects
    assert block.request(b"\x2b\x0e\x03\x02", 0.0) == b"\x2b\x0e\x03\x81\x00\x00\x01\x02\x031.2"
    assert block.request(b"\x2b\x0e\x02\x09", 0.0) == b"\x2b\x0e\x02\x81\x00\x00\x03" + objects
    assert block.request(b"\x2b\x0e\x04\x01", 0.0) == b"\x2b\x0e\x04\x81\x00\x00\x01\x01\x12emulated I/O block"


@settings(max_examples=examples(300), deadline=None)
@given(pdus=st.lists(st.binary(min_size=1, max_size=253), min_size=1, max_size=8))
def test_any_bytes_at_all_are_answered_and_move_nothing(pdus: list[bytes]) -> None:
    block = IoBlock.of(modbus(), emulated(), 1)
    for k, pdu in enumerate(pdus):
        reply = block.request(pdu, 0.01 * k)
        good = reply[0] == pdu[0] and pdu[0] in (3, 4, 6, 16, 23, 43)
        assert good or (reply[0] == pdu[0] | 0x80 and reply[1] in (1, 2, 3, 4) and len(reply) == 2)
        assert len(reply) <= 253
    assert block.truth().output_V == 0.0 and not block.armed


WORD = st.integers(0, 0xFFFF)
NEAR = st.one_of(st.integers(0, 21), WORD)
WELL_FORMED = st.one_of(
    st.builds(read, NEAR, st.integers(0, 130), st.sampled_from([3, 4])),
    st.builds(write_one, NEAR, st.one_of(st.integers(0, 1200), WORD)),
    st.builds(lambda address, data: write(address, *data), NEAR, st.lists(WORD, max_size=8)),
    st.builds(
        lambda at, n, address, data: read_write(at, n, address, *data),
        NEAR,
        st.integers(0, 10),
        NEAR,
        st.lists(WORD, max_size=4),
    ),
)


@settings(max_examples=examples(300), deadline=None)
@given(pdus=st.lists(st.tuples(WELL_FORMED, st.floats(0.0, 0.05)), min_size=1, max_size=20))
def test_whatever_is_asked_of_an_armed_block_its_output_stays_within_the_largest_drive(
    pdus: list[tuple[bytes, float]],
) -> None:
    outputs: list[float] = []
    block = armed_block(on_output=lambda t_s, u_V: outputs.append(u_V))
    t_s, largest = 0.0, 2500
    for pdu, pause_s in pdus:
        t_s += pause_s
        block.request(pdu, t_s)
        largest = max(largest, words(block.request(read(MAX_DRIVE, 1), t_s))[0])
        assert block.armed or block.truth().output_V == 0.0
    assert all(abs(u_V) <= 12.0 * largest / 10000 for u_V in outputs)


# ------------------------------------------------------------------ safety


def test_power_on_is_off_and_a_drive_is_refused_until_it_is_armed() -> None:
    block = IoBlock.of(modbus(), emulated(), 1)
    assert words(block.request(read_write(POSITION, 4, DRIVE, 100, 1), 0.0)) == [512, 0, 0, NOT_ARMED]
    assert block.truth().output_V == 0.0
    block.request(write(WATCHDOG, *SETTINGS), 0.0)
    block.request(write_one(CONTROL, 1), 0.0)
    assert words(block.request(read_write(POSITION, 4, DRIVE, 100, 2), 0.0)) == [512, 2, 100, 1]
    block.request(write_one(CONTROL, 0), 0.01)
    assert state(block, 0.01) == (0, 0)


def test_silence_of_drive_writes_ends_the_drive_at_the_watchdog_s_tick_though_reads_go_on() -> None:
    outputs: list[tuple[float, float]] = []
    block = armed_block(on_output=lambda t_s, u_V: outputs.append((t_s, u_V)))
    block.request(write_one(DRIVE, 500), 0.0302)
    for k in range(31, 140):
        block.request(read(POSITION, 4), 0.001 * k)
    assert outputs == [(0.0302, pytest.approx(0.6)), (pytest.approx(0.131), 0.0)]  # the first tick 100 ms after
    assert state(block, 0.14) == (0, WATCHDOG_FAULT)
    block.request(write_one(DRIVE, 500), 0.15)
    assert state(block, 0.15) == (0, WATCHDOG_FAULT)  # latched
    block.request(write_one(CONTROL, 1), 0.16)
    block.request(write_one(DRIVE, 500), 0.16)
    assert state(block, 0.16) == (500, 1)


def test_at_rest_any_request_keeps_it_armed_and_silence_disarms_it() -> None:
    block = armed_block()
    for k in range(1, 40):
        assert state(block, 0.09 * k) == (0, 1)
    assert state(block, 0.09 * 39 + 0.101) == (0, WATCHDOG_FAULT)


@pytest.mark.parametrize("sign", [1, -1])
def test_beyond_a_limit_it_stops_latches_and_lets_the_shaft_come_back_inward(sign: int) -> None:
    block = armed_block()
    t_s, limit = 0.0, 975 if sign > 0 else 49
    while block.armed:
        t_s += 0.01
        block.request(write_one(DRIVE, sign * 100), t_s)
        assert t_s < 4.0
    counts = round(512 + block.truth().y_rad * 1024 / 4.2)
    assert state(block, t_s) == (0, TRAVEL)
    assert sign * (counts - limit) >= -1
    block.advance_to(t_s := t_s + 1.0)

    block.request(write_one(CONTROL, 1), t_s)
    assert state(block, t_s) == (0, 1) and block.truth().recovering == sign
    block.request(write_one(DRIVE, sign * 300), t_s)  # outward
    assert state(block, t_s) == (0, TRAVEL)
    block.request(write_one(CONTROL, 1), t_s)
    while block.truth().recovering != 0:
        t_s += 0.01
        block.request(write_one(DRIVE, -sign * 500), t_s)
        assert state(block, t_s) == (-sign * 500, 1)
    assert sign * (round(512 + block.truth().y_rad * 1024 / 4.2) - limit) <= -3
    block.request(write_one(DRIVE, sign * 300), t_s)
    assert state(block, t_s) == (sign * 300, 1)


def test_inward_drive_that_moves_the_shaft_outward_is_stopped() -> None:
    bench = emulated({"drive": "reversed", "fault_after_s": 0.0}, start_rad=1.91)
    y_rad: list[float] = []
    block = armed_block(bench=bench)
    block.on_output = lambda t_s, u_V: y_rad.append(block.truth().y_rad)
    assert block.truth().recovering == 1
    t_s = 0.0
    while block.armed:
        t_s += 0.01
        block.request(write_one(DRIVE, -100), t_s)
    assert block.truth().fault == "DEVICE_TRAVEL"
    # a 32nd of the range is let pass, to a count of the sensor
    lsb_rad = 4.2 / 1024
    assert y_rad[-1] == pytest.approx(1.91 + (975 - 49) / 32 * lsb_rad, abs=1.5 * lsb_rad)


def test_inward_is_as_whoever_set_it_up_found() -> None:
    bench = emulated({"drive": "reversed"}, start_rad=2.0)
    block = armed_block(bench=bench, polarity=-1)
    block.request(write_one(DRIVE, 500), 0.01)
    assert state(block, 0.01) == (500, 1)
    block.advance_to(0.05)
    assert block.truth().y_rad < 2.0


@pytest.mark.parametrize("wiring", ["broken_low", "broken_high"])
def test_a_sensor_at_its_rail_stops_the_drive_within_a_millisecond_and_forbids_arming(wiring: str) -> None:
    block = armed_block()
    block.request(write_one(DRIVE, 500), 0.0102)
    block.rewire(sensor=wiring, fault_after_s=0.0)
    block.advance_to(0.011)
    assert state(block, 0.011) == (0, SENSOR)
    block.request(write_one(CONTROL, 1), 0.02)
    assert state(block, 0.02) == (0, SENSOR) and not block.armed


@pytest.mark.parametrize("units", [2501, -2501, 32767, -32768])
def test_more_than_the_largest_drive_stops_and_latches(units: int) -> None:
    block = armed_block()
    block.request(write_one(DRIVE, 2500), 0.01)
    assert state(block, 0.01) == (2500, 1)
    block.request(write_one(DRIVE, units), 0.02)
    assert state(block, 0.02) == (0, DRIVE_RANGE)


def test_limits_do_not_change_while_it_is_armed() -> None:
    block = armed_block()
    assert block.request(write(LOW, 1, 1022), 0.01) == exception(16, 4)
    assert words(block.request(read(LOW, 2), 0.01)) == [49, 975]
    block.request(write_one(CONTROL, 0), 0.01)
    assert block.request(write(LOW, 1, 1022), 0.01)[0] == 16


@pytest.mark.parametrize(("address", "low", "high", "fault"), [(LOW, 600, 400, TRAVEL), (RAIL_LOW, 600, 400, SENSOR)])
def test_bounds_that_are_no_interval_forbid_arming(address: int, low: int, high: int, fault: int) -> None:
    block = armed_block()
    block.request(write_one(CONTROL, 0), 0.0)
    block.request(write(address, low, high), 0.0)
    block.request(write_one(CONTROL, 1), 0.0)
    assert state(block, 0.0) == (0, fault)


def test_arming_again_starts_from_0_V() -> None:
    block = armed_block()
    block.request(write_one(DRIVE, 700), 0.01)
    block.request(write_one(CONTROL, 1), 0.02)
    assert state(block, 0.02) == (0, 1)


def test_stop_and_a_drive_in_one_request_is_a_stop() -> None:
    plain = modbus({"control": {"address": 2}})
    block = IoBlock.of(plain, emulated(), 1)
    block.request(write(WATCHDOG, *SETTINGS), 0.0)
    block.request(write_one(2, 1), 0.0)
    block.request(write(DRIVE, 700, 1), 0.0)
    assert state(block, 0.0) == (700, 1)
    block.request(write(DRIVE, 700, 2, 0), 0.01)
    assert state(block, 0.01) == (0, NOT_ARMED)
    assert words(block.request(read(ECHO, 1), 0.01)) == [1]  # the second was not executed


def test_without_a_status_register_a_refused_drive_is_an_exception() -> None:
    block = IoBlock.of(modbus({"status": None}), emulated(), 1)
    assert block.request(write_one(DRIVE, 100), 0.0) == exception(6, 4)
    assert block.request(write_one(DRIVE, 0), 0.0) == write_one(DRIVE, 0)
    assert words(block.request(read_write(POSITION, 3, DRIVE, 0, 5), 0.0)) == [512, 5, 0]


def test_without_a_control_register_a_drive_arms_it_and_0_clears_a_fault() -> None:
    block = IoBlock.of(modbus({"control": None}), emulated(), 1)
    block.request(write_one(DRIVE, 100), 0.0)
    assert state(block, 0.0) == (0, NOT_ARMED)  # it has no settings yet
    block.request(write(WATCHDOG, *SETTINGS), 0.0)
    block.request(write_one(DRIVE, 100), 0.5)
    assert state(block, 0.5) == (100, 1)
    assert state(block, 0.61) == (0, WATCHDOG_FAULT)
    block.request(write_one(DRIVE, 100), 0.62)
    assert state(block, 0.62) == (0, WATCHDOG_FAULT)
    block.request(write_one(DRIVE, 0), 0.63)
    assert state(block, 0.63) == (0, 1)
    block.request(write_one(DRIVE, 100), 5.0)  # at 0 V its silence is nothing to stop for
    assert state(block, 5.0) == (100, 1)


def test_a_time_out_that_no_register_sets_is_kept_and_without_any_it_holds_its_drive() -> None:
    bare = dict.fromkeys(("watchdog", "limits", "rails", "max_drive", "control"))
    block = IoBlock.of(modbus(bare, device_watchdog_s=0.25), emulated(), 1)
    block.request(write_one(DRIVE, 10), 0.0)
    block.advance_to(0.2495)
    assert block.truth().output_V == 0.012
    block.advance_to(0.2505)
    assert block.truth().fault == "DEVICE_WATCHDOG" and block.truth().output_V == 0.0
    block = IoBlock.of(modbus(bare), emulated(), 1)
    block.request(write_one(DRIVE, 10), 0.0)
    block.advance_to(10.0)
    assert block.truth().output_V == 0.012


def test_faults_have_the_status_values_of_the_config_and_others_keep_clear_of_them() -> None:
    block = armed_block(modbus({"status": {"faults": {"DEVICE_DRIVE_RANGE": 2, "DEVICE_TRAVEL": 40}}}))
    assert set(block.registers.status_of) == {
        "DEVICE_WATCHDOG", "DEVICE_TRAVEL", "DEVICE_SENSOR", "DEVICE_DRIVE_RANGE", "DEVICE_NOT_ARMED",
        "DEVICE_ESTOP",
    }  # fmt: skip
    assert len(set(block.registers.status_of.values())) == 6 and min(block.registers.status_of.values()) == 2
    block.request(write_one(DRIVE, 2501), 0.0)
    assert state(block, 0.0) == (0, 2)


def test_one_address_is_read_alone_or_among_others() -> None:
    block = armed_block()
    block.request(write(DRIVE, 321, 9), 0.01)
    whole = words(block.request(read(0, 20), 0.01))
    assert [words(block.request(read(k, 1), 0.01))[0] for k in range(20)] == whole
    assert (whole[SEQUENCE], whole[ECHO], whole[APPLIED], whole[HIGH]) == (9, 9, 321, 975)
