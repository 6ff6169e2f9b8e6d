"""What is fed to the codecs of servo packets, and to the emulated buses: any bytes, and packets of any content."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.emulated.bus import ServoBus
from rig.backends.servo.emulated.servo import ServoOptions
from rig.backends.servo.packets import Skipped

_SERVOS = {
    dynamixel: (ServoOptions(id=1, registers={"return_delay_time": 0}), ServoOptions(model="xl430-w250", id=2)),
    feetech: (ServoOptions(model="sts3215", id=1), ServoOptions(model="sts3250", id=2)),
}
_FAST = (dynamixel.Instruction.FAST_SYNC_READ, dynamixel.Instruction.FAST_BULK_READ)
_PAUSES_S = (0.0, 1e-5, 1e-3, 0.02)


def _pieces(data: bytes) -> Iterator[tuple[int, bytes]]:
    """``data`` cut as it says itself: a byte of kind, a byte of length, so many bytes, and again."""
    at = 0
    while at + 2 <= len(data):
        yield data[at], data[at + 2 : at + 2 + data[at + 1]]
        at += 2 + data[at + 1]


def _wire(codec: Any, kind: int, piece: bytes) -> bytes:
    """Kinds from 128 on as they are, the others as an intact packet: id, instruction, parameters."""
    if kind >= 128 or len(piece) < 2:
        return piece
    try:
        encoded: bytes = codec.Frame(piece[0], piece[1], piece[2:]).encode()
    except ValueError:  # an id that is none
        return piece
    return encoded


def packets(data: bytes) -> None:
    """Whatever arrives: each byte is in a packet or skipped, the packets are the same however it was cut."""
    for codec in (dynamixel, feetech):
        raw = b"".join(_wire(codec, kind, piece) for kind, piece in _pieces(data))
        whole, step = _taken(codec, [raw]), 1 + len(data) % 7
        cut = _taken(codec, [raw[at : at + step] for at in range(0, len(raw), step)])
        assert _bytes(whole) == raw == _bytes(cut)
        frames = [taken for taken in whole if not isinstance(taken, Skipped)]
        assert frames == [taken for taken in cut if not isinstance(taken, Skipped)]
        for frame in frames:
            try:
                codec.status_of(frame)
            except ValueError:
                pass
            except AttributeError:
                assert codec is feetech  # its packets are none of the other protocol's


def _taken(codec: Any, cut: list[bytes]) -> list[Any]:
    stream = codec.Stream()
    return [*itertools.chain.from_iterable(map(stream.feed, cut)), *stream.flush()]


def _bytes(taken: list[Any]) -> bytes:
    return b"".join(t.data if isinstance(t, Skipped) else t.encode() for t in taken)


def buses(data: bytes) -> None:
    """Whatever a host sends: no error; what comes back are whole packets, unless the host spoke in between.

    The one answer to a fast read ends where a servo that it names is missing: that is none.
    """
    for codec, servos in _SERVOS.items():
        bus = ServoBus(servos)
        t_s = 0.001
        said = b""
        for kind, piece in _pieces(data):
            bus.send(_wire(codec, kind, piece), t_s)
            t_s += _PAUSES_S[kind % 4]
            bus.advance_to(t_s)
            said += bus.receive(t_s)
        bus.advance_to(t_s + 0.05)
        said += bus.receive(t_s + 0.05)
        if bus.collisions == 0 and not any(getattr(frame, "instruction", 0) in _FAST for _, frame in bus.log):
            assert not any(isinstance(taken, Skipped) for taken in _taken(codec, [said])), said.hex()


def seeds() -> Iterator[bytes]:
    """Each instruction, in packets that servos obey, and some of them after each other."""
    word = (64).to_bytes(2, "little")
    one = [
        (dynamixel.Instruction.PING, b""),
        (dynamixel.Instruction.READ, b"\x78\x00\x1b\x00"),
        (dynamixel.Instruction.WRITE, b"\x64\x00\x20\x00"),
        (dynamixel.Instruction.REG_WRITE, word + b"\x01"),
        (dynamixel.Instruction.ACTION, b""),
        (dynamixel.Instruction.REBOOT, b""),
        (dynamixel.Instruction.CLEAR, b"\x01\x44\x58\x4c\x22"),
        (dynamixel.Instruction.FACTORY_RESET, b"\x02"),
        (dynamixel.Instruction.SYNC_READ, b"\x84\x00\x04\x00\x01\x02"),
        (dynamixel.Instruction.SYNC_WRITE, b"\x64\x00\x02\x00\x01\x05\x00\x02\x05\x00"),
        (dynamixel.Instruction.BULK_READ, b"\x01\x84\x00\x04\x00\x02\x92\x00\x01\x00"),
        (dynamixel.Instruction.BULK_WRITE, b"\x01\x64\x00\x02\x00\x05\x00"),
        (dynamixel.Instruction.FAST_SYNC_READ, b"\x84\x00\x04\x00\x01\x02"),
        (dynamixel.Instruction.FAST_BULK_READ, b"\x01\x84\x00\x04\x00\x02\x92\x00\x01\x00"),
        (feetech.Instruction.READ, b"\x38\x0f"),
        (feetech.Instruction.WRITE, b"\x21\x02"),
        (feetech.Instruction.WRITE, b"\x28\x80"),
        (feetech.Instruction.SYNC_WRITE, b"\x2c\x02\x01\x10\x04\x02\x10\x04"),
        (feetech.Instruction.SYNC_READ, b"\x38\x02\x01\x02"),
    ]
    for id in (1, dynamixel.BROADCAST):
        yield from (_piece(2, bytes((id, code)) + parameters) for code, parameters in one)
    yield b"".join(_piece(k % 4, bytes((1, code)) + parameters) for k, (code, parameters) in enumerate(one))
    yield _piece(130, dynamixel.ping(1)[:-1]) + _piece(2, b"\x01\x01") + _piece(131, b"\xff\xff\xfd\x00\x01\xff\x03")


def _piece(kind: int, data: bytes) -> bytes:
    return bytes((kind, len(data))) + data
