"""A serial device in real time: the one of virtual time, in a process in which its time follows the clock.

``serial_board`` starts it.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable

from rig.backends.emulated.real_time import BehindPty, Look, Served
from rig.backends.links.usb_adapters import Adapter
from rig.backends.serial.emulated.behind_usb import BehindUsb
from rig.backends.serial.emulated.firmware_build import require_emulator
from rig.backends.serial.emulated.virtual_device import PortAndClock

_EXTERNAL, _POWER_ON = 2, 1  # causes of a reset


class _Wire:
    """A port in virtual time as a ``Wire``, which runs at least once in each step, s, of the device."""

    def __init__(self, port: PortAndClock | BehindUsb, step_s: float) -> None:
        self._port, self._step_s = port, step_s
        self.stepped: Callable[[], None] | None = None  # after each step, if somebody looks

    def send(self, data: bytes, t_s: float) -> None:
        self.advance_to(t_s)
        self._port.write(data)

    def receive(self, t_s: float) -> bytes:
        return self._port.read(0.0)

    def next_reply_s(self) -> float:
        return math.inf

    def next_event_s(self) -> float:
        return self._step_s * (math.floor(self._port.now_s() / self._step_s + 1e-6) + 1)

    def advance_to(self, t_s: float) -> None:
        while self.stepped is not None and self.next_event_s() < t_s:
            self._port.sleep_until(self.next_event_s())
            self.stepped()
        self._port.sleep_until(t_s)
        if self.stepped is not None:
            self.stepped()


class _Served(BehindPty):
    """The device, behind its adapter.

    last  of the columns of the trace, as the device's truth names it
    """

    def __init__(self, device: PortAndClock, adapter: Adapter, last: str) -> None:
        self._line = _Wire(device if adapter == "none" else BehindUsb(device, adapter), device.step_s)
        super().__init__(self._line)
        self._device, self.last = device, last
        self._changed_s = -1.0
        self._changed: Callable[[], None] = lambda: None

    def watch(self, changed: Callable[[], None]) -> None:
        self._changed, self._line.stepped = changed, self._tell_changes

    def _tell_changes(self) -> None:
        if (changed_s := self._device.truth().pin_changed_s) != self._changed_s:
            self._changed_s = changed_s
            self._changed()

    def look(self) -> Look:
        truth = self._device.truth()
        return Look(truth.t_s, truth.pin_V, truth.y_rad, truth.v_rad_per_s, int(getattr(truth, self.last)))

    def power_cycle(self) -> None:
        """Its reset button: a board's supply comes over USB."""
        self._reset(_EXTERNAL)

    def power_off(self) -> None:
        self._reset(_POWER_ON)

    def _reset(self, cause: int) -> None:
        self._device.reset(cause)
        self._changed()


def served(make: bytes, port: str, adapter: Adapter) -> Served:
    """The device, at its time 0.

    make  what makes it, pickled by itself: of a chip it can be read only where the emulator is found
    port  word of daq.port for it
    """
    require_emulator(port)
    return _Served(pickle.loads(make)(), adapter, "fault" if port == "emulated" else "led")
