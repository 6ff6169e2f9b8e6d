"""The emulated servo bus in real time: a process behind a pseudo-terminal, which ``servo_board`` starts."""

from __future__ import annotations

import termios
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from rig.backends.emulated.line_faults import Disturbance
from rig.backends.emulated.real_time import BehindPty, Look, Served
from rig.backends.servo.emulated.bus import LineTimes, ServoBus
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.emulated.servo import ServoOptions

_BAUDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}


class _ToldBus(ServoBus):
    """A bus that writes each violation to a file before the host hears what came of it."""

    def __init__(
        self,
        servos: Sequence[ServoOptions],
        line: LineTimes,
        disturbance: Disturbance | None,
        reply_fault: ReplyFault | None,
        violations: Path | None,
    ) -> None:
        super().__init__(servos, line, disturbance, reply_fault, keeps_log=False)
        self._path, self._told = violations, 0
        if self._path is not None:
            self._path.write_bytes(b"")

    def advance_to(self, t_s: float) -> None:
        super().advance_to(t_s)
        if self._path is not None and len(self.violations) > self._told:
            with self._path.open("a", encoding="ascii") as file:
                file.writelines(f"{at_s:.6f},{id},{what}\n" for at_s, id, what in self.violations[self._told :])
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


def served(
    servos: Sequence[ServoOptions],
    line: LineTimes,
    follows_baud: bool,
    reply_fault: ReplyFault | None,
    disturbance: Disturbance | None,
    violations: Path | None,
) -> Served:
    """The bus, at its time 0.

    follows_baud  the line's baud is what the host sets on the port
    violations    file that each violation is appended to; None: nobody asks
    """
    return _Served(_ToldBus(servos, line, disturbance, reply_fault, violations), follows_baud=follows_baud)
