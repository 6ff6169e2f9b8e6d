"""What both protocols of servos share: packets out of bytes, whatever else comes in between, and requests. Pure."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Generic, NamedTuple, TypeVar

BROADCAST = 0xFE
LAST_ID = 252

F = TypeVar("F")
# The packet whose header is at a place, and its length; why it is none; None while that is open
Take = Callable[["bytes | bytearray", int], "tuple[F, int] | str | None"]


class Skipped(NamedTuple):
    """Bytes that are no packet, and why."""

    why: str
    data: bytes


class PacketStream(Generic[F]):
    """Packets out of bytes as they arrive, however they were cut. Each byte is in a packet, skipped or pending.

    header  that each packet begins with
    take    what stands behind one
    """

    def __init__(self, header: bytes, take: Take[F]) -> None:
        self._header, self._take = header, take
        self._data = bytearray()

    @property
    def pending(self) -> bytes:
        """What has begun and is not whole."""
        return bytes(self._data)

    def feed(self, data: bytes) -> list[F | Skipped]:
        """What ``data`` completes, in the order of the bytes."""
        self._data += data
        return self._parsed(ends=False)

    def first(self, data: bytes) -> tuple[F, int] | Skipped | None:
        """Of bytes alone the packet that they begin with, and its length; else what is none; None while it is open."""
        if data.startswith(self._header):
            took = self._take(data, 0)
            if not isinstance(took, str):
                return took
        found = PacketStream(self._header, self._take).feed(data)
        return next((one for one in found if isinstance(one, Skipped)), None)

    def flush(self) -> list[F | Skipped]:
        """Nothing more comes: what is pending is no packet. A whole one behind its damaged header is told."""
        return self._parsed(ends=True)

    def _parsed(self, *, ends: bool) -> list[F | Skipped]:
        out: list[F | Skipped] = []
        junk, why = bytearray(), ""
        data, at = self._data, 0
        while at < len(data):
            begins = data.find(self._header, at)
            if begins < 0:
                begins = len(data) - (0 if ends else self._half_header(at))
            if begins > at:
                why = why or "no header"
                junk += data[at:begins]
                at = begins
                continue
            took = self._take(data, at) if data.startswith(self._header, at) else None
            if took is None and not ends:
                break
            if isinstance(took, tuple):
                if junk:
                    out.append(Skipped(why, bytes(junk)))
                    junk, why = bytearray(), ""
                frame, length = took
                out.append(frame)
                at += length
            else:
                why = why or took or "not whole"
                junk.append(data[at])
                at += 1
        if junk:
            out.append(Skipped(why, bytes(junk)))
        del data[:at]
        return out

    def _half_header(self, at: int) -> int:
        """Length of a header's beginning at the end of the data."""
        for length in range(len(self._header) - 1, 0, -1):
            if len(self._data) - at >= length and self._data.endswith(self._header[:length]):
                return length
        return 0


def one_id(id: int) -> int:
    """The id where it is that of one servo. Raises ValueError for any other."""
    if not 0 <= id <= LAST_ID:
        raise ValueError(f"id {id} is none of one servo: 0 to {LAST_ID}")
    return id


def any_id(id: int) -> int:
    """The id where it is that of one servo or of all. Raises ValueError for any other."""
    if not is_id(id):
        raise ValueError(f"id {id} is none: 0 to {LAST_ID}, {BROADCAST} for all")
    return id


def is_id(id: int) -> bool:
    """Whether packets may have this id."""
    return 0 <= id <= LAST_ID or id == BROADCAST


def whole_packet(
    data: bytes | bytearray, at: int, *, header: int, length_bytes: int, shortest: int, longest: int
) -> bytes | str | None:
    """The packet whose header is at ``at``, check sum not tried; why it is none; None while that is open.

    header        bytes in front of the id, which the length follows
    length_bytes  of the length, low byte first; it counts all that follows it
    shortest, longest   of a packet, bytes
    """
    have, begins = len(data) - at, header + 1 + length_bytes
    if have > header and not is_id(data[at + header]):
        return f"id {data[at + header]}"
    if have < begins:
        return None
    length = int.from_bytes(data[at + header + 1 : at + begins], "little")
    if not shortest <= begins + length <= longest:
        return f"length {length}"
    return bytes(data[at : at + begins + length]) if have >= begins + length else None


class Instruction(IntEnum):
    """What a packet asks for, in both protocols."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    RESET = 0x06
    REBOOT = 0x08
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Requests:
    """The requests of both protocols that rig sends, as they are on the wire.

    encode  a packet of id, instruction and parameters
    number  an address or a length, as bytes; raises ValueError for one that does not fit
    """

    def __init__(self, encode: Callable[[int, int, bytes], bytes], number: Callable[[int], bytes]) -> None:
        self._encode, self._number = encode, number

    def ping(self, id: int = BROADCAST) -> bytes:
        """Ask whether a servo is there, or who is."""
        return self._encode(id, Instruction.PING, b"")

    def read(self, id: int, address: int, length: int) -> bytes:
        """Ask one servo for ``length`` bytes from ``address``. Raises ValueError for all at once."""
        return self._encode(one_id(id), Instruction.READ, self._number(address) + self._number(length))

    def write(self, id: int, address: int, data: bytes) -> bytes:
        """Write bytes from ``address`` on; BROADCAST writes to all, and none answers."""
        return self._encode(id, Instruction.WRITE, self._number(address) + data)

    def reboot(self, id: int) -> bytes:
        """Start the servo anew: RAM registers as shipped, errors gone."""
        return self._encode(id, Instruction.REBOOT, b"")
