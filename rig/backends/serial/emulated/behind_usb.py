"""A device in virtual time behind a USB adapter: port and clock in one, like the device itself."""

from __future__ import annotations

import contextlib

from rig.backends.emulated.plug import Until
from rig.backends.links.usb_adapters import Adapter
from rig.backends.serial.emulated.usb_chip import UsbChip
from rig.backends.serial.emulated.virtual_device import PortAndClock
from rig.core.faults import Fault


class BehindUsb:
    """A virtual device whose bytes go through an adapter, both ways. Its time passes as the device's does.

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
