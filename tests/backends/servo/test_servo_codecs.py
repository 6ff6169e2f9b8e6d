"""Packets of both servo protocols: against the makers' own bytes and packages, and against damage."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import further_requests
import pytest
from dynamixel_sdk import Protocol2PacketHandler
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scservo_sdk import protocol_packet_handler
from servo_peers import VirtualPort

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.dynamixel import Frame, Instruction, Status
from rig.backends.servo.emulated.bus import LineTimes
from rig.backends.servo.emulated.servo import ServoOptions
from rig.backends.servo.emulated.virtual_bus import VirtualServoBus
from rig.backends.servo.packets import Skipped

# e-Manual, "Protocol 2.0": the examples of its instructions
MANUAL = {
    "ping": (dynamixel.ping(1), "FF FF FD 00 01 03 00 01 19 4E"),
    "ping all": (dynamixel.ping(), "FF FF FD 00 FE 03 00 01 31 42"),
    "read": (dynamixel.read(1, 132, 4), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    "write": (dynamixel.write(1, 116, b"\x00\x02\x00\x00"), "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
    "reg write": (
        further_requests.reg_write(dynamixel, 1, 104, b"\xc8\x00\x00\x00"),
        "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E",
    ),
    "action": (further_requests.action(dynamixel, 1), "FF FF FD 00 01 03 00 05 02 CE"),
    "factory reset": (further_requests.factory_reset(1, "id"), "FF FF FD 00 01 04 00 06 01 A1 E6"),
    "reboot": (dynamixel.reboot(1), "FF FF FD 00 01 03 00 08 2F 4E"),
    "clear": (further_requests.clear_turns(1), "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC"),
    "sync read": (
        further_requests.sync_read(dynamixel, 132, 4, [1, 2]),
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
    ),
    "sync write": (
        further_requests.sync_write(dynamixel, 116, {1: b"\x96\x00\x00\x00", 2: b"\xaa\x00\x00\x00"}),
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
    ),
    "bulk read": (
        further_requests.bulk_read({1: (144, 2), 2: (146, 1)}),
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
    ),
    "bulk write": (
        further_requests.bulk_write({1: (32, b"\xa0\x00"), 2: (31, b"\x50")}),
        "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68",
    ),
    "status of a ping": (dynamixel.status(1, b"\x06\x04\x26"), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
    "status of a read": (dynamixel.status(1, b"\xa6\x00\x00\x00"), "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
    "status of a write": (dynamixel.status(1), "FF FF FD 00 01 04 00 55 00 A1 0C"),
}


@pytest.mark.parametrize("name", MANUAL)
def test_the_manuals_bytes(name: str) -> None:
    ours, manual = MANUAL[name]
    assert ours == bytes.fromhex(manual)
    (frame,) = dynamixel.Stream().feed(ours)
    assert isinstance(frame, Frame) and frame.encode() == ours


def test_feetech_by_hand() -> None:
    """id, length, code, parameters: the sum of these and the last byte is 255, modulo 256."""
    assert feetech.write(1, 44, b"\x32\x04") == bytes.fromhex("FF FF 01 05 03 2C 32 04 94")
    assert feetech.ping(1) == bytes.fromhex("FF FF 01 02 01 FB")
    assert further_requests.sync_read(feetech, 56, 15, [1, 2]) == bytes.fromhex("FF FF FE 06 82 38 0F 01 02 2F")


def test_signs_are_magnitude_and_bit() -> None:
    assert feetech.magnitude(-300, 10) == 300 | 1 << 10
    assert feetech.magnitude(1023, 10) == 1023
    assert feetech.signed(300 | 1 << 10, 10) == -300
    assert feetech.signed(1 << 15, 15) == 0  # minus nothing
    for value, bit in ((1024, 10), (-1024, 10), (2048, 11)):
        with pytest.raises(ValueError, match="does not fit"):
            feetech.magnitude(value, bit)
    with pytest.raises(ValueError, match="above its sign"):
        feetech.signed(1 << 11, 10)


BYTES = st.binary(max_size=40) | st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55]), max_size=40).map(bytes)


@settings(max_examples=examples(300), deadline=None)
@given(st.integers(0, 252), st.integers(0, 255), BYTES, BYTES, BYTES)
@pytest.mark.parametrize("codec", [dynamixel, feetech])
def test_a_packet_is_found_in_any_junk(
    codec: Any, id: int, code: int, parameters: bytes, before: bytes, after: bytes
) -> None:
    """The header's bytes in it are no header; bytes before and after are told, none is lost."""
    frame = codec.Frame(id, code, parameters)
    wire = frame.encode()
    stream = codec.Stream()
    taken = [t for byte in before + wire + after for t in stream.feed(bytes((byte,)))] + stream.flush()
    assert b"".join(t.data if isinstance(t, Skipped) else t.encode() for t in taken) == before + wire + after
    if not any(b in before for b in (0xFF, 0xFD)):  # else the junk may look like the beginning of a packet
        assert frame in taken


@pytest.mark.parametrize("codec", [dynamixel, feetech])
def test_damage_is_never_another_packet(codec: Any) -> None:
    """One byte changed in the body: Feetech's check sum, and a CRC of course, find all of these."""
    wire = codec.write(1, 100, bytes(range(1, 9)))
    for at in range(4 if codec is feetech else 7, len(wire)):
        for flip in (1, 0x80, 0xFF):
            damaged = wire[:at] + bytes((wire[at] ^ flip,)) + wire[at + 1 :]
            stream = codec.Stream()
            taken = stream.feed(damaged) + stream.flush()
            assert taken and all(isinstance(t, Skipped) for t in taken)


@pytest.mark.parametrize("codec", [dynamixel, feetech])
def test_behind_a_damaged_length_the_next_packet_is_found(codec: Any) -> None:
    good = codec.ping(7)
    damaged = bytearray(codec.read(1, 60, 4))
    damaged[5 if codec is dynamixel else 3] = 200
    stream = codec.Stream()
    assert stream.feed(bytes(damaged) + good) == []  # it may still become one
    taken = stream.flush()
    assert [t for t in taken if not isinstance(t, Skipped)] == [codec.Frame(7, codec.Instruction.PING)]
    assert stream.pending == b""


def test_a_header_that_is_not_stuffed_is_none() -> None:
    """Protocol 2.0 forbids it inside a packet, whatever its CRC says."""
    body = b"\xff\xff\xfd\x00\x01\x08\x00\x03\x64\x00\xff\xff\xfd"
    wire = body + dynamixel.crc16(body).to_bytes(2, "little")
    stream = dynamixel.Stream()
    assert all(isinstance(t, Skipped) for t in stream.feed(wire) + stream.flush())
    good = dynamixel.write(1, 100, b"\xff\xff\xfd")
    assert good[10:14] == b"\xff\xff\xfd\xfd" and dynamixel.Stream().feed(good) == [
        Frame(1, Instruction.WRITE, b"\x64\x00\xff\xff\xfd")
    ]


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: dynamixel.read(254, 0, 1), "id 254"),
        (lambda: dynamixel.write(253, 0, b"\0"), "id 253"),
        (lambda: dynamixel.read(1, 65_536, 1), "address"),
        (lambda: dynamixel.write(1, 0, bytes(2000)), "1024 at most"),
        (lambda: dynamixel.fast_status([]), "no servo"),
        (lambda: dynamixel.status(1, error=128), "error 128"),
        (lambda: dynamixel.status_of(Frame(1, 3)), "no answer"),
        (lambda: dynamixel.status_of(Frame(1, 0x55)), "error byte"),
        (lambda: feetech.read(254, 0, 1), "id 254"),
        (lambda: feetech.write(1, 256, b"\0"), "address"),
        (lambda: feetech.write(1, 0, bytes(300)), "250 at most"),
        (lambda: feetech.status_of(feetech.Frame(254, 0)), "id 254"),
    ],
)
def test_what_cannot_be_said(call: Any, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        call()


def test_fast_answers() -> None:
    statuses = [Status(1, 0, False, b"\xa6\x00\x00\x00"), Status(2, 0, True, b"\xff\xff\xfd\x00")]
    wire = dynamixel.fast_status(statuses)
    assert wire[5:7] == (1 + 2 * 8).to_bytes(2, "little")
    (frame,) = dynamixel.Stream().feed(wire)
    assert isinstance(frame, Frame)
    assert further_requests.fast_statuses(frame, {1: 4, 2: 4}) == statuses


def test_feetech_errors_in_words() -> None:
    status = feetech.status_of(feetech.Frame(1, feetech.OVERLOAD | feetech.HEAT | 0x40, b""))
    assert status.words == ["it is too hot", "it is overloaded", "error bit 6"]


# ---------------------------------------------------------------------- the makers' packages


def test_dynamixels_crc_is_theirs() -> None:
    draw = random.Random(1)
    theirs = Protocol2PacketHandler()
    for length in range(0, 200, 7):
        data = draw.randbytes(length)
        assert dynamixel.crc16(data) == theirs.updateCRC(0, data, length)


@pytest.mark.parametrize("parameters", [b"", b"\x01\xff\xff\xfd\x02", b"\xff\xff\xfd", b"\xff\xff\xfe\xfd"])
def test_dynamixels_stuffing_is_theirs(parameters: bytes) -> None:
    """Their function, as it returns; how their ``txPacket`` uses it is the next test's."""
    theirs = Protocol2PacketHandler()
    length = 3 + len(parameters)
    plain = [0xFF, 0xFF, 0xFD, 0, 1, length, 0, Instruction.WRITE, *parameters, 0, 0]
    stuffed = bytes(theirs.addStuffing(list(plain)))
    ours = Frame(1, Instruction.WRITE, parameters).encode()
    assert ours[:-2] == stuffed[: len(ours) - 2]
    back = bytes(theirs.removeStuffing(list(ours)))
    assert back[: len(plain) - 2] == bytes(plain[:-2])


class _Answering:
    """A port of dynamixel_sdk that answers these bytes."""

    def __init__(self, data: bytes) -> None:
        self._data, self.is_using = data, False

    def readPort(self, length: int) -> bytes:
        taken, self._data = self._data[:length], self._data[length:]
        return taken

    def isPacketTimeout(self) -> bool:
        return not self._data


@pytest.mark.parametrize("data", [b"", b"\x01\x02", b"\xff\xff\xfd\x00", bytes(range(100))])
def test_their_readers_take_our_answers(data: bytes) -> None:
    packet, result = Protocol2PacketHandler().rxPacket(_Answering(b"\x00" + dynamixel.status(5, data, 4)), False)
    assert result == 0 and bytes(packet[4:5] + packet[8:9]) == b"\x05\x04" and bytes(packet[9 : 9 + len(data)]) == data
    packet, result = protocol_packet_handler().rxPacket(_Answering(feetech.status(5, data, 4)))
    assert result == 0 and bytes(packet[2:3] + packet[4:5]) == b"\x05\x04" and bytes(packet[5:-1]) == data


def _sent_by_dynamixel_sdk() -> list[tuple[bytes, bytes]]:
    """What their functions send, and what ours makes of the same words."""
    port = VirtualPort(VirtualServoBus([ServoOptions(id=1)], line=LineTimes()))
    theirs = Protocol2PacketHandler()
    ours = []
    calls: list[tuple[Callable[[], Any], bytes]] = [
        (lambda: theirs.ping(port, 1), dynamixel.ping(1)),
        (lambda: theirs.read4ByteTxRx(port, 1, 132), dynamixel.read(1, 132, 4)),
        (lambda: theirs.write2ByteTxRx(port, 1, 100, 0xFF9C), dynamixel.write(1, 100, b"\x9c\xff")),
        (lambda: theirs.regWriteTxRx(port, 1, 65, 1, [1]), further_requests.reg_write(dynamixel, 1, 65, b"\x01")),
        (lambda: theirs.action(port, 1), further_requests.action(dynamixel, 1)),
        (lambda: theirs.reboot(port, 1), dynamixel.reboot(1)),
        (lambda: theirs.clearMultiTurn(port, 1), further_requests.clear_turns(1)),
        (lambda: theirs.factoryReset(port, 1, 2), further_requests.factory_reset(1, "id and baud")),
        (
            lambda: theirs.syncReadTx(port, 132, 4, [1, 2], 2, False),
            further_requests.sync_read(dynamixel, 132, 4, [1, 2]),
        ),
        (lambda: theirs.syncReadTx(port, 132, 4, [1, 2], 2, True), further_requests.fast_sync_read(132, 4, [1, 2])),
        (
            lambda: theirs.syncWriteTxOnly(port, 65, 1, [1, 0], 2),
            further_requests.sync_write(dynamixel, 65, {1: b"\x00"}),
        ),
        (lambda: theirs.bulkReadTx(port, [1, 132, 0, 4, 0], 5, False), further_requests.bulk_read({1: (132, 4)})),
        (lambda: theirs.bulkReadTx(port, [1, 132, 0, 4, 0], 5, True), further_requests.fast_bulk_read({1: (132, 4)})),
        (lambda: theirs.bulkWriteTxOnly(port, [1, 65, 0, 1, 0, 1], 6), further_requests.bulk_write({1: (65, b"\x01")})),
    ]
    for call, wire in calls:
        port.is_using = False
        call()
        ours.append((port.sent[-1], wire))
    return ours


def test_dynamixel_sdk_sends_what_we_send() -> None:
    for theirs, ours in _sent_by_dynamixel_sdk():
        assert theirs == ours


def test_dynamixel_sdk_does_not_stuff_what_it_sends() -> None:
    """A defect of its Python package (4.1.0): it drops what ``addStuffing`` returns. Our servo takes no such packet."""
    bus = VirtualServoBus([ServoOptions(id=1)])
    port = VirtualPort(bus)
    result, _ = Protocol2PacketHandler().writeTxRx(port, 1, 112, 4, [0xFF, 0xFF, 0xFD, 0x00])
    assert result != 0 and b"\xff\xff\xfd\xfd" not in port.sent[-1]
    assert bus.bus.log == [] and bus.bus.damaged > 0
