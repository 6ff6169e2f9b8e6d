"""Feetech's protocol of STS and SMS servos: packets to bytes and back. Pure.

Sources: feetech-servo-sdk 1.0.0; Feetech's SCServo library (SMS_STS). A packet is FF FF, id, length, code, parameters,
check sum. The length counts code, parameters and check sum. The code is an instruction, or in an answer the error byte:
nothing else tells the two apart. The check sum is one byte: of 256 damaged packets one passes. Numbers come low byte
first; a signed one is its magnitude and a bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from rig.backends.servo.packets import BROADCAST as BROADCAST
from rig.backends.servo.packets import LAST_ID as LAST_ID
from rig.backends.servo.packets import Instruction as Instruction
from rig.backends.servo.packets import PacketStream, Requests, any_id, one_id, whole_packet
from rig.backends.servo.packets import Skipped as Skipped

LONGEST = 250  # bytes of a packet; feetech-servo-sdk sends and takes no longer one
SHORTEST = 6

_HEADER = b"\xff\xff"


VOLTAGE, SENSOR, HEAT, CURRENT, OVERLOAD = 0x01, 0x02, 0x04, 0x08, 0x20  # bits of a status's errors
ERRORS: Mapping[int, str] = {
    VOLTAGE: "its supply is out of range",
    SENSOR: "its position sensor fails",
    HEAT: "it is too hot",
    CURRENT: "its current is too large",
    OVERLOAD: "it is overloaded",
}


def check_sum(data: bytes) -> int:
    """Check sum of a packet's bytes from its id to its last parameter."""
    return ~sum(data) & 0xFF


class Frame(NamedTuple):
    """One packet without header, length and check sum.

    id    of the servo, 0 to 252, or BROADCAST
    code  instruction of a request, errors of an answer
    """

    id: int
    code: int
    parameters: bytes = b""

    def encode(self) -> bytes:
        """As it is on the wire. Raises ValueError for an id or a code out of range, or for too many bytes."""
        if not 0 <= self.code <= 0xFF:
            raise ValueError(f"code {self.code} is no byte")
        length = len(self.parameters) + 2
        if length + 4 > LONGEST:
            raise ValueError(f"{length + 4} bytes: a packet has {LONGEST} at most")
        body = bytes((any_id(self.id), length, self.code)) + self.parameters
        return _HEADER + body + bytes((check_sum(body),))


class Stream(PacketStream[Frame]):
    """Packets out of bytes as they arrive."""

    def __init__(self) -> None:
        super().__init__(_HEADER, _take)


def _take(data: bytes | bytearray, at: int) -> tuple[Frame, int] | str | None:
    """As ``packets.Take``."""
    packet = whole_packet(data, at, header=len(_HEADER), length_bytes=1, shortest=SHORTEST, longest=LONGEST)
    if not isinstance(packet, bytes):
        return packet
    body = body_of(packet)
    return body if isinstance(body, str) else (Frame(packet[2], body[0], body[1:]), len(packet))


def body_of(packet: bytes) -> bytes | str:
    """Code and parameters of a packet of the right length; or why it is damaged."""
    if check_sum(packet[2:-1]) != packet[-1]:
        return "check sum"
    return packet[4:-1]


# ---------------------------------------------------------------------- numbers


def magnitude(value: int, sign_bit: int) -> int:
    """A signed number as these servos hold it: its magnitude, and a bit where it is negative.

    Raises ValueError where the magnitude does not fit below that bit.
    """
    if abs(value) >= 1 << sign_bit:
        raise ValueError(f"{value} does not fit below bit {sign_bit}")
    return abs(value) | (1 << sign_bit if value < 0 else 0)


def signed(raw: int, sign_bit: int) -> int:
    """The number that ``magnitude`` made. Raises ValueError for bits above the sign, and for no number of bits."""
    if not 0 <= raw < 2 << sign_bit:
        raise ValueError(f"{raw} has bits above its sign, bit {sign_bit}")
    size = raw & ((1 << sign_bit) - 1)
    return -size if raw >> sign_bit else size


# ---------------------------------------------------------------------- requests


def _number(value: int) -> bytes:
    if not 0 <= value <= 0xFF:
        raise ValueError(f"{value} is no address or length: 0 to 255")
    return bytes((value,))


_requests = Requests(lambda id, code, parameters: Frame(id, code, parameters).encode(), _number)
ping, read, write, reboot = _requests.ping, _requests.read, _requests.write, _requests.reboot


# ---------------------------------------------------------------------- answers


class Status(NamedTuple):
    """What a servo answered.

    errors  bits of ERRORS; 0: none
    data    what was read
    """

    id: int
    errors: int
    data: bytes

    @property
    def words(self) -> list[str]:
        """Its errors, in words; a bit that nobody has named by its number."""
        return [ERRORS.get(1 << bit, f"error bit {bit}") for bit in range(8) if self.errors >> bit & 1]


def status(id: int, data: bytes = b"", errors: int = 0) -> bytes:
    """A servo's answer as it is on the wire."""
    return Frame(one_id(id), errors, data).encode()


def status_head(id: int, n_data: int) -> bytes:
    """How a servo's answer with so many bytes of data begins, up to its errors."""
    return _HEADER + bytes((one_id(id), n_data + 2))


def status_of(frame: Frame) -> Status:
    """The answer that a packet is, where an answer is due. Raises ValueError for one from all servos."""
    return Status(one_id(frame.id), frame.code, frame.parameters)


def reply_bytes(n_data: int) -> int:
    """Bytes on the wire of an answer with so many of data."""
    return 6 + n_data
