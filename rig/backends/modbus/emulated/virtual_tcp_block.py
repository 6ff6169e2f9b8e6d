"""The emulated Modbus I/O block behind Modbus TCP in virtual time, with a network in between that may fail.

TCP hands over each byte once, whole and in order, or later, or never: a lost packet is one that is late, with all that
follow it (RFC 9293, 3.8; the least time until it is sent again is Linux's, 0.2 s). What else may happen is that
nothing passes for a while, or that the connection ends.
"""

from __future__ import annotations

import math
from typing import Literal

from typing_extensions import override

from rig.backends.emulated.under_way import UnderWay
from rig.backends.modbus.emulated.reply_faults import ReplyFault
from rig.backends.modbus.emulated.tcp_slave import Stream, TcpSlave
from rig.backends.modbus.emulated.virtual_io_block import BlockInVirtualTime
from rig.backends.modbus.section import Modbus
from rig.config.schema import Emulated
from rig.core.faults import Fault

SENT_AGAIN_S = 0.2
CONNECT_S = 5.0
_ETHERNET_BITS_S = 10e6  # as in the link budget
_CONNECTION = 1

To = Literal["host", "device"]


class _Way(UnderWay[bytes]):
    """One direction: packets in order, each not before the one ahead of it."""

    def __init__(self) -> None:
        super().__init__()
        self.blocked_until_s = self._last_s = -math.inf
        self._loses_next = False

    def hand_over(self, data: bytes, t_s: float) -> None:
        """A packet begins its way at ``t_s``."""
        arrives_s = t_s + 8.0 * len(data) / _ETHERNET_BITS_S + SENT_AGAIN_S * self._loses_next
        self._loses_next = False
        self._last_s = max(arrives_s, self._last_s, self.blocked_until_s)
        self.send(data, self._last_s)

    def block(self, until_s: float) -> None:
        """Nothing arrives before ``until_s``, what is under way included."""
        self.blocked_until_s = until_s
        self.change(lambda arrives_s, data: (max(arrives_s, until_s), data))

    def free(self, now_s: float) -> None:
        """What was kept back arrives now."""
        self.blocked_until_s = self._last_s = -math.inf
        self.change(lambda arrives_s, data: (min(arrives_s, now_s), data))

    def lose_next(self) -> None:
        self._loses_next = True

    @override
    def clear(self) -> None:
        super().clear()
        self._last_s, self._loses_next = -math.inf, False


class VirtualTcpBlock(BlockInVirtualTime):
    """The block behind a network: a connection to it is a ``Transport``, and a ``Clock`` too.

    modbus, emulated, seed, polarity, reply_fault   as of ``VirtualIoBlock``, but nothing of the line
    Not connected at first. Raises EmulationError where a register cannot hold what it is for.
    """

    def __init__(
        self,
        modbus: Modbus,
        emulated: Emulated,
        seed: int = 1,
        *,
        polarity: int = 1,
        reply_fault: ReplyFault | None = None,
    ) -> None:
        super().__init__(modbus, emulated, seed, polarity)
        self._slave = TcpSlave(self.block, modbus.turnaround_s, reply_fault)
        self._ways: dict[To, _Way] = {"host": _Way(), "device": _Way()}
        self._stream: Stream | None = None  # the device's end of the connection
        self._ended = "not connected"  # why the host's end is dead; empty while it is not
        self._is_closing = False  # the device has hung up: when all has arrived the host sees it
        self._absent_until_s = -math.inf

    # ------------------------------------------------------------------ the host's end

    def connect(self, connect_s: float = CONNECT_S) -> None:
        """A new connection; the one before is closed. Raises Fault LINK_OPEN after ``connect_s`` without an answer."""
        until_s = self._now_s + connect_s
        free_s = max(self._absent_until_s, *(way.blocked_until_s for way in self._ways.values()))
        self.close()
        self._run_to(min(max(free_s, self._now_s), until_s))
        if free_s > until_s:
            raise Fault("LINK_OPEN", "the virtual network: timed out")
        self._stream, self._ended, self._is_closing = Stream(), "", False

    def write(self, data: bytes) -> None:
        """Hand ``data`` to the network, which takes no time. Raises Fault LINK_LOST on a connection that has ended."""
        self._check_connection()
        self._ways["device"].hand_over(data, self._now_s)

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, or b"" after ``timeout_s`` of virtual time. Raises Fault LINK_LOST as ``write``."""
        until_s = self._now_s + max(timeout_s, 0.0)
        while True:
            self._run_to(self._now_s)
            self._check_connection()
            data = b"".join(self._ways["host"].arrived(self._now_s))
            if data or self._now_s >= until_s:
                return data
            if self._is_closing and not math.isfinite(self._ways["host"].next_s()):
                self._ended = "hung up"
                continue
            self._run_to(min(self._next_event_s(), until_s))

    def close(self) -> None:
        """Close the connection; the device lives on, and its clock with it. May be called twice."""
        self._forget("closed")

    # ------------------------------------------------------------------ what may happen

    def block_way(self, to: To, for_s: float = math.inf) -> None:
        """For a while nothing arrives there; then everything does."""
        self._ways[to].block(self._now_s + for_s)

    def free_ways(self) -> None:
        """Everything passes again."""
        for way in self._ways.values():
            way.free(self._now_s)

    def lose_packet(self, to: To) -> None:
        """The next packet is lost, and comes when it is sent again; what follows waits for it."""
        self._ways[to].lose_next()

    def reset_connection(self) -> None:
        """Somebody on the way, or the device, ends it at once: what is under way is lost."""
        self._forget("Connection reset by peer")

    def hang_up(self) -> None:
        """The device closes the connection in order; what it has sent still arrives."""
        self._stream, self._is_closing = None, True
        self._slave.forget(_CONNECTION)

    def reset(self, boot_s: float = 0.0) -> None:
        """Its supply fails for a moment: as ``power_cycle``, and it knows of no connection. Silent for ``boot_s``."""
        self.power_cycle()
        self._stream = None
        self._slave.forget(_CONNECTION)
        self._absent_until_s = self._now_s + boot_s

    # ------------------------------------------------------------------ time

    def _check_connection(self) -> None:
        if self._ended:
            raise Fault("LINK_LOST", f"the virtual network: {self._ended}")

    def _forget(self, why: str) -> None:
        self._stream, self._ended = None, why
        self._slave.forget(_CONNECTION)
        for way in self._ways.values():
            way.clear()

    def _next_event_s(self) -> float:
        return min(self._slave.next_event_s(), *(way.next_s() for way in self._ways.values()))

    def _advance(self) -> None:
        """What arrives until now: at the device, and what it answers."""
        to_device, to_host = self._ways["device"], self._ways["host"]
        while (t_s := min(to_device.next_s(), self._slave.next_event_s())) <= self._now_s:
            if to_device.next_s() <= t_s:
                self._take(b"".join(to_device.arrived(t_s)), t_s)
            for _, reply in self._slave.due(t_s):
                to_host.hand_over(reply, t_s)
        self.block.advance_to(self._now_s)

    def _take(self, data: bytes, t_s: float) -> None:
        """A segment at the device's end; to one that belongs to no connection it answers with a reset."""
        if t_s < self._absent_until_s:
            return
        if self._stream is None:
            if not self._is_closing:
                self._forget("Connection reset by peer")
            return
        for adu in self._stream.feed(data):
            self._slave.take(_CONNECTION, adu, t_s)
        if self._stream.broken:
            self.hang_up()
