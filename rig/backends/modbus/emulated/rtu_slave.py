"""The emulated I/O block on a Modbus RTU line: framing by silence, check sums, wire times, and faults of all of them.

Pure: the caller gives the time. Modbus over serial line, V1.02, section 2.5.1: a frame ends with 3.5 characters of
silence. A damaged frame, or one for another unit, gets no answer. A request to unit 0 is executed, without an answer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from pymodbus.framer import FramerRTU

from rig.backends.emulated.line_faults import Disturbance, disturbed
from rig.backends.emulated.under_way import UnderWay
from rig.backends.modbus.emulated.io_block import IoBlock
from rig.backends.modbus.emulated.reply_faults import ReplyFault

if TYPE_CHECKING:  # the process of an emulated device starts without the config
    from rig.backends.modbus.section import Modbus

BROADCAST = 0
_SHORTEST_FRAME, _LONGEST_FRAME = 4, 256


@dataclass(frozen=True)
class LineTimes:
    """Times of a serial line.

    baud, bits_per_byte   start, parity and stop bits included: 10 (8N1) or 11
    silence_s             that ends a frame
    turnaround_s          from there to the first bit of the reply
    """

    baud: int = 115200
    bits_per_byte: int = 10
    silence_s: float = 0.00175
    turnaround_s: float = 0.0005

    @classmethod
    def of(cls, modbus: Modbus, baud: int) -> Self:
        """As the section ``daq.modbus`` has it."""
        bits = 9 + (modbus.parity != "none") + modbus.stop_bits
        silence_s = modbus.silence_s
        if silence_s is None:
            silence_s = 3.5 * bits / baud if baud <= 19200 else 0.00175
        return cls(baud, bits, silence_s, modbus.turnaround_s)

    def wire_s(self, n_bytes: int) -> float:
        """Time that so many bytes take."""
        return n_bytes * self.bits_per_byte / self.baud


def check_sum(data: bytes) -> bytes:
    """CRC of a frame's bytes, as they follow it on the wire."""
    return FramerRTU.compute_CRC(data).to_bytes(2, "big")


def frame(unit: int, pdu: bytes) -> bytes:
    """A frame, whole."""
    data = bytes((unit,)) + pdu
    return data + check_sum(data)


class RtuSlave:
    """The block at its end of the line.

    block         time passes for it together with the line's
    line          times
    reply_fault  fault of the block's replies; None: none
    disturbance   on the line, both ways; may be changed at any time
    frames, damaged, foreign   requests so far: executed ones; dropped for their check sum or length; of other units
    """

    def __init__(
        self,
        block: IoBlock,
        line: LineTimes,
        reply_fault: ReplyFault | None = None,
        disturbance: Disturbance | None = None,
    ) -> None:
        self.block = block
        self.line = line
        self.reply_fault = reply_fault
        self.disturbance = disturbance
        self.frames = self.damaged = self.foreign = 0
        self._coming, self._going = UnderWay[bytes](), UnderWay[bytes]()
        self._frame = bytearray()
        self._last_bit_s = -math.inf
        self._free_s = -math.inf  # when the last reply has left

    def send(self, data: bytes, t_s: float) -> None:
        """The host hands bytes to the wire at ``t_s``, not before what it was advanced to."""
        for delay_s, arriving in disturbed(self.disturbance, "request", data, t_s):
            self._coming.send(arriving, t_s + delay_s)

    def next_event_s(self) -> float:
        """When something happens next without the host: a frame's end, or a reply's; inf for never."""
        return min(self._coming.next_s(), self._frame_end_s(), self._going.next_s())

    def next_reply_s(self) -> float:
        """When the host gets its next bytes, as far as that is known; inf for never."""
        return self._going.next_s()

    def advance_to(self, t_s: float) -> None:
        """Let time pass to ``t_s`` for line and block."""
        while True:
            end_s = self._frame_end_s()
            if min(self._coming.next_s(), end_s) > t_s:
                break
            if end_s <= self._coming.next_s():
                whole = bytes(self._frame)
                self._frame.clear()
                self._take(whole, end_s)
            else:
                coming_s, data = self._coming.take()
                self._last_bit_s = max(coming_s, self._last_bit_s) + self.line.wire_s(len(data))
                self._frame += data
                del self._frame[_LONGEST_FRAME + 1 :]  # too long is damaged, however long it is
        self.block.advance_to(t_s)

    def receive(self, t_s: float) -> bytes:
        """What has reached the host by ``t_s`` since the last call."""
        return b"".join(self._going.arrived(t_s))

    def _frame_end_s(self) -> float:
        return self._last_bit_s + self.line.silence_s if self._frame else math.inf

    def _take(self, data: bytes, t_s: float) -> None:
        """Execute one frame that ended at ``t_s``, silence included."""
        if not _SHORTEST_FRAME <= len(data) <= _LONGEST_FRAME or check_sum(data[:-2]) != data[-2:]:
            self.damaged += 1
            return
        unit, pdu = data[0], data[1:-2]
        if unit not in (self.block.unit, BROADCAST):
            self.foreign += 1
            return
        self.frames += 1
        if unit == BROADCAST:
            self.block.request(pdu, t_s)
            return
        answer = ReplyFault.answer_of(self.reply_fault, self.block, pdu, t_s)
        if answer is None:
            return
        begins_s = max(t_s + self.line.turnaround_s + answer.late_s, self._free_s)
        reply = frame(answer.unit, answer.pdu)
        self._free_s = begins_s + self.line.wire_s(len(reply))
        for delay_s, arriving in disturbed(self.disturbance, "reply", reply, begins_s):
            self._going.send(arriving, begins_s + self.line.wire_s(len(arriving)) + delay_s)
