"""Feetech's protocol of STS and SMS servos: packets to bytes and back. Pure.

Sources: feetech-servo-sdk 1.0.0; Feetech's SCServo library (SMS_STS). A packet is FF FF, id, length, code, parameters,
check sum. The length counts code, parameters and check sum. The code is an instruction, or in an answer the error byte:
nothing else tells the two apart. The check sum is one byte: of 256 damaged packets one passes. Numbers come low byte
first; a signed one is its magnitude and a bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import NamedTuple

from rig.backends.servo.packets import BROADCAST as BROADCAST
from rig.backends.servo.packets import LAST_ID as LAST_ID
from rig.backends.servo.packets import PacketStream, any_id, is_id, one_id
from rig.backends.servo.packets import Skipped as Skipped

LONGEST = 250  # bytes of a packet; feetech-servo-sdk sends and takes no longer one
SHORTEST = 6

_HEADER = b"\xff\xff"


class Instruction(IntEnum):
    """What a packet asks for."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    RESET = 0x06
    REBOOT = 0x08
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


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


def _take(data: bytearray, at: int) -> tuple[Frame, int] | str | None:
    """The packet whose header is at ``at``, and its length; why it is none; None while that is open."""
    have = len(data) - at
    if have > 2 and not is_id(data[at + 2]):
        return f"id {data[at + 2]}"
    if have < 4:
        return None
    length = data[at + 3]
    if not 2 <= length <= LONGEST - 4:
        return f"length {length}"
    whole = length + 4
    if have < whole:
        return None
    packet = bytes(data[at : at + whole])
    if check_sum(packet[2:-1]) != packet[-1]:
        return "check sum"
    return Frame(packet[2], packet[4], packet[5:-1]), whole


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


def ping(id: int) -> bytes:
    """Ask whether a servo is there."""
    return Frame(id, Instruction.PING).encode()


def read(id: int, address: int, length: int) -> bytes:
    """Ask one servo for ``length`` bytes from ``address``. Raises ValueError for all at once, or beyond a byte."""
    return Frame(one_id(id), Instruction.READ, bytes((_byte(address), _byte(length)))).encode()


def write(id: int, address: int, data: bytes) -> bytes:
    """Write bytes from ``address`` on; BROADCAST writes to all, and none answers."""
    return Frame(id, Instruction.WRITE, bytes((_byte(address),)) + data).encode()


def reg_write(id: int, address: int, data: bytes) -> bytes:
    """Have bytes written at the next action."""
    return Frame(id, Instruction.REG_WRITE, bytes((_byte(address),)) + data).encode()


def action(id: int = BROADCAST) -> bytes:
    """Do what was registered."""
    return Frame(id, Instruction.ACTION).encode()


def reset(id: int) -> bytes:
    """Put every register back to how it was shipped, but the id."""
    return Frame(id, Instruction.RESET).encode()


def reboot(id: int) -> bytes:
    """Start the servo anew."""
    return Frame(id, Instruction.REBOOT).encode()


def sync_read(address: int, length: int, ids: Iterable[int]) -> bytes:
    """Ask several servos for the same registers; each answers for itself, in this order. SCS servos do not know it.

    Raises ValueError for no servo, or for one twice.
    """
    listed = list(ids)
    if not listed or len(set(listed)) != len(listed):
        raise ValueError(f"ids {listed}: at least one, and each once")
    parameters = bytes((_byte(address), _byte(length), *map(one_id, listed)))
    return Frame(BROADCAST, Instruction.SYNC_READ, parameters).encode()


def sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Write the same registers of several servos, by id; none answers. Raises ValueError for unequal lengths."""
    lengths = {len(values) for values in data.values()}
    if len(lengths) != 1:
        raise ValueError("a sync write takes the same number of bytes for each of at least one servo")
    parameters = bytes((_byte(address), _byte(lengths.pop())))
    for id, values in data.items():
        parameters += bytes((one_id(id),)) + values
    return Frame(BROADCAST, Instruction.SYNC_WRITE, parameters).encode()


def _byte(value: int) -> int:
    if not 0 <= value <= 0xFF:
        raise ValueError(f"{value} is no address or length: 0 to 255")
    return value


def request_bytes(n_parameters: int) -> int:
    """Bytes on the wire of a request with so many of parameters."""
    return 6 + n_parameters


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


def status_of(frame: Frame) -> Status:
    """The answer that a packet is, where an answer is due. Raises ValueError for one from all servos."""
    return Status(one_id(frame.id), frame.code, frame.parameters)


def reply_bytes(n_data: int) -> int:
    """Bytes on the wire of an answer with so many of data."""
    return 6 + n_data
