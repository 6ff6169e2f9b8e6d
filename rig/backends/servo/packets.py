"""Packets out of a stream of bytes, whatever else comes in between; what both protocols of servos share. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

BROADCAST = 0xFE
LAST_ID = 252

F = TypeVar("F")
# The packet whose header is at a place, and its length; why it is none; None while that is open
Take = Callable[[bytearray, int], "tuple[F, int] | str | None"]


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
