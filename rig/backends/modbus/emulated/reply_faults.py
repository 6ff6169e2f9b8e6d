"""Faults of a Modbus device's replies: late, wrong, an exception, another unit's id, or none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from rig.backends.modbus.emulated.io_block import DEVICE_FAILURE, IoBlock

Kind = Literal["late", "wrong", "exception", "unit", "silent"]


class Answer(NamedTuple):
    """The reply: its unit id, its protocol data unit, and its extra delay, s."""

    unit: int
    pdu: bytes
    late_s: float = 0.0


@dataclass
class ReplyFault:
    """A fault of the replies: what, from when, and how often.

    kind     late: executed, answered ``by_s`` too late. wrong: executed, answered with a register too few, or with
             another address. unit: executed, answered as from ``unit``. exception: answered with ``code``, not
             executed. silent: neither executed nor answered
    after_s  begin: device time since it was first armed
    times    number of requests that it affects; None: all
    """

    kind: Kind
    after_s: float = 0.0
    times: int | None = None
    by_s: float = 0.02
    unit: int = 99
    code: int = DEVICE_FAILURE

    @staticmethod
    def answer_of(reply_fault: ReplyFault | None, block: IoBlock, pdu: bytes, t_s: float) -> Answer | None:
        """The answer to a request that arrives whole at ``t_s``; None for no answer."""
        block.advance_to(t_s)
        if reply_fault is None or not reply_fault._is_due(block):
            return Answer(block.unit, block.request(pdu, t_s))
        return reply_fault._answer(block, pdu, t_s)

    def _is_due(self, block: IoBlock) -> bool:
        if self.times == 0 or block.bench.armed_for_s < self.after_s:  # negative before it is armed
            return False
        if self.times is not None:
            self.times -= 1
        return True

    def _answer(self, block: IoBlock, pdu: bytes, t_s: float) -> Answer | None:
        if self.kind == "silent":
            return None
        if self.kind == "exception":
            return Answer(block.unit, bytes((pdu[0] | 0x80, self.code)))
        reply = block.request(pdu, t_s)
        if self.kind == "late":
            return Answer(block.unit, reply, self.by_s)
        if self.kind == "unit":
            return Answer(self.unit, reply)
        return Answer(block.unit, _wrong(reply))


def _wrong(reply: bytes) -> bytes:
    """A well-formed reply, but to another request."""
    if reply[0] in (3, 4, 23):
        return bytes((reply[0], reply[1] - 2)) + reply[2:-2]
    if reply[0] in (6, 16):
        address = int.from_bytes(reply[1:3], "big") ^ 1
        return reply[:1] + address.to_bytes(2, "big") + reply[3:]
    return reply
