"""Requests to a serial device and their replies, one at a time. Keeps blocks that come unasked."""

from __future__ import annotations

import math

from rig.backends.driver import Transport
from rig.backends.serial import frames
from rig.backends.serial.frames import DeviceState, Hello, Kind, Packet
from rig.backends.serial.introduction import await_introduction, refusal
from rig.core.faults import Fault

ATTEMPTS = 3  # of a request outside the loop


class Exchange:
    """The host's end of the wire. Times are in the transport's clock, s.

    transport  an open port
    timeout_s  longest wait for one reply
    reader     takes the packets out of the incoming bytes
    seq        sequence number of the last request
    exchanges, timeouts, stale_replies   counts so far: requests with a wait; those without a reply in time; intact
               replies that were not the awaited one
    """

    def __init__(self, transport: Transport, timeout_s: float) -> None:
        self.transport = transport
        self.timeout_s = timeout_s
        self.reader = frames.FrameReader()
        self.seq = 0
        self.exchanges = 0
        self.timeouts = 0
        self.stale_replies = 0
        self._blocks: list[Packet] = []  # that came while something else was waited for

    def now_s(self) -> float:
        """The transport's clock, s."""
        return self.transport.now_s()

    def send(self, kind: Kind, body: bytes = b"") -> int:
        """Send a request. Returns its seq."""
        self.seq = seq = (self.seq + 1) & 0xFFFF
        self.transport.write(frames.encode(kind, seq, body))
        return seq

    def answer(self, seq: int, kind: Kind) -> Packet | None:
        """The reply of that seq and kind, or the refusal; None after the time-out. Counts time-outs."""
        packet = self.wait([seq], kind, self.now_s() + self.timeout_s)
        self.timeouts += packet is None
        return packet

    def wait(self, seqs: list[int], kind: Kind, until_s: float, damage_ends: bool = False) -> Packet | None:
        """The reply of that kind to one of ``seqs``, or the refusal; None at ``until_s``. Anything else is stale.

        damage_ends  also return None after a damaged frame, which may have been the reply
        """
        transport = self.transport
        self.exchanges += 1
        bad_frames = self.reader.bad_frames
        left_s = math.inf
        while left_s > 0.0:
            # also after the time-out: a process that was stopped meanwhile has not seen yet what has arrived
            left_s = until_s - transport.now_s()
            reply = None
            for packet in self.reader.feed(transport.read(max(left_s, 0.0))):
                if (
                    reply is None
                    and packet.seq in seqs
                    and (packet.kind == kind or packet.kind == Kind.NACK)
                    and packet.version == frames.VERSION
                ):
                    reply = packet
                    if kind in (Kind.RELAY_REPLY, Kind.STROKES_REPLY):
                        self._blocks.clear()  # of an earlier run
                else:
                    self._sort([packet])
            if reply is not None:
                return reply
            if damage_ends and self.reader.bad_frames > bad_frames:
                return None
        return None

    def request(self, kind: Kind, body: bytes, reply: Kind) -> Packet:
        """Send up to ``ATTEMPTS`` times until the device answers. Raises Fault on refusal or silence."""
        for _ in range(ATTEMPTS):
            packet = self.answer(self.send(kind, body), reply)
            if packet is not None:
                if packet.kind == Kind.NACK:
                    raise refusal(packet)
                return packet
        raise self.silence(kind)

    # ------------------------------------------------------------------ what is asked outside the loop

    def meet(self, timeout_s: float) -> Hello:
        """Wait until the device introduces itself, and count on from there. Raises as ``await_introduction``."""
        introduction = await_introduction(self.transport, self.reader, timeout_s)
        self.seq = introduction.requests
        self.stale_replies += introduction.stale_replies
        return introduction.hello

    def hello(self) -> Hello:
        """The device's introduction now. Raises as ``request``."""
        return Hello.unpack(self.request(Kind.HELLO, b"", Kind.HELLO_REPLY).body)

    def state(self, kind: Kind = Kind.READ, reply: Kind = Kind.STATE) -> DeviceState:
        """The state that the reply to a request without a body holds. Raises as ``request``."""
        return DeviceState.unpack(self.request(kind, b"", reply).body)

    def arm(self, session: int) -> int:
        """Arm the device; why it refused, or Code.NONE. Raises as ``request``."""
        return self.request(Kind.ARM, frames.pack_arm(session), Kind.ARM_REPLY).body[0]

    def is_cleared(self, code: int) -> bool:
        """Acknowledge one fault; False where its cause lasts. Raises Fault LINK_TIMEOUT."""
        for _ in range(ATTEMPTS):
            packet = self.answer(self.send(Kind.ACK, frames.pack_ack(code)), Kind.ACK_REPLY)
            if packet is not None:
                return packet.kind == Kind.ACK_REPLY
        raise self.silence(Kind.ACK)

    def silence(self, kind: Kind, what: str = "") -> Fault:
        """The fault of a device that does not answer; ``what`` says what happened instead."""
        what = what or f"no reply to {kind.name} within {1e3 * self.timeout_s:g} ms"
        return Fault(
            "LINK_TIMEOUT",
            f"{what}; so far {self.reader.bad_frames} damaged frames, {self.stale_replies} stale replies in "
            f"{self.exchanges} exchanges",
        )

    def listen(self, for_s: float) -> bool:
        """Take bytes that come unasked within ``for_s``. Returns whether any came."""
        data = self.transport.read(for_s)
        self._sort(self.reader.feed(data))
        return data != b""

    def ignore(self, for_s: float) -> None:
        """Wait for ``for_s`` and ignore all that comes."""
        self.stale_replies += len(self.reader.feed(self.transport.read(for_s)))

    def blocks(self) -> list[Packet]:
        """The blocks that have come since the last call."""
        blocks, self._blocks = self._blocks, []
        return blocks

    def _sort(self, packets: list[Packet]) -> None:
        """Keep blocks; count everything else as stale."""
        for packet in packets:
            if packet.kind == Kind.BLOCK and packet.version == frames.VERSION:
                self._blocks.append(packet)
            else:
                self.stale_replies += 1
