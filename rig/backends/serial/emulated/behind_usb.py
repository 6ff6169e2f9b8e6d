"""A USB adapter, which passes bytes on with the frames of USB; and a device in virtual time behind it."""

from __future__ import annotations

import contextlib
import math

from rig.backends.emulated.plug import Until
from rig.backends.emulated.under_way import UnderWay
from rig.backends.links.usb_adapters import CHIPS, FRAME_S, Adapter
from rig.backends.serial.emulated.virtual_device import PortAndClock
from rig.core.faults import Fault

_ROUNDING = 1e-6  # of a frame


class UsbChip:
    """One adapter, plugged in at time 0, as its timer and the frames of USB are. Pure: the caller gives the time.

    adapter  of ``rig.backends.links.usb_adapters.CHIPS``; KeyError for "none"
    """

    def __init__(self, adapter: Adapter) -> None:
        self._chip = CHIPS[adapter]
        self._kept = bytearray()  # from the device, not handed on yet
        self._kept_until_s = math.inf
        self._packet_s = 0.0  # when the last packet went
        self._to_host, self._to_device = UnderWay[bytes](), UnderWay[bytes]()

    def from_host(self, data: bytes, t_s: float) -> None:
        """The host has written ``data``."""
        self._to_device.send(data, _next_frame_s(t_s))

    def from_device(self, data: bytes, t_s: float) -> None:
        """The last bit of ``data`` has come over the line."""
        self._pass(t_s)
        self._kept += data
        if len(self._kept) >= self._chip.packet_bytes or self._chip.counted == "none":
            self._hand_on(t_s)
        elif self._chip.counted == "pause":
            self._kept_until_s = t_s + self._chip.wait_s
        elif not math.isfinite(self._kept_until_s):
            began_s = self._packet_s if self._chip.counted == "last packet" else 0.0
            ticks = math.floor((t_s - began_s) / self._chip.wait_s) + 1  # an empty packet begins the wait anew, too
            self._kept_until_s = began_s + ticks * self._chip.wait_s

    def next_s(self) -> float:
        """When something is due next; inf: nothing is on its way."""
        return min(self._kept_until_s, self._to_host.next_s(), self._to_device.next_s())

    def for_host(self, t_s: float) -> bytes:
        """What has reached the host by ``t_s``, and was not taken yet."""
        self._pass(t_s)
        return b"".join(self._to_host.arrived(t_s))

    def for_device(self, t_s: float) -> bytes:
        """What goes out on the line at ``t_s``."""
        return b"".join(self._to_device.arrived(t_s))

    def _pass(self, t_s: float) -> None:
        """Let the timer run."""
        if self._kept_until_s <= t_s:
            self._hand_on(self._kept_until_s)

    def _hand_on(self, t_s: float) -> None:
        self._to_host.send(bytes(self._kept), _next_frame_s(t_s))
        self._kept.clear()
        self._kept_until_s = math.inf
        self._packet_s = t_s


def _next_frame_s(t_s: float) -> float:
    return math.ceil(t_s / FRAME_S - _ROUNDING) * FRAME_S


class BehindUsb:
    """A virtual device whose bytes go through an adapter, both ways. Its time passes as the device's does.

    Port and clock in one, like the device itself.

    device   powered on; used through this from now on
    adapter  of ``rig.backends.links.usb_adapters.CHIPS``
    """

    absolute = True  # of the clock

    def __init__(self, device: PortAndClock, adapter: Adapter) -> None:
        self.device = device
        device.reads = Until.BYTE  # it collects them itself
        self._chip = UsbChip(adapter)
        self._arrived = b""  # at the host, not read yet

    def write(self, data: bytes) -> None:
        """Hand ``data`` to the adapter; takes no time. Raises Fault LINK_LOST when unplugged."""
        self.device.write(b"")
        self._chip.from_host(data, self.now_s())

    def read(self, timeout_s: float) -> bytes:
        """What has reached the host, at least one byte; b"" after ``timeout_s`` of virtual time without any.

        Raises Fault LINK_LOST when unplugged.
        """
        until_s = self.now_s() + max(timeout_s, 0.0)
        while True:
            self._step(until_s)
            if self._arrived or self.now_s() >= until_s:
                data, self._arrived = self._arrived, b""
                return data

    def now_s(self) -> float:
        """Virtual time, s."""
        return self.device.now_s()

    def sleep_until(self, t_s: float) -> float:
        """Let time pass to ``t_s``, none if that is past; the time then, s."""
        with contextlib.suppress(Fault):  # unplugged: nothing passes, but time does
            while self.now_s() < t_s:
                self._step(t_s)
        return self.device.sleep_until(t_s)

    def close(self) -> None:
        """Close the port. Device and adapter live on. May be called twice."""
        self.device.close()

    def _step(self, until_s: float) -> None:
        """Let time pass to the next thing that happens, to ``until_s`` at most."""
        now_s = self.now_s()
        if data := self._chip.for_device(now_s):
            self.device.write(data)
        if arrived := self.device.read(max(min(self._chip.next_s(), until_s) - now_s, 0.0)):
            self._chip.from_device(arrived, self.now_s())
        self._arrived += self._chip.for_host(self.now_s())
