"""Dynamixel protocol 2.0: packets to bytes and back. Pure.

Source: ROBOTIS e-Manual, "Protocol 2.0" (GitHub ROBOTIS-GIT/emanual), and dynamixel-sdk 4.1.0. A packet is
FF FF FD 00, id, length (2, low byte first), instruction, parameters, CRC-16 (low first). The length counts all that
follows it. After each FF FF FD in instruction and parameters one FD is stuffed, which length and CRC count, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from functools import cache
from typing import NamedTuple

from rig.backends.servo.packets import BROADCAST as BROADCAST
from rig.backends.servo.packets import LAST_ID as LAST_ID
from rig.backends.servo.packets import PacketStream, Requests, any_id, one_id, whole_packet
from rig.backends.servo.packets import Skipped as Skipped

LONGEST = 1024  # bytes of a packet; dynamixel-sdk sends and takes no longer one
SHORTEST = 10
CLEAR_TURNS = bytes((0x01, 0x44, 0x58, 0x4C, 0x22))  # what Clear wants to hear before it forgets the turns

_HEADER = b"\xff\xff\xfd\x00"
_BEGIN, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_TRINOMIAL = 0x8003  # x^15 + x + 1
_SHORT_BYTES = 41  # of a packet that the folds of ``crc16`` take at once, its CRC not counted


class Instruction(IntEnum):
    """What a packet asks for; STATUS is an answer."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


FAILED, NO_INSTRUCTION, CRC, RANGE, LENGTH, LIMIT, ACCESS = range(1, 8)  # of a status's error
ALERT = 0x80
ERRORS: Mapping[int, str] = {
    FAILED: "it could not do that",
    NO_INSTRUCTION: "it has no such instruction, or an action came without a registered write",
    CRC: "the packet came damaged",
    RANGE: "the value is out of range, or the watchdog has acted",
    LENGTH: "the write is shorter than the register",
    LIMIT: "the value is beyond a limit that is set on it",
    ACCESS: "the register is read-only, is none, or is locked while the torque is on",
}


def crc16(data: bytes) -> int:
    """CRC-16 of bytes, polynomial 0x8005, high bit first.

    The bits are a polynomial, and the CRC is its rest by x^16 + x^15 + x^2 + 1 = (x + 1)(x^15 + x + 1). By the second
    factor x^(15 n) is x^n + 1 where n is a power of 2: about half of all bits are folded onto the others at once. The
    first one says that the rest has as many ones as the whole, but for an even number. No table, and no loop for what a
    tick brings: between two ticks the processor has forgotten all that it goes through.
    """
    whole = rest = int.from_bytes(data, "big") << 16
    if len(data) > _SHORT_BYTES:
        for far, near in _folds(len(data)):
            high = rest >> far
            rest ^= high << far ^ high << near ^ high
    high = rest >> 120  # of 344 bits
    rest ^= high << 120 ^ high << 8 ^ high
    high = rest >> 120
    rest ^= high << 120 ^ high << 8 ^ high
    high = rest >> 60  # of 120
    rest ^= high << 60 ^ high << 4 ^ high
    high = rest >> 30  # of 64
    rest ^= high << 30 ^ high << 2 ^ high
    high = rest >> 15  # of 36
    rest ^= high << 15 ^ high << 1 ^ high
    high = rest >> 15  # of 22
    rest ^= high << 15 ^ high << 1 ^ high
    return rest ^ _TRINOMIAL if (rest.bit_count() ^ whole.bit_count()) & 1 else rest


@cache
def _folds(n_data: int) -> list[tuple[int, int]]:
    """15 n and n of each fold, until a short packet's bits are left of so many bytes and a CRC."""
    bits, folds = 8 * n_data + 16, []
    while bits > 8 * _SHORT_BYTES + 16:  # 15 n bits stay; those above them are folded to 0 and to n
        bits, n = min((max(15 * n, bits - 14 * n), n) for n in (1 << k for k in range(bits.bit_length())))
        folds.append((15 * n, n))
    return folds


class Frame(NamedTuple):
    """One packet without header, length, stuffing and CRC.

    id           of the servo, 0 to 252, or BROADCAST
    instruction  0x55: a status
    parameters   of a status its error byte comes first
    """

    id: int
    instruction: int
    parameters: bytes = b""

    @property
    def is_status(self) -> bool:
        """Whether it is an answer."""
        return self.instruction == Instruction.STATUS

    def encode(self) -> bytes:
        """As it is on the wire. Raises ValueError for an id or an instruction out of range, or for too many bytes.

        The one answer to a fast read is not stuffed: several servos write it, each its part (dynamixel-sdk).
        """
        if not 0 <= self.instruction <= 0xFF:
            raise ValueError(f"instruction {self.instruction} is no byte")
        body = bytes((self.instruction,)) + self.parameters
        if not _is_fast_reply(self.id, self.instruction):
            body = body.replace(_BEGIN, _STUFFED)
        length = len(body) + 2
        if length + 7 > LONGEST:
            raise ValueError(f"{length + 7} bytes: a packet has {LONGEST} at most")
        packet = _HEADER + bytes((any_id(self.id), length & 0xFF, length >> 8)) + body
        return packet + crc16(packet).to_bytes(2, "little")


def _is_fast_reply(id: int, instruction: int) -> bool:
    return id == BROADCAST and instruction == Instruction.STATUS


class Stream(PacketStream[Frame]):
    """Packets out of bytes as they arrive."""

    def __init__(self) -> None:
        super().__init__(_HEADER, _take)


def _take(data: bytes | bytearray, at: int) -> tuple[Frame, int] | str | None:
    """As ``packets.Take``."""
    packet = whole_packet(data, at, header=len(_HEADER), length_bytes=2, shortest=SHORTEST, longest=LONGEST)
    if not isinstance(packet, bytes):
        return packet
    body = body_of(packet)
    return body if isinstance(body, str) else (Frame(packet[4], body[0], body[1:]), len(packet))


def body_of(packet: bytes) -> bytes | str:
    """Instruction and parameters of a packet of the right length, not stuffed any more; or why it is damaged."""
    if crc16(packet[:-2]) != packet[-2] | packet[-1] << 8:
        return "CRC"
    body = packet[7:-2]
    if _BEGIN in body and not _is_fast_reply(packet[4], body[0]):
        plain = body.replace(_STUFFED, _BEGIN)
        return "not stuffed" if plain.replace(_BEGIN, _STUFFED) != body else plain
    return body


# ---------------------------------------------------------------------- requests


def _word(value: int) -> bytes:
    if not 0 <= value <= 0xFFFF:
        raise ValueError(f"{value} is no address or length: 0 to 65535")
    return value.to_bytes(2, "little")


_requests = Requests(lambda id, code, parameters: Frame(id, code, parameters).encode(), _word)
ping, read, write, reboot = _requests.ping, _requests.read, _requests.write, _requests.reboot


# ---------------------------------------------------------------------- answers


class Status(NamedTuple):
    """What a servo answered.

    error  0: none; 1 to 7, see ERRORS
    alert  it has a hardware error: its register says which
    data   what was read; of a ping model number (2, low first) and firmware
    """

    id: int
    error: int
    alert: bool
    data: bytes


def status(id: int, data: bytes = b"", error: int = 0, *, alert: bool = False) -> bytes:
    """A servo's answer as it is on the wire."""
    return Frame(id, Instruction.STATUS, bytes((_error(error, alert=alert),)) + data).encode()


def status_head(id: int, n_data: int) -> bytes:
    """How a servo's answer with so many bytes of data begins, up to its error byte, where nothing is stuffed."""
    return _HEADER + bytes((one_id(id), n_data + 4 & 0xFF, n_data + 4 >> 8, Instruction.STATUS))


def _error(error: int, *, alert: bool) -> int:
    if not 0 <= error < ALERT:
        raise ValueError(f"error {error} is none: 0 to {ALERT - 1}")
    return error | (ALERT if alert else 0)


def status_of(frame: Frame) -> Status:
    """The answer that a packet is. Raises ValueError where it is none, or has no error byte."""
    if not frame.is_status:
        raise ValueError(f"a packet of instruction {frame.instruction:#04x} is no answer")
    if not frame.parameters:
        raise ValueError("an answer without its error byte")
    error = frame.parameters[0]
    return Status(frame.id, error & ~ALERT, bool(error & ALERT), frame.parameters[1:])


def fast_status(statuses: Iterable[Status]) -> bytes:
    """The one packet that servos write together, in a row. Raises ValueError for none.

    Error, id, data and CRC of each; each CRC covers the packet from its header to its place.
    """
    listed = list(statuses)
    if not listed:
        raise ValueError("an answer of no servo")
    length = sum(len(s.data) + 4 for s in listed) + 1
    packet = _HEADER + bytes((BROADCAST, length & 0xFF, length >> 8, Instruction.STATUS))
    for s in listed:
        packet += bytes((_error(s.error, alert=s.alert), one_id(s.id))) + s.data
        packet += crc16(packet).to_bytes(2, "little")
    return packet


def reply_bytes(n_data: int) -> int:
    """Bytes on the wire of an answer with so many of data, stuffing not counted."""
    return 11 + n_data
