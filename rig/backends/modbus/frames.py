"""Modbus frames around requests and replies: RTU with its check sum, TCP with its header.

Requests are packed and replies unpacked by pymodbus; which frame is a reply to which request is decided here, strictly:
pymodbus's framers hunt for something that fits, and a reply that has to be hunted for is no reply.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU

from rig.backends.registers.bus import Damaged

__all__ = ["Damaged", "Frame", "Framing", "RtuFraming", "TcpFraming", "is_exception"]

_RTU_LEAST, _RTU_MOST = 4, 256
_TCP_HEADER, _TCP_MOST = 7, 260
_EXCEPTION = 0x80


class Frame(NamedTuple):
    """One reply as it came.

    unit, number  who sent it, and to which request (TCP; None on RTU)
    pdu           function code and data
    length        bytes on the wire
    """

    unit: int
    number: int | None
    pdu: bytes
    length: int


class Framing(Protocol):
    """How frames look on a link."""

    def encode(self, request: ModbusPDU, unit: int, number: int) -> bytes:
        """The frame of a request; ``number`` 1 to 65535 is its own."""

    def take(self, data: bytes) -> Frame | None:
        """The frame that ``data`` begins with; None while it is not whole. Raises Damaged where it never will be."""


class RtuFraming:
    """Unit, function code and data, check sum."""

    def __init__(self) -> None:
        self._decoder = DecodePDU(is_server=False)
        self._framer = FramerRTU(self._decoder)

    def encode(self, request: ModbusPDU, unit: int, number: int) -> bytes:
        """The frame of a request; it holds no number."""
        return self._framer.encode(_pdu(request), unit, number)

    def take(self, data: bytes) -> Frame | None:
        """As Framing. Raises Damaged. The length follows from the function code and the byte count."""
        if len(data) < _RTU_LEAST:
            return None
        kind = self._decoder.lookupPduClass(data)
        if kind is None:
            raise Damaged(f"function code {data[1]} is none: {_hex(data)}")
        length = kind.calculateRtuFrameSize(data)
        if not _RTU_LEAST < length <= _RTU_MOST:
            if len(data) > _RTU_MOST:
                raise Damaged(f"more bytes than a frame has: {_hex(data)}")
            return None  # as long as the length is not known yet
        if len(data) < length:
            return None
        body = data[: length - 2]
        if FramerRTU.compute_CRC(body) != int.from_bytes(data[length - 2 : length], "big"):
            raise Damaged(f"check sum: {_hex(data[:length])}")
        return Frame(data[0], None, body[1:], length)


class TcpFraming:
    """Header with number, length and unit; function code and data."""

    def __init__(self) -> None:
        self._framer = FramerSocket(DecodePDU(is_server=False))

    def encode(self, request: ModbusPDU, unit: int, number: int) -> bytes:
        """The frame of a request."""
        return self._framer.encode(_pdu(request), unit, number)

    def take(self, data: bytes) -> Frame | None:
        """As Framing. Raises Damaged."""
        if len(data) < _TCP_HEADER:
            return None
        number, protocol, left = (int.from_bytes(data[k : k + 2], "big") for k in (0, 2, 4))
        length = _TCP_HEADER - 1 + left
        if protocol != 0 or not _TCP_HEADER + 2 <= length <= _TCP_MOST:
            raise Damaged(f"header: {_hex(data)}")
        if len(data) < length:
            return None
        return Frame(data[_TCP_HEADER - 1], number, data[_TCP_HEADER:length], length)


def is_exception(frame: Frame, request: ModbusPDU) -> bool:
    """Whether a frame is the refusal of that request."""
    return frame.pdu[0] == request.function_code | _EXCEPTION and len(frame.pdu) == 2


def _pdu(request: ModbusPDU) -> bytes:
    return bytes((request.function_code,)) + request.encode()


def _hex(data: bytes) -> str:
    return data[:24].hex(" ") + (" ..." if len(data) > 24 else "")
