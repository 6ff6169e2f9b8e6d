"""A client on a register bus: one request and one reply at a time, and when the device executed it.

What goes over the line is the ``Protocol``'s. Within a tick the client asks once only: a time-out, or a reply that does
not fit, is a fault.
"""

from __future__ import annotations

import math
import typing
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from rig.backends.driver import Transport
from rig.core.faults import Fault

ATTEMPTS = 3  # of a request outside the tick
LATE_TIMEOUTS = 2  # time-outs until the latest reply has come
_UNASKED_BYTES = 5  # the shortest reply; fewer between two exchanges are noise on the line
_TOO_SOON = 0.5  # of the fastest exchange: no device replies within it
_ENDLESS_BYTES = 2000  # of a line that is never quiet
_new = tuple.__new__  # of a named tuple, without a call in between


class Damaged(Exception):
    """Bytes that are no frame, in words."""


class Frame(typing.Protocol):
    """One reply as it came."""

    @property
    def pdu(self) -> bytes:
        """What it holds, without address and check sum."""

    @property
    def length(self) -> int:
        """Bytes on the wire."""


class Request(typing.Protocol):
    """What is asked."""

    @property
    def about(self) -> str:
        """Its subject in words, for a fault."""


Req = TypeVar("Req", bound=Request)


class Protocol(ABC, Generic[Req]):
    """What goes over a line to one device, and what it takes.

    refusal             code of the fault by which the device refuses a request
    late_come_together  replies that were late come together, in order; else what does not fit is thrown away whole
    name                the device on its line, for people
    pause_s             least silence between two frames, s
    turnaround_s        the device's own time, s
    """

    refusal: ClassVar[str]
    late_come_together: bool = False
    name: str
    pause_s: float = 0.0
    turnaround_s: float = 0.0

    @abstractmethod
    def encode(self, request: Req) -> bytes:
        """The bytes of a request."""

    def expected(self, data: bytes, request: Req) -> bytes | None:
        """The pdu of ``data``, where all of it is quickly seen to be the reply as it must be; else None."""
        return None

    @abstractmethod
    def take(self, data: bytes, request: Req) -> Any:
        """The ``Frame`` that ``data`` begins with; None while it is not whole. Raises Damaged where it never will."""

    @abstractmethod
    def check(self, frame: Any, request: Req) -> None:
        """Check that a frame is the reply to the last request. Raises Fault LINK_REPLY, LINK_UNIT, or the refusal."""

    @abstractmethod
    def wire_s(self, n_bytes: int) -> float:
        """Time that bytes take on the wire, s."""


class Reply(NamedTuple):
    """A reply that fits its request, and when the device executed that, host time s: as soon as it could.

    latest_s    when it executed that at the latest: all that the exchange took beyond the sum was before
    reckoned_s  time that the config gives the exchange
    at_most_s   from before the request was written: a host that stands still makes it longer, never shorter
    """

    pdu: bytes
    executed_s: float
    latest_s: float
    round_trip_s: float
    reckoned_s: float
    at_most_s: float


class BusClient(Generic[Req]):
    """Asks one device on a bus.

    transport  an open port; times are in its clock, s
    protocol   what goes over it
    is_suspect bytes of an exchange that went wrong may still be on their way
    """

    def __init__(self, transport: Transport, protocol: Protocol[Req]) -> None:
        self.is_suspect = False
        self._transport = transport
        self._protocol = protocol
        self._pace = 1.0  # share of what the config says that the fastest exchange took, at most 1
        self._quiet_until_s = -math.inf  # a new request must not begin before
        self._reckoned: dict[tuple[int, int], tuple[float, float]] = {}  # by the bytes of request and reply
        self._counts = dict.fromkeys(("exchanges", "timeouts", "bad_replies", "exceptions", "stale_bytes"), 0)

    @property
    def statistics(self) -> Mapping[str, int]:
        """Counts since construction, by name.

        exchanges: requests whose reply the client waited for; timeouts: those without a whole reply in time;
        bad_replies: damaged, of another unit, or of another request; exceptions: refusals by the device;
        stale_bytes: bytes that came when nothing was asked.
        """
        return dict(self._counts)

    def set_pace(self, fast: Reply) -> None:
        """Scale the config's exchange times down to a fast real exchange, from now on."""
        if fast.reckoned_s > 0.0:
            self._pace = min(fast.at_most_s / fast.reckoned_s, 1.0)

    def misfit(self, detail: str) -> Fault:
        """The fault to raise for a reply whose values do not fit; counted as a bad one."""
        return self._counted(Fault("LINK_REPLY", detail))

    # ------------------------------------------------------------------ exchanges

    def patiently(self, request: Req, timeout_s: float) -> Reply:
        """``asked`` up to three times, for requests that may be repeated; where there is time for late bytes."""
        for _ in range(ATTEMPTS - 1):
            try:
                return self.asked(request, timeout_s)
            except Fault as fault:
                if fault.code not in ("LINK_TIMEOUT", "LINK_REPLY"):
                    raise
            # a reply may carry no number: a late one would be taken for the next, and each one after it, too
            self.wait((LATE_TIMEOUTS - 1) * timeout_s)
        return self.asked(request, timeout_s)

    def asked(self, request: Req, timeout_s: float, *, in_tick: bool = False, idle_s: float = 0.0) -> Reply:
        """The reply to a request.

        in_tick  anything but the reply is a fault, bytes before the request that nobody asked for are one, and what
                 follows on the line is suspect; the silence before it is a part of ``timeout_s``. Else what is not the
                 reply is thrown away, until the time is over
        idle_s   for so long nothing is asked
        Raises Fault LINK_TIMEOUT, LINK_REPLY, LINK_UNIT, LINK_LOST, or the device's refusal.

        It is one function because each call of another one costs as much as all that most of them do: between two
        ticks the processor has forgotten them.
        """
        transport, protocol, now_s = self._transport, self._protocol, self._transport.now_s
        from_s = now_s()
        data = b""
        try:
            if idle_s > 0.0 or from_s < self._quiet_until_s or (data := transport.read(0.0)):
                unasked = self._drain(data, from_s + idle_s)
                if in_tick and unasked >= _UNASKED_BYTES:
                    raise self.misfit(
                        f"{unasked} bytes that nobody asked for: another master, or two answers to one request"
                    )
                data, begun_s, from_s = b"", from_s, now_s()
                if in_tick:
                    timeout_s = max(timeout_s - (from_s - begun_s), 0.0)
            asked = protocol.encode(request)
            transport.write(asked)
            by_s = now_s()  # it left between these two
            self._counts["exchanges"] += 1
            until_s = by_s + timeout_s
            left_s = timeout_s
            objection: Fault | None = None
            while True:
                # when the time is over whatever is there still counts: it is this process that was late, then
                more = transport.read(left_s if left_s > 0.0 else 0.0)
                if not more and left_s <= 0.0:
                    break
                data += more
                received_s = now_s()
                self._quiet_until_s = received_s + protocol.pause_s
                left_s = until_s - received_s
                while data:
                    frame: Frame | None = None
                    try:
                        if (pdu := protocol.expected(data, request)) is None:
                            frame = protocol.take(data, request)
                            if frame is None:
                                break
                            protocol.check(frame, request)
                            pdu = frame.pdu
                    except Damaged as damaged:
                        objection = self.misfit(f"asked for {request.about}: {damaged}")
                    except Fault as fault:
                        objection = self._counted(fault)
                        if fault.code == protocol.refusal:
                            raise
                    else:
                        length = len(data)
                        if frame is not None and length > frame.length:
                            length = frame.length
                            self._count_extra(data, length, strict=in_tick)
                        if (ways := self._reckoned.get((len(asked), length))) is None:
                            ways = self._reckoned[len(asked), length] = self._reckoned_s(len(asked), length)
                        to_device_s, reckoned_s = ways
                        # a host that stood still while it sent, did so before the request left, unless the reply was
                        # there too soon
                        since_s = by_s if received_s - by_s >= _TOO_SOON * self._pace * reckoned_s else from_s
                        took_s = received_s - since_s
                        # what it took beyond the sum is taken for the way back: a request leaves at once, but a reply
                        # waits for the adapter, the system's buffers and this process (measured in docs/modbus.md); of
                        # an exchange quicker than the sum both ways were
                        to_s = self._pace * to_device_s
                        if reckoned_s > 0.0 and (share_s := took_s * to_device_s / reckoned_s) < to_s:
                            to_s = share_s
                        executed_s = since_s + to_s
                        beyond_s = took_s - self._pace * reckoned_s
                        latest_s = executed_s + beyond_s if beyond_s > 0.0 else executed_s
                        return _new(Reply, (pdu, executed_s, latest_s, took_s, reckoned_s, received_s - from_s))
                    if in_tick:
                        raise objection
                    # where replies that were late come together, the one to this request is the last
                    dropped = frame.length if frame is not None and protocol.late_come_together else len(data)
                    self._counts["stale_bytes"] += dropped
                    data = data[dropped:]
            self._counts["timeouts"] += 1
            about = request.about
            if data:
                raise self.misfit(f"asked for {about}: {len(data)} bytes that are no whole reply, {data[:24].hex(' ')}")
            raise objection or Fault(
                "LINK_TIMEOUT", f"no reply from {protocol.name} within {timeout_s * 1e3:.3g} ms, asked for {about}"
            )
        except Fault:
            self.is_suspect = self.is_suspect or in_tick
            raise

    def unheard(self, request: Req, wait_s: float) -> None:
        """Send a request and throw away all that comes within ``wait_s``. After it nothing is suspect."""
        self._drain(b"", -math.inf)
        data = self._protocol.encode(request)
        self._transport.write(data)
        self._quiet_until_s = self._transport.now_s() + self._protocol.wire_s(len(data)) + self._protocol.pause_s
        self.wait(wait_s)
        self.is_suspect = False

    def wait(self, wait_s: float) -> None:
        """Ask nothing for so long, and throw away what comes."""
        until_s = self._transport.now_s() + wait_s
        while (left_s := until_s - self._transport.now_s()) > 0.0:
            self._throw_away(self._transport.read(left_s))

    # ------------------------------------------------------------------ bytes

    def _drain(self, data: bytes, until_s: float) -> int:
        """Throw away what came unasked, and let the line be silent as long as it must; how many bytes.

        data     what has come already
        until_s  what comes before came ahead of the next request
        """
        thrown, now_s = 0, self._transport.now_s
        while True:
            if data:
                thrown += len(data)
                self._throw_away(data)
                if thrown > _ENDLESS_BYTES:
                    raise self.misfit(f"{thrown} bytes that nobody asked for, and more: the line is never quiet")
            quiet_s = max(self._quiet_until_s, until_s)
            data = self._transport.read(max(quiet_s - now_s(), 0.0))
            if not data and quiet_s <= now_s():
                return thrown

    def _throw_away(self, data: bytes) -> None:
        if data:
            self._counts["stale_bytes"] += len(data)
            self._quiet_until_s = self._transport.now_s() + self._protocol.pause_s

    def _count_extra(self, data: bytes, length: int, *, strict: bool) -> None:
        """Bytes beyond the reply are stale; within the tick many of them are a fault."""
        extra = len(data) - length
        self._counts["stale_bytes"] += extra
        if strict and extra >= _UNASKED_BYTES:
            raise self.misfit(
                f"{extra} bytes beyond the reply: another master, or two answers to one request; the reply is "
                f"{data[:length].hex(' ')}"
            )

    def _reckoned_s(self, sent_bytes: int, received_bytes: int) -> tuple[float, float]:
        """What an exchange takes by the config: until the device executes it, and until the reply is here."""
        half_s = 0.5 * self._protocol.turnaround_s
        to_device_s = self._protocol.wire_s(sent_bytes) + self._protocol.pause_s + half_s
        return to_device_s, to_device_s + half_s + self._protocol.wire_s(received_bytes)

    def _counted(self, fault: Fault) -> Fault:
        self._counts["exceptions" if fault.code == self._protocol.refusal else "bad_replies"] += 1
        return fault
