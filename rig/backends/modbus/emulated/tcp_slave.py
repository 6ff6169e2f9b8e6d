"""The emulated I/O block behind Modbus TCP: framing by the header, and no check sum.

Pure: the caller gives the time. Modbus Messaging on TCP/IP, V1.0b: transaction (2 bytes), protocol 0 (2), length (2),
unit (1), then function code and data. The address of a device on the network itself is its unit id, 255 or 0.
"""

from __future__ import annotations

from typing import NamedTuple

from rig.backends.emulated.under_way import UnderWay
from rig.backends.modbus.emulated.io_block import IoBlock
from rig.backends.modbus.emulated.reply_faults import ReplyFault

_HEADER = 7
_ITSELF = (0, 255)
_LONGEST_PDU = 253


class Adu(NamedTuple):
    """One request or reply: transaction, unit, function code and data."""

    transaction: int
    unit: int
    pdu: bytes

    def pack(self) -> bytes:
        """As on the wire."""
        length = (len(self.pdu) + 1).to_bytes(2, "big")
        return self.transaction.to_bytes(2, "big") + bytes(2) + length + bytes((self.unit,)) + self.pdu


class Stream:
    """What one connection has received. ``broken`` once its bytes cannot be a header: then it must be closed."""

    def __init__(self) -> None:
        self.broken = False
        self._bytes = bytearray()

    def feed(self, data: bytes) -> list[Adu]:
        """The requests that are whole with these bytes."""
        self._bytes += data
        whole: list[Adu] = []
        while len(self._bytes) >= _HEADER and not self.broken:
            protocol, length = int.from_bytes(self._bytes[2:4], "big"), int.from_bytes(self._bytes[4:6], "big")
            if protocol != 0 or not 2 <= length <= _LONGEST_PDU + 1:
                self.broken = True
                break
            end = _HEADER - 1 + length
            if len(self._bytes) < end:
                break
            pdu = bytes(self._bytes[_HEADER:end])
            whole.append(Adu(int.from_bytes(self._bytes[:2], "big"), self._bytes[6], pdu))
            del self._bytes[:end]
        return whole


class TcpSlave:
    """The block and the replies that are not out yet.

    turnaround_s  from a request to its reply
    reply_fault   fault of the block's replies; None: none
    """

    def __init__(self, block: IoBlock, turnaround_s: float, reply_fault: ReplyFault | None = None) -> None:
        self.block = block
        self.reply_fault = reply_fault
        self._turnaround_s = turnaround_s
        self._going = UnderWay[tuple[int, bytes]]()

    def take(self, connection: int, adu: Adu, t_s: float) -> None:
        """Execute a request that arrived at ``t_s`` on a connection; one to another unit is not answered."""
        if adu.unit != self.block.unit and adu.unit not in _ITSELF:
            return
        answer = ReplyFault.answer_of(self.reply_fault, self.block, adu.pdu, t_s)
        if answer is not None:
            unit = adu.unit if answer.unit == self.block.unit else answer.unit
            reply = Adu(adu.transaction, unit, answer.pdu).pack()
            self._going.send((connection, reply), t_s + self._turnaround_s + answer.late_s)

    def forget(self, connection: int) -> None:
        """Keep no reply for a connection that is closed: another may get its number."""
        self._going.change(lambda at_s, going: None if going[0] == connection else (at_s, going))

    def next_event_s(self) -> float:
        """When the next reply is due; inf for never."""
        return self._going.next_s()

    def due(self, t_s: float) -> list[tuple[int, bytes]]:
        """Connection and bytes of the replies that are due by ``t_s``, once."""
        return self._going.arrived(t_s)
