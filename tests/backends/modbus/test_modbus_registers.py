"""Registers and frames: what is packed comes back, by a peer's bytes too, and no bytes at all make the framing fail."""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.constants import ExcCodes
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest

from rig.backends.modbus.frames import Damaged, RtuFraming, TcpFraming
from rig.backends.modbus.opening import emulated_io_block, modbus_driver
from rig.backends.modbus.registers import Register, RegisterMap, RegisterSpan
from rig.backends.modbus.requests import _EXCEPTIONS
from rig.config import load
from rig.config.schema import Experiment

CONFIG = Path(__file__).resolve().parents[3] / "config" / "modbus-rtu.yaml"
FORMATS = {"int16": ">h", "uint16": ">H", "int32": ">i", "uint32": ">I", "float32": ">f"}
VALUES = {
    "int16": st.integers(-(2**15), 2**15 - 1),
    "uint16": st.integers(0, 2**16 - 1),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "float32": st.floats(width=32, allow_nan=False, allow_infinity=False),
}


@pytest.mark.parametrize("low_first", [False, True])
@pytest.mark.parametrize("kind", VALUES)
@given(data=st.data())
def test_every_type_comes_back_and_its_words_are_those_of_the_specification(
    kind: str, low_first: bool, data: st.DataObject
) -> None:
    """Big-endian words, the high one first unless the config says otherwise; packed here by ``struct``."""
    value = data.draw(VALUES[kind])
    register = Register("position", 7, kind, "holding", low_first)
    words = register.pack(value)
    assert register.unpack(words) == value
    packed = struct.pack(FORMATS[kind], value)
    by_hand = [int.from_bytes(packed[k : k + 2], "big") for k in range(0, len(packed), 2)]
    assert words == (by_hand[::-1] if low_first else by_hand)
    assert register.words == len(by_hand)


@pytest.mark.parametrize(
    ("kind", "value"),
    [("int16", 32768), ("int16", -32769), ("uint16", -1), ("uint16", 65536), ("int32", 2**31), ("uint32", -1),
     ("float32", 1e39), ("float32", float("nan")), ("int16", float("nan")), ("int32", float("inf"))],
)  # fmt: skip
def test_what_a_type_cannot_hold_is_refused_by_the_registers_name(kind: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"drive, holding register.* 3.*{kind}"):
        Register("drive", 3, kind).pack(value)


def test_a_span_reads_what_lies_beside_each_other_with_gaps() -> None:
    span = RegisterSpan((Register("a", 20, "float32"), Register("b", 16), Register("c", 24, "int16")))
    assert (span.address, span.words) == (16, 9)
    words = [0] * 9
    words[4:6] = Register("a", 0, "float32").pack(1.5)
    words[0], words[8] = 700, 65535
    assert span.values(words) == {"a": 1.5, "b": 700, "c": -1}
    assert str(span) == "a, holding registers 20 and 21 (with b 16, c 24)"


@given(units=st.integers(-10000, 10000))
def test_drive_units_and_register_values_go_both_ways(units: int) -> None:
    for kind, full in (("int16", 10000.0), ("float32", 1.0), ("float32", 100.0)):
        registers = RegisterMap(drive=Register("drive", 0, kind), position=Register("position", 1), full=full)
        value = registers.drive.unpack(registers.drive.pack(registers.drive_value(units)))
        assert registers.drive_units(value) == units
    with pytest.raises(ValueError, match="beyond the full duty"):
        registers.drive_units(101.0)
    with pytest.raises(ValueError, match="beyond the full duty"):
        registers.drive_units(float("nan"))


@given(data=st.binary(max_size=300))
def test_no_bytes_make_the_framing_fail(data: bytes) -> None:
    for framing in (RtuFraming(), TcpFraming()):
        try:
            frame = framing.take(data)
        except Damaged:
            continue
        if frame is not None:
            assert frame.length <= len(data)
            assert frame.pdu in data


@given(st.binary(min_size=2, max_size=20), st.data())
def test_rtu_takes_a_reply_only_whole_and_undamaged(values: bytes, data: st.DataObject) -> None:
    values = values[: len(values) // 2 * 2]
    body = bytes((3, 23, len(values))) + values
    whole = RtuFraming()._framer.encode(body[1:], 3, 0)
    assert whole[:-2] == body
    framing = RtuFraming()
    assert all(framing.take(whole[:n]) is None for n in range(len(whole)))
    taken = framing.take(whole)
    assert taken is not None
    assert (taken.unit, taken.pdu, taken.length) == (3, body[1:], len(whole))
    at, change = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(1, 255))
    damaged = whole[:at] + bytes((whole[at] ^ change,)) + whole[at + 1 :]
    with suppress(Damaged):
        assert framing.take(damaged) is None  # its byte count says that there is more


def test_tcp_frames_carry_number_and_unit() -> None:
    framing = TcpFraming()
    request = ReadHoldingRegistersRequest(address=16, count=4)
    assert framing.encode(request, 9, 0x1234).hex() == "123400000006090300100004"
    reply = bytes.fromhex("1234 0000 0005 09 03 02 0007".replace(" ", ""))
    taken = framing.take(reply + b"more")
    assert taken is not None
    assert (taken.unit, taken.number, taken.pdu, taken.length) == (9, 0x1234, bytes.fromhex("03020007"), 11)
    for k in range(len(reply)):
        assert framing.take(reply[:k]) is None
    with pytest.raises(Damaged, match="header"):
        framing.take(bytes.fromhex("1234 0001 0005 09 03 02 0007".replace(" ", "")))


@pytest.mark.parametrize("word_order", ["high-first", "low-first"])
@pytest.mark.parametrize(
    ("drive", "position", "applied"),
    [
        ({"type": "int16", "full": 10000}, {"type": "int16", "scale": 0.05, "offset_counts": 512.0}, "int16"),
        ({"type": "int32", "full": 2_000_000}, {"type": "uint32", "scale": 1e-5}, "int32"),
        ({"type": "float32", "full": 1.0}, {"type": "float32", "scale": -243.8, "offset_counts": 512.0}, "float32"),
        ({"type": "float32", "full": 100.0}, {"type": "uint16", "scale": 1.0}, "float32"),
    ],
)
@pytest.mark.parametrize("requests", ["read-write", "separate"])
def test_driver_and_device_agree_on_every_type_and_word_order(
    requests: str, drive: dict[str, object], position: dict[str, object], applied: str, word_order: str
) -> None:
    """The device packs by itself: neither side has the other's mistakes."""
    data = load(CONFIG).model_dump(mode="json", exclude_none=True)
    data["daq"]["port"] = "emulated"
    data["emulated"]["potentiometer"] |= {"noise_rad": 0.0, "offset_rad": 0.0}
    modbus = data["daq"]["modbus"] | {"word_order": word_order, "requests": requests}
    modbus["registers"] |= {
        "drive": {"address": 0} | drive,
        "sequence": {"address": 2 if drive["type"] != "int16" else 1, "echo": 22},
        "position": {"address": 20} | position,
        "applied": {"address": 24, "type": applied},
        "status": {"address": 23} | {"faults": modbus["registers"]["status"]["faults"]},
        "limits": {"low": 30, "high": 32},
        "rails": {"low": 34, "high": 36},
        "max_drive": {"address": 38},
    }
    data["daq"]["modbus"] = modbus
    experiment = Experiment.model_validate(data)
    block = emulated_io_block(experiment.device)
    driver = modbus_driver(experiment.device, block)
    driver.open()
    driver.arm(experiment.device.arming)
    for u_V, y_rad in ((0.6, 0.0), (-0.7, 1.0), (2.999, -1.0), (-2.999, 0.4), (0.0, -0.4)):
        for _ in range(3):
            block.place(y_rad)
            sample = driver.read()
            driver.write(u_V)
        sample = driver.read()
        assert sample.u_V == pytest.approx(u_V, abs=0.5 * 12.0 / 10000 + 1e-6)
        assert block.truth().output_V == pytest.approx(sample.u_V, abs=1e-5)
        assert sample.y_rad == pytest.approx(block.truth().y_rad, abs=0.02)
    assert driver.safe_stop()
    assert block.truth().output_V == 0.0


def test_each_exception_of_modbus_has_its_name() -> None:
    """By pymodbus's list; 7, the negative acknowledge, is of old controllers only."""
    known = {
        code.value: code.name.split("_")[0].lower() for code in ExcCodes if code is not ExcCodes.NEGATIVE_ACKNOWLEDGE
    }
    assert {number: words.split()[0] for number, words in _EXCEPTIONS.items()} == known
