"""A device in virtual time: line and clock in one, so that waiting for a byte makes time pass."""

from __future__ import annotations

from typing import Protocol

from typing_extensions import override

from rig.backends.clock import VirtualClock
from rig.backends.emulated.plug import Plug


class Wire(Protocol):
    """A line with the device at its end. All times are the device's, s."""

    def send(self, data: bytes, t_s: float) -> None:
        """The host hands bytes to the wire at ``t_s``, not before what it was advanced to."""

    def receive(self, t_s: float) -> bytes:
        """What has reached the host by ``t_s`` since the last call."""

    def next_reply_s(self) -> float:
        """When the host gets its next bytes, as far as that is known; inf for never."""

    def next_event_s(self) -> float:
        """When something happens next without the host; inf for never."""

    def advance_to(self, t_s: float) -> None:
        """Let time pass to ``t_s`` for line and device."""


class InVirtualTime(VirtualClock):
    """A ``Clock`` whose time, from 0 on, passes for a device, too."""

    @override
    def sleep_until(self, t_s: float) -> float:
        self._run_to(t_s)
        return self._now_s

    def _run_to(self, t_s: float) -> None:
        super().sleep_until(t_s)
        self._advance()

    def _advance(self) -> None:
        """Let the device do what is due by now."""
        raise NotImplementedError


class WireInVirtualTime(InVirtualTime, Plug):
    """A wire as a ``Transport`` that is a ``Clock``, too.

    wire    whose time passes with this one's
    device  as of ``Plug``
    """

    def __init__(self, wire: Wire, device: str) -> None:
        InVirtualTime.__init__(self)
        Plug.__init__(self, device)
        self._wire = wire

    def write(self, data: bytes) -> None:
        """Hand ``data`` to the wire; takes no time. Raises Fault LINK_LOST when unplugged."""
        self._check_plug()
        self._wire.send(data, self._now_s)

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, at least one byte; b"" after ``timeout_s`` of virtual time without any.

        A reply arrives whole, when its last bit does. Raises Fault LINK_LOST when unplugged.
        """
        self._check_plug()
        until_s = self._now_s + max(timeout_s, 0.0)
        self._run_to(self._now_s)
        while self._wire.next_reply_s() > self._now_s and self._now_s < until_s:
            self._run_to(min(self._wire.next_event_s(), until_s))
        return self._wire.receive(self._now_s)

    @override
    def _advance(self) -> None:
        self._wire.advance_to(self._now_s)
