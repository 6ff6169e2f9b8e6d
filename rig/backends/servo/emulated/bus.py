"""Emulated servos of one protocol on one half-duplex bus: wire times, who answers when, echo, faults. Pure.

The caller gives the time. A servo executes a packet when its last byte has arrived. Answers to one request follow each
other in its order, each its servo's return delay after the one before; behind one that does not answer none follows.
What the host sends while an answer is due or on the wire damages both. A damaged packet is not executed nor answered.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.line_faults import Disturbance, disturbed
from rig.backends.emulated.under_way import UnderWay
from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.emulated.dynamixel_servo import DynamixelServo
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.emulated.feetech_servo import FeetechServo
from rig.backends.servo.emulated.hearing import Dynamixels, Feetechs
from rig.backends.servo.emulated.servo import ServoOptions, known_model
from rig.backends.servo.emulated.violation import Violation
from rig.backends.servo.packets import Skipped

_BITS = 10  # of a byte on the wire: 8N1
_SILENCE_S = 0.01  # after which a packet that has begun is forgotten


@dataclass(frozen=True)
class LineTimes:
    """The bus and the host's adapter.

    baud       that the host sends with: a servo of another one hears nothing
    adapter_s  from the last bit of an answer to the host
    echo       the host hears what it sends, as on boards that tie both lines together
    """

    baud: int = 1_000_000
    adapter_s: float = 0.0
    echo: bool = False

    def wire_s(self, n_bytes: int) -> float:
        """Time that so many bytes take."""
        return n_bytes * _BITS / self.baud


class Heard(NamedTuple):
    """A packet of the host that was whole: when its last byte arrived, and what it said."""

    t_s: float
    frame: dynamixel.Frame | feetech.Frame


class ServoBus:
    """Servos on a bus, powered on at time 0.

    servos       what is on it, of one protocol
    line         times; the baud may be changed at any time
    disturbance  on the wire, both ways; None: none. May be changed at any time, and so may ``reply_fault``
    on_output    called with the servo's place, time, s, and voltage at its motor, V, at each change
    violations   what the host did that it must never do
    log          packets of the host that were whole, in order; ``keeps_log`` False keeps none
    damaged, collisions   stretches of bytes that were no packet; of the host's bytes that met an answer
    Raises EmulationError for no servo, for both protocols on one bus, and for what a servo cannot be.
    """

    def __init__(
        self,
        servos: Sequence[ServoOptions],
        line: LineTimes | None = None,
        disturbance: Disturbance | None = None,
        reply_fault: ReplyFault | None = None,
        *,
        on_output: Callable[[int, float, float], None] | None = None,
        keeps_log: bool = True,
    ) -> None:
        self.line = LineTimes() if line is None else line
        self.disturbance = disturbance
        self.reply_fault = reply_fault
        self.violations: list[Violation] = []
        self.log: list[Heard] = []
        self.damaged = self.collisions = 0
        self.t_s = 0.0
        self._keeps_log = keeps_log
        protocols = {known_model(s.model).protocol for s in servos}
        if len(protocols) != 1:
            raise EmulationError("a bus has servos of one protocol, and at least one of them")
        ids = [s.id for s in servos]
        if len(set(ids)) != len(ids):
            raise EmulationError(f"ids {ids}: each servo of a bus has its own")
        noted = self.violations.append
        outputs = [None if on_output is None else _to(on_output, place) for place in range(len(servos))]
        self._protocol: Any  # the one of the two whose packets are on the wire
        self.servos: list[DynamixelServo] | list[FeetechServo]
        if "dynamixel" in protocols:
            self.servos = [DynamixelServo(s, noted, o) for s, o in zip(servos, outputs, strict=True)]
            self._protocol = Dynamixels()
        else:
            self.servos = [FeetechServo(s, noted, o) for s, o in zip(servos, outputs, strict=True)]
            self._protocol = Feetechs()
        self._coming = UnderWay[tuple[bytes, bool]]()  # and whether it is another master's
        self._packets = UnderWay[Any]()
        self._going = UnderWay[tuple[bytes, bool]]()  # and whether it is an answer, not an echo
        self._last_bit_s = -math.inf  # of the host
        self._free_s = -math.inf  # when the last answer has left the wire

    def watch(self, on_output: Callable[[int, float, float], None]) -> None:
        """Call that from now on, as ``on_output`` of the class."""
        for place, servo in enumerate(self.servos):
            servo.on_output = _to(on_output, place)

    def servo(self, id: int) -> DynamixelServo | FeetechServo:
        """The first servo of that id. Raises KeyError."""
        for servo in self.servos:
            if servo.id == id:
                return servo
        raise KeyError(id)

    # ------------------------------------------------------------------ the host's end

    def send(self, data: bytes, t_s: float) -> None:
        """The host hands bytes to the wire at ``t_s``, not before what it was advanced to."""
        for delay_s, arriving in disturbed(self.disturbance, "request", data, t_s):
            self._coming.send((arriving, False), t_s + delay_s)

    def another_master(self, data: bytes, t_s: float) -> None:
        """Somebody else on the bus sends bytes at ``t_s``: servos hear them, and so does the host."""
        self._coming.send((data, True), t_s)

    def receive(self, t_s: float) -> bytes:
        """What has reached the host by ``t_s`` since the last call."""
        return b"".join(data for data, _ in self._going.arrived(t_s))

    def next_reply_s(self) -> float:
        """When the host gets its next bytes, as far as that is known; inf for never."""
        return self._going.next_s()

    def next_event_s(self) -> float:
        """When something happens next on the wire without the host; inf for never."""
        return min(self._coming.next_s(), self._packets.next_s(), self._going.next_s())

    def advance_to(self, t_s: float) -> None:
        """Let time pass to ``t_s`` for wire and servos; none if that is past."""
        while min(self._coming.next_s(), self._packets.next_s()) <= t_s:
            if self._packets.next_s() <= self._coming.next_s():
                at_s, frame = self._packets.take()
                self._execute(frame, at_s)
            else:
                at_s, (data, is_foreign) = self._coming.take()
                self._arrive(data, at_s, is_foreign=is_foreign)
        for servo in self.servos:
            servo.advance_to(t_s)
        self.t_s = max(self.t_s, t_s)

    # ------------------------------------------------------------------ on the wire

    def _arrive(self, data: bytes, t_s: float, *, is_foreign: bool) -> None:
        """Bytes of a host begin on the wire."""
        stream, line = self._protocol.stream, self.line
        begins_s = max(t_s, self._last_bit_s)
        if begins_s - self._last_bit_s > _SILENCE_S:
            self.damaged += sum(isinstance(flushed, Skipped) for flushed in stream.flush())
        self._last_bit_s = begins_s + line.wire_s(len(data))
        if line.echo or is_foreign:
            self._going.send((data, False), self._last_bit_s + line.adapter_s)
        if begins_s < self._free_s:
            self.collisions += 1
            self._going.change(lambda at_s, sent: (at_s, (_inverted(sent[0]) if sent[1] else sent[0], sent[1])))
            return
        at = -len(stream.pending)
        for taken in stream.feed(data):
            at += len(taken.data) if isinstance(taken, Skipped) else len(taken.encode())
            if isinstance(taken, Skipped):
                self.damaged += 1
            else:
                self._packets.send(taken, begins_s + line.wire_s(max(at, 0)))

    def _execute(self, frame: Any, t_s: float) -> None:
        """A packet's last byte has arrived."""
        for servo in self.servos:
            servo.advance_to(t_s)
        if self._keeps_log:
            self.log.append(Heard(t_s, frame))
        hearing = [s for s in self.servos if s.baud == self.line.baud]
        ends_s = t_s
        for answer in self._protocol.hear(frame, hearing, self.reply_fault):
            begins_s, data = ends_s + answer.delay_s, answer.data
            if begins_s < self._last_bit_s:
                self.collisions += 1  # the host still sends what came behind its request
                data = _inverted(data)
                self.damaged += len(self._packets)
                self._packets.clear()
            ends_s = begins_s + self.line.wire_s(len(data))
            for delay_s, arriving in disturbed(self.disturbance, "reply", data, begins_s):
                arrives_s = begins_s + self.line.wire_s(len(arriving)) + self.line.adapter_s + delay_s
                self._going.send((arriving, True), arrives_s)
        self._free_s = ends_s if ends_s > t_s else self._free_s


def _to(on_output: Callable[[int, float, float], None], place: int) -> Callable[[float, float], None]:
    return lambda t_s, volts: on_output(place, t_s, volts)


def _inverted(data: bytes) -> bytes:
    return bytes(byte ^ 0xFF for byte in data)
