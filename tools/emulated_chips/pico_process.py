"""The Pico's emulated chip in real time: a process whose virtual time follows the clock, behind a pseudo-terminal.

``pico_board`` starts it. It prints ``port NAME`` when it is ready. SIGUSR1 is the reset button. At the end the power is
cut: 0 V at the bridge.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import math
import os
import select
import signal
import sys
import time
from pathlib import Path
from typing import TextIO

from emulated_chips.truth import ChipTruth
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.emulated.device_process import ORPHAN_S, fail, linked, open_pty, signals, take_priority
from rig.backends.emulated.errors import EmulationError

_STEP_S = 0.001
_STALL_S = 10.0  # longer than a host measures the clock for: time that the chip loses then looks like a restart
_TRACE_EVERY_S = 0.010
_EXTERNAL, _POWER_ON = 2, 1  # causes of a reset
_BYTES = 4096


def main() -> None:
    """Run until a signal, or until standard input ends where that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chip", required=True, type=json.loads, help="parameters of the chip, as JSON")
    parser.add_argument("--link", type=Path)
    parser.add_argument("--trace", type=Path)
    parser.add_argument("--exit-with-stdin", action="store_true")
    asked = parser.parse_args()
    ends = signals()
    take_priority()  # before the chip's process starts, which inherits it
    try:
        chip = VirtualPico(asked.chip)
        host, name = open_pty()
        with contextlib.ExitStack() as stack:
            if asked.link is not None:
                stack.enter_context(linked(asked.link, name))
            rows = None if asked.trace is None else stack.enter_context(asked.trace.open("w", encoding="ascii"))
            gc.freeze()
            board = _Board(chip, host, rows)
            sys.stdout.write(f"port {name}\n")
            sys.stdout.flush()
            board.run(ends, watches_stdin=asked.exit_with_stdin)
            board.cut_the_power()
    except (OSError, EmulationError) as error:
        fail(str(error))


class _Board:
    """The chip, the pseudo-terminal's number, and where the truth is traced."""

    def __init__(self, chip: VirtualPico, host: int, rows: TextIO | None) -> None:
        self._chip = chip
        self._host = host
        self._rows = rows
        self._start_s = time.monotonic() - chip.now_s()
        self._traced_s = self._changed_s = -math.inf
        if rows is not None:
            rows.write("t_s,drive_V,y_rad,v_rad_per_s,led\n")

    def run(self, ends: int, *, watches_stdin: bool) -> None:
        """Until a signal ends it."""
        end_s, stdin = math.inf, sys.stdin.fileno()
        while (now_s := time.monotonic()) < end_s:
            files = [ends, self._host, *([stdin] if watches_stdin else [])]
            due_s = self._start_s + self._chip.now_s() + _STEP_S
            ready = select.select(files, [], [], max(due_s - now_s, 0.0))[0]
            if ends in ready:
                if any(number != signal.SIGUSR1 for number in os.read(ends, 64)):
                    return
                self._chip.reset(_EXTERNAL)
            if stdin in ready and not os.read(stdin, 64):
                watches_stdin, end_s = False, now_s + ORPHAN_S
            self._carry()

    def cut_the_power(self) -> None:
        """0 V at the pins, and the last row of the trace."""
        self._chip.reset(_POWER_ON, 1.0)
        self._trace(self._chip.truth(), at_any_rate=True)
        self._chip.end()

    def _carry(self) -> None:
        """Bytes both ways, and the chip's time up to now.

        The time is read after the bytes, and they go on the wire at that time. So the chip hears nothing before the
        host has said it, however long this process or the chip's stood still.
        """
        sent = b""
        with contextlib.suppress(BlockingIOError, OSError):  # nobody has opened the port
            sent = os.read(self._host, _BYTES)
        now_s = time.monotonic()
        behind_s = now_s - self._start_s - self._chip.now_s()
        if behind_s > _STALL_S:
            sys.stderr.write(f"the emulated Pico stood still for {behind_s:.1f} s, and its clock with it\n")
            self._start_s += behind_s
        self._chip.sleep_until(now_s - self._start_s)
        self._chip.write(sent)
        if self._rows is not None:
            self._trace(self._chip.truth())
        if arrived := self._chip.read(0.0):
            with contextlib.suppress(BlockingIOError):  # nobody reads
                os.write(self._host, arrived)

    def _trace(self, truth: ChipTruth, *, at_any_rate: bool = False) -> None:
        """A row where the drive at the pins has changed, and each 10 ms."""
        is_due = truth.pin_changed_s > self._changed_s or truth.t_s >= self._traced_s + _TRACE_EVERY_S
        if self._rows is None or not (is_due or at_any_rate):
            return
        self._changed_s, self._traced_s = truth.pin_changed_s, truth.t_s
        t_s = self._start_s + truth.t_s
        row = f"{t_s:.6f},{truth.pin_V:.6f},{truth.y_rad:.6f},{truth.v_rad_per_s:.6f},{truth.led:d}"
        self._rows.write(row + "\n")
        self._rows.flush()
