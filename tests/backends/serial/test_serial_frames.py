"""The wire format: what is sent arrives, and nothing that was damaged does."""

import struct

import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from rig.backends.serial import frames
from rig.backends.serial.frames import (
    Block,
    Code,
    DeviceState,
    FrameReader,
    Hello,
    Kind,
    Nack,
    Packet,
    RelaySetup,
    Setup,
    StrokesSetup,
    crc16,
    encode,
)

u8, u16, u32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
i16, i32 = (st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (16, 32))

# positions of a block: the first anywhere, the others as far from it as 16 bits say
rows = st.builds(
    lambda first, away, drives: tuple((first + far, u) for far, u in zip([0, *away], drives, strict=False)),
    st.integers(-(2**31), 2**31 - 1),
    st.lists(i16, min_size=frames.BLOCK_ROWS - 1, max_size=frames.BLOCK_ROWS - 1),
    st.lists(i16, max_size=frames.BLOCK_ROWS),
)

bodies = st.one_of(
    st.builds(DeviceState, u32, i32, u16, u32, i16, u16, u8, u8, u32),
    st.builds(Setup, u32, i32, i32, i32, i32, i32, u16, u16, st.sampled_from((-1, 1)), u8),
    st.builds(Hello, u8, u8, u8, u8, u32, u16, u32, u8, st.binary(min_size=16, max_size=16)),
    st.builds(Nack, u8, u8),
    st.builds(RelaySetup, st.tuples(i16, i16, i16, i16), i32, u32, st.sampled_from((-1, 1)), u8),
    st.builds(Block, u32, u16, u16, u8, u8, u32, rows),
)
Body = DeviceState | Setup | Hello | Nack | RelaySetup | Block
KIND_OF: dict[type[Body], Kind] = {
    DeviceState: Kind.STATE,
    Setup: Kind.SETUP_REPLY,
    Hello: Kind.HELLO_REPLY,
    Nack: Kind.NACK,
    RelaySetup: Kind.RELAY_REPLY,
    Block: Kind.BLOCK,
}

# One message of each kind, with zeros, ones and ordinary bytes in them.
MESSAGES = [
    Packet(Kind.HELLO, 1, b""),
    Packet(Kind.SETUP, 2, Setup(0x01000001, 49, 974, 5, 1018, 512, 200, 100, -1).pack()),
    Packet(Kind.ARM, 0x0100, frames.pack_arm(0x01000001)),
    Packet(Kind.ACK, 3, frames.pack_ack(Code.E_STOP)),
    Packet(Kind.READ, 0xFFFF, b""),
    Packet(Kind.DRIVE, 258, frames.pack_drive(-256)),
    Packet(Kind.STOP, 0, b""),
    Packet(Kind.HELLO_REPLY, 7, Hello(2, 1, 2, 0, 1023, 799, 0x00FF00FF, 0, b"2f3a9c1".ljust(16, b"\0")).pack()),
    Packet(Kind.SETUP_REPLY, 8, Setup(2**32 - 1, -(2**31), 2**31 - 1, 0, 1023, -512, 799, 1000, 1).pack()),
    Packet(Kind.ARM_REPLY, 9, bytes([Code.SENSOR_RAIL])),
    Packet(Kind.STATE, 10, DeviceState(123456789, 517, frames.NO_TACHOMETER, 123450000, -133, 9, 1, 0, 7).pack()),
    Packet(Kind.STATE, 11, DeviceState(0, 0, 0, 0, 0, 0, 0, 0, 0).pack()),
    Packet(Kind.STATE, 12, DeviceState(2**32 - 1, -1, 0xFFFF, 2**32 - 1, -1, 0xFFFF, 0xFF, 0xFF, 2**32 - 1).pack()),
    Packet(Kind.STOP_REPLY, 13, DeviceState(1, 512, 0xFFFF, 1, 0, 9, 2, Code.TRAVEL, 0).pack()),
    Packet(Kind.NACK, 14, Nack(Code.NO_SETUP, Kind.ARM).pack()),
    Packet(Kind.RELAY, 15, RelaySetup((-213, 53, -53, 213), 512 * 16, 5_000_000, 1, 10).pack()),
    Packet(Kind.KEEP, 16, b""),
    Packet(Kind.STROKES, 17, StrokesSetup(((80, 600), (-90, -(2**31))) * 4, 2000, 300, 5, 10).pack()),
    Packet(Kind.STROKES_REPLY, 17, StrokesSetup(((-1, 2**31 - 1), (32767, 0)), 1, 10_000, 65535, 1).pack()),
    Packet(Kind.RELAY_REPLY, 15, RelaySetup((-213, 53, -53, 213), 512 * 16, 5_000_000, -1, 10).pack()),
    Packet(Kind.BLOCK, 0, Block(10**6, 1000, 24, 9, 0, 3, ((512, -213), (0, 53), (1023, 0)) * 3 + ((1, 1),)).pack()),
    Packet(Kind.BLOCK, 0xFFFF, Block(0, 1000, 0, 2, Code.TRAVEL, 0, ()).pack()),
]
FIRST, LAST = Packet(Kind.READ, 41, b""), Packet(Kind.STOP, 43, b"")


def wire(packet: Packet) -> bytes:
    return encode(packet.kind, packet.seq, packet.body)


def test_crc_is_ibm_3740() -> None:
    assert crc16(b"123456789") == 0x29B1


def test_a_frame_byte_by_byte() -> None:
    """READ with seq 0x0201, stuffed by hand: the packet is 02 04 01 02 and its CRC."""
    packet = bytes([2, 4, 1, 2])
    crc = struct.pack("<H", crc16(packet))
    assert 0 not in crc
    assert encode(Kind.READ, 0x0201) == bytes([7]) + packet + crc + b"\0"


def test_strokes_come_back_as_they_were_and_no_more_than_fit() -> None:
    setup = StrokesSetup(((80, 600), (-90, -(2**31))), 2000, 300, 5, 10)
    assert StrokesSetup.unpack(setup.pack()) == setup
    assert setup.pack()[8:14] == bytes([80, 0, 0x58, 2, 0, 0]) and setup.pack()[20:] == bytes(36)
    with pytest.raises(ValueError, match="at most 8 strokes, not 9"):
        setup._replace(strokes=((1, 2),) * 9).pack()


def test_body_sizes_are_those_of_the_protocol() -> None:
    sizes = {Kind(kind).name: size for kind, size in frames.BODY_LENGTH.items()}
    assert sizes == {
        "HELLO": 0, "SETUP": 30, "ARM": 4, "READ": 0, "ACK": 1, "ACK_REPLY": 24, "DRIVE": 2, "STOP": 0,
        "HELLO_REPLY": 31, "SETUP_REPLY": 30, "ARM_REPLY": 1, "STATE": 24, "STOP_REPLY": 24, "NACK": 2,
        "RELAY": 18, "KEEP": 0, "RELAY_REPLY": 18, "STROKES": 56, "STROKES_REPLY": 56, "ZERO": 4, "ZERO_REPLY": 24,
        "LOOPBACK": 1, "LOOPBACK_REPLY": 35, "PULSE": 4,
    }  # fmt: skip
    full = Block(0, 0, 0, 0, 0, 0, ((0, 0),) * frames.BLOCK_ROWS)
    assert len(full.pack()) == frames.MAX_BODY == 58 and len(encode(Kind.BLOCK, 0, full.pack())) == 66


@pytest.mark.parametrize("length", [0, 17, 19, 20, 21, 55, 56, 57])
def test_a_block_of_an_impossible_length_is_damaged(length: int) -> None:
    reader = FrameReader()
    assert reader.feed(encode(Kind.BLOCK, 3, bytes(length))) == []
    assert reader.bad_frames == 1


@given(body=bodies, seq=u16)
def test_every_body_survives_the_wire(body: Body, seq: int) -> None:
    kind = KIND_OF[type(body)]
    frame = encode(kind, seq, body.pack())
    assert frame.count(0) == 1 and frame.endswith(b"\0")
    (packet,) = FrameReader().feed(frame)
    assert packet == Packet(kind, seq, body.pack(), frames.VERSION)
    assert type(body).unpack(packet.body) == body


@given(units=i16)
def test_drive_survives(units: int) -> None:
    assert int.from_bytes(frames.pack_drive(units), "little", signed=True) == units


@given(
    kind=st.integers(0, 255),
    seq=u16,
    body=st.binary(max_size=frames.MAX_BODY),
    version=st.integers(0, 255).filter(lambda v: v != frames.VERSION),
)
def test_packets_of_another_version_are_delivered_as_such(kind: int, seq: int, body: bytes, version: int) -> None:
    """So that the driver can say which version the device speaks."""
    assert FrameReader().feed(encode(kind, seq, body, version)) == [Packet(kind, seq, body, version)]


@given(packets=st.lists(st.sampled_from(MESSAGES), max_size=6), data=st.data())
def test_chunks_do_not_matter(packets: list[Packet], data: st.DataObject) -> None:
    stream = b"".join(map(wire, packets))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    reader = FrameReader()
    received = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        received += reader.feed(stream[start:end])
    assert received == packets
    assert reader.bad_frames == 0


@given(body=bodies, seq=u16, data=st.data())
def test_any_flipped_bit_of_a_packet_is_detected(body: Body, seq: int, data: st.DataObject) -> None:
    packet = bytearray(cobs.decode(encode(KIND_OF[type(body)], seq, body.pack())[:-1]))
    bit = data.draw(st.integers(0, 8 * len(packet) - 1))
    packet[bit // 8] ^= 1 << bit % 8
    reader = FrameReader()
    assert reader.feed(cobs.encode(bytes(packet)) + b"\0") == []
    assert reader.bad_frames == 1


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: f"{Kind(m.kind).name}-{m.seq}")
def test_any_flipped_bit_on_the_wire_is_detected(message: Packet) -> None:
    """Stuffing bytes and the delimiter included: the damaged frame never arrives, its neighbours do."""
    frame = wire(message)
    for bit in range(8 * len(frame)):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        reader = FrameReader()
        received = reader.feed(wire(FIRST) + bytes(damaged) + wire(LAST) + wire(LAST))
        lost_delimiter = bit // 8 == len(frame) - 1  # costs the next frame too
        assert received == [FIRST, LAST] if lost_delimiter else [FIRST, LAST, LAST]
        assert reader.bad_frames >= 1


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: f"{Kind(m.kind).name}-{m.seq}")
def test_every_truncation_is_detected(message: Packet) -> None:
    frame = wire(message)
    for length in range(1, len(frame) - 1):
        for part in (frame[:length], frame[-1 - length : -1]):  # tail lost, head lost
            reader = FrameReader()
            assert reader.feed(part + b"\0" + wire(LAST)) == [LAST]
            assert reader.bad_frames == 1


@given(garbage=st.binary(max_size=300))
def test_in_step_again_after_garbage(garbage: bytes) -> None:
    reader = FrameReader()
    reader.feed(garbage)
    assert reader.feed(b"\0" + wire(LAST))[-1] == LAST


def test_an_endless_frame_is_dropped_once_and_not_kept() -> None:
    reader = FrameReader()
    for _ in range(1000):
        assert reader.feed(b"\x55" * 100) == []
    assert reader.bad_frames == 1
    assert len(reader._pending) < 100
    assert reader.feed(b"\x55\0" + wire(LAST)) == [LAST]
    assert reader.bad_frames == 1


def test_a_wrong_body_length_with_a_right_crc_is_dropped() -> None:
    reader = FrameReader()
    assert reader.feed(encode(Kind.STATE, 5, bytes(17)) + encode(Kind.STATE, 6, bytes(19))) == []
    assert reader.bad_frames == 2


def test_the_largest_packet_and_one_byte_more() -> None:
    largest = bytes(range(1, frames.MAX_BODY + 1))
    assert FrameReader().feed(encode(0x70, 1, largest)) == [Packet(0x70, 1, largest)]
    with pytest.raises(ValueError, match=f"at most {frames.MAX_BODY}"):
        encode(0x70, 1, largest + b"x")
    too_long = struct.pack("<BBH", 1, 0x70, 1) + largest + b"x"
    reader = FrameReader()
    assert reader.feed(cobs.encode(too_long + struct.pack("<H", crc16(too_long))) + b"\0") == []
    assert reader.bad_frames == 1


def test_words_for_people() -> None:
    assert frames.code_name(6) == "code 6 (travel)"
    assert frames.code_name(77) == "code 77 (unknown)"
    hello = Hello(2, 5, 0, 0, 1023, 799, 0, 0, b"abc\xff".ljust(16, b"\0"))
    assert hello.reset_words == "power-on, brown-out"
    assert hello._replace(reset_cause=0).reset_words == "unknown"
    assert hello.build_text == "abc\\xff"
    assert hello._replace(build=b"\x1b[2Jrig\n".ljust(16, b"\0")).build_text == "\\x1b[2Jrig\\n"
