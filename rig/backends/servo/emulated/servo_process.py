"""The emulated servo bus in real time: a process behind a pseudo-terminal, which ``servo_board`` starts."""

from __future__ import annotations

import contextlib
import termios
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TextIO

from rig.backends.emulated.line_faults import Corruption
from rig.backends.emulated.real_time import BehindPty, Look, parser, run, unpacked
from rig.backends.servo.emulated.bus import ServoBus
from rig.backends.servo.emulated.device import Device

_BAUDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}


class _ToldBus(ServoBus):
    """A bus that writes each violation to a file before the host hears what came of it."""

    def __init__(self, device: Device, file: TextIO | None) -> None:
        corruption = None if device.corruption is None else Corruption(*device.corruption)
        super().__init__(device.servos, device.line, corruption, device.reply_fault, keeps_log=False)
        self._file, self._told = file, 0

    def advance_to(self, t_s: float) -> None:
        super().advance_to(t_s)
        if self._file is not None and len(self.violations) > self._told:
            for at_s, id, what in self.violations[self._told :]:
                self._file.write(f"{at_s:.6f},{id},{what}\n")
            self._file.flush()
            self._told = len(self.violations)


class _Served(BehindPty):
    """The bus as a device; looked at is its first servo."""

    def __init__(self, bus: ServoBus, *, follows_baud: bool) -> None:
        super().__init__(bus)
        self._bus = bus
        # before anybody knows the name, and sets another speed
        self._set_at_first = termios.tcgetattr(self._pty)[5] if follows_baud else None

    def watch(self, changed: Callable[[], None]) -> None:
        self._bus.watch(lambda place, t_s, volts: changed() if place == 0 else None)

    def look(self) -> Look:
        t = self._bus.servos[0].truth()
        return Look(t.t_s, t.motor_V, t.y_rad, t.v_rad_per_s, t.errors)

    def serve(self, ready: set[int], now: Callable[[], float]) -> None:
        if self._pty in ready:
            speed = termios.tcgetattr(self._pty)[5]
            if self._set_at_first is not None and speed != self._set_at_first and speed in _BAUDS:
                self._bus.line = replace(self._bus.line, baud=_BAUDS[speed])
        super().serve(ready, now)

    def power_cycle(self) -> None:
        for servo in self._bus.servos:
            servo.power_cycle()

    def power_off(self) -> None:
        """Nothing is left to tell."""


def main() -> None:
    """As ``rig.backends.emulated.real_time``."""
    options = parser(__doc__)
    options.add_argument("--violations", type=Path)
    asked = options.parse_args()

    def opened(stack: contextlib.ExitStack) -> _Served:
        path = asked.violations
        file = None if path is None else stack.enter_context(path.open("w", encoding="ascii"))
        device = unpacked(asked.device, Device)
        return _Served(_ToldBus(device, file), follows_baud=device.follows_baud)

    run(asked, opened)


if __name__ == "__main__":
    main()
