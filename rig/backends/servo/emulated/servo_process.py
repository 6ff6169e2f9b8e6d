"""The emulated servo bus in real time: a process behind a pseudo-terminal.

``servo_board`` starts it. It prints ``port NAME`` when it is ready. It sleeps between packets, for 20 ms at most, and
then catches up with the servos' milliseconds. From outside that looks the same as doing them in time.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import math
import os
import select
import signal
import sys
import termios
import time
from dataclasses import replace
from pathlib import Path
from typing import TextIO

from rig.backends.emulated.device_process import ORPHAN_S, fail, linked, open_pty, signals, take_priority
from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.line_faults import Corruption
from rig.backends.servo.emulated.bus import ServoBus
from rig.backends.servo.emulated.device import Device, unpacked

_TRACE_S = 0.01
_CATCH_UP_S = 0.02  # longest sleep
_BAUDS = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()}


class _Files:
    """Truth of the first servo over time as CSV, and the violations; each nothing without a file."""

    def __init__(self, bus: ServoBus, trace: TextIO | None, violations: TextIO | None, start_s: float) -> None:
        self._bus, self._trace, self._violations, self._start_s = bus, trace, violations, start_s
        self._told = 0
        self.next_s = math.inf if trace is None else 0.0
        if trace is not None:
            trace.write("t_s,drive_V,y_rad,v_rad_per_s,fault\n")

    def row(self) -> None:
        if self._trace is not None:
            t = self._bus.servos[0].truth()
            t_s = self._start_s + t.t_s
            self._trace.write(f"{t_s:.6f},{t.motor_V:.6f},{t.y_rad:.6f},{t.v_rad_per_s:.6f},{t.errors}\n")
            self._trace.flush()

    def changed(self, place: int) -> None:
        """The voltage at a motor."""
        if place == 0:
            self.row()

    def rows_to(self, t_s: float) -> None:
        """One row every 10 ms."""
        while self.next_s <= t_s:
            self._bus.advance_to(self.next_s)
            self.row()
            self.next_s += _TRACE_S

    def tell(self) -> None:
        """The violations since the last time."""
        if self._violations is not None and len(self._bus.violations) > self._told:
            for t_s, id, what in self._bus.violations[self._told :]:
                self._violations.write(f"{t_s:.6f},{id},{what}\n")
            self._violations.flush()
            self._told = len(self._bus.violations)


def main() -> None:
    """Run until a signal, or until standard input ends where that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", required=True, help="as rig.backends.servo.emulated.servo_board packs it")
    parser.add_argument("--link", type=Path)
    parser.add_argument("--trace", type=Path)
    parser.add_argument("--violations", type=Path)
    parser.add_argument("--exit-with-stdin", action="store_true")
    asked = parser.parse_args()
    ends = signals()
    try:
        with contextlib.ExitStack() as stack:
            trace, violations = (
                None if path is None else stack.enter_context(path.open("w", encoding="ascii"))
                for path in (asked.trace, asked.violations)
            )
            start_s = time.monotonic()
            device = unpacked(asked.device)
            corruption = None if device.corruption is None else Corruption(*device.corruption)
            bus = ServoBus(device.servos, device.line, corruption, device.reply_fault, keeps_log=False)
            files = _Files(bus, trace, violations, start_s)
            bus.watch(lambda place, t_s, volts: files.changed(place))
            pty, name = open_pty()
            if asked.link is not None:
                stack.enter_context(linked(asked.link, name))
            sys.stdout.write(f"port {name}\n")
            sys.stdout.flush()
            take_priority()
            gc.freeze()
            _run(bus, device, pty, files, start_s, ends, watches_stdin=asked.exit_with_stdin)
    except (OSError, EmulationError) as error:
        fail(str(error))


def _run(
    bus: ServoBus, device: Device, pty: int, files: _Files, start_s: float, ends: int, *, watches_stdin: bool
) -> None:
    end_s, stdin = math.inf, sys.stdin.fileno()
    set_at_first = termios.tcgetattr(pty)[5]
    now_s = time.monotonic() - start_s
    while now_s < end_s:
        waited = [ends, pty, *([stdin] if watches_stdin else [])]
        until_s = min(bus.next_event_s(), files.next_s, end_s, now_s + _CATCH_UP_S)
        ready = set(select.select(waited, [], [], max(until_s - now_s, 0.0))[0])
        now_s = time.monotonic() - start_s
        if ends in ready:
            if os.read(ends, 1)[0] != signal.SIGUSR1:
                return
            bus.advance_to(now_s)
            for servo in bus.servos:
                servo.power_cycle()
        if stdin in ready and not os.read(stdin, 64):
            watches_stdin, end_s = False, now_s + ORPHAN_S
        files.rows_to(now_s)
        if pty in ready:
            speed = termios.tcgetattr(pty)[5]
            if device.follows_baud and speed != set_at_first and speed in _BAUDS:
                bus.line = replace(bus.line, baud=_BAUDS[speed])
            with contextlib.suppress(BlockingIOError):
                bus.send(os.read(pty, 4096), now_s)
        bus.advance_to(now_s)
        files.tell()
        answer = bus.receive(now_s)
        if answer:
            with contextlib.suppress(BlockingIOError):  # nobody reads
                os.write(pty, answer)


if __name__ == "__main__":
    main()
