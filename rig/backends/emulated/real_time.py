"""An emulated device in real time, as its own process runs it. It prints ``port NAME`` when it is ready.

It sleeps between requests, for 20 ms at most, and then catches up with the device's milliseconds. From outside that
looks the same as doing them in time.
"""

from __future__ import annotations

import base64
import contextlib
import gc
import math
import os
import pickle
import pty
import select
import signal
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, NoReturn, Protocol, TextIO

from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.virtual_time import Wire

_ORPHAN_S = 0.3  # they outlive their parent by this time, so that one can see the watchdog act
_PRIORITY = 70  # above the loop's 60: a real device does not wait for the host's processor
_TRACE_S = 0.01
_CATCH_UP_S = 0.02  # longest sleep: what is caught up with then takes 0.1 ms
_STALL_S = 10.0  # longer than a host measures a clock for: time that a device loses then looks like a restart


class Look(NamedTuple):
    """A row of the trace: time, s, voltage at the motor, V, its shaft, and the number of its fault, or else."""

    t_s: float
    drive_V: float
    y_rad: float
    v_rad_per_s: float
    last: int


class Served(Protocol):
    """A device with its port, ``name``. All times are the device's, s. ``last``: of the columns of the trace."""

    name: str
    last: str

    def watch(self, changed: Callable[[], None]) -> None:
        """Call that at each change of the voltage at the motor."""

    def look(self) -> Look:
        """What is really the case now."""

    def files(self) -> list[int]:
        """What to wait for."""

    def serve(self, ready: set[int], now: Callable[[], float]) -> None:
        """Take what has come in, without waiting; then let time pass to ``now``, at which it came.

        The time is read last: a device hears nothing before its host has said it.
        """

    def next_event_s(self) -> float:
        """When it has something to do next; inf for never."""

    def advance_to(self, t_s: float) -> None:
        """Let time pass, and send what is due."""

    def power_cycle(self) -> None:
        """Its supply fails for a moment."""

    def power_off(self) -> None:
        """Its supply fails for good."""


class BehindPty:
    """The port of a wire behind a pseudo-terminal, whose other end is held open: it lives on while no host has it."""

    last = "fault"

    def __init__(self, wire: Wire) -> None:
        self._wire = wire
        self._pty, self.name = _open_pty()

    def files(self) -> list[int]:
        """As of ``Served``."""
        return [self._pty]

    def serve(self, ready: set[int], now: Callable[[], float]) -> None:
        """As of ``Served``."""
        if self._pty in ready:
            with contextlib.suppress(BlockingIOError):
                data = os.read(self._pty, 4096)
                self._wire.send(data, now())

    def next_event_s(self) -> float:
        """As of ``Served``."""
        return self._wire.next_event_s()

    def advance_to(self, t_s: float) -> None:
        """As of ``Served``."""
        self._wire.advance_to(t_s)
        reply = self._wire.receive(t_s)
        if reply:
            with contextlib.suppress(BlockingIOError):  # nobody reads
                os.write(self._pty, reply)


def main() -> None:
    """Run until a signal, or until standard input ends. ``BoardProcess`` packs what makes the device."""
    make: Callable[[], Served]
    link: Path | None
    trace: Path | None
    ends = _signals()
    make, link, trace = pickle.loads(base64.b64decode(sys.argv[1]))
    # when all is loaded: for what that takes a kernel takes its share back when replies are due. And before a device
    # starts a process, which inherits it
    _take_priority()
    try:
        with contextlib.ExitStack() as stack:
            file = None if trace is None else stack.enter_context(trace.open("w", encoding="ascii"))
            device = make()
            rows = _Trace(device, file)
            if link is not None:
                stack.enter_context(_linked(link, device.name))
            sys.stdout.write(f"port {device.name}\n")
            sys.stdout.flush()
            gc.freeze()
            _run(device, rows, ends)
            device.power_off()
    except (OSError, EmulationError) as error:
        _fail(str(error))


class _Clock:
    """The device's time, from 0 on: that of CLOCK_MONOTONIC, but for stalls that are too long to catch up with."""

    def __init__(self) -> None:
        self.start_s = time.monotonic()
        self._last_s = 0.0

    def now_s(self) -> float:
        stood_s = time.monotonic() - self.start_s - self._last_s
        if stood_s > _STALL_S:
            sys.stderr.write(f"the emulated device stood still for {stood_s:.1f} s, and its clock with it\n")
            self.start_s += stood_s
        self._last_s = time.monotonic() - self.start_s
        return self._last_s


class _Trace:
    """The truth over time as CSV; nothing without a file."""

    def __init__(self, device: Served, file: TextIO | None) -> None:
        self._device, self._file, self._clock = device, file, _Clock()
        self.next_s = math.inf if file is None else 0.0
        if file is not None:
            file.write(f"t_s,drive_V,y_rad,v_rad_per_s,{device.last}\n")
            device.watch(self.row)

    def row(self) -> None:
        if self._file is None:
            return
        t_s, drive_V, y_rad, v_rad_per_s, last = self._device.look()
        self._file.write(f"{self._clock.start_s + t_s:.6f},{drive_V:.6f},{y_rad:.6f},{v_rad_per_s:.6f},{last}\n")
        self._file.flush()

    def advance(self) -> float:
        """Let the device's time pass to now, which is returned; with one row every 10 ms."""
        now_s = self._clock.now_s()
        while self.next_s <= now_s:
            self._device.advance_to(self.next_s)
            self.row()
            self.next_s += _TRACE_S
        self._device.advance_to(now_s)
        return now_s


def _run(device: Served, trace: _Trace, ends: int) -> None:
    end_s, stdin, watches_stdin = math.inf, sys.stdin.fileno(), True
    now_s = trace.advance()
    while now_s < end_s:
        files = [ends, *device.files(), *([stdin] if watches_stdin else [])]
        until_s = min(device.next_event_s(), trace.next_s, end_s, now_s + _CATCH_UP_S)
        ready = set(select.select(files, [], [], max(until_s - now_s, 0.0))[0])
        now_s = trace.advance()
        if ends in ready:
            if os.read(ends, 1)[0] != signal.SIGUSR1:
                return
            device.power_cycle()
        if stdin in ready and not os.read(stdin, 64):
            watches_stdin, end_s = False, now_s + _ORPHAN_S
        if not ready.isdisjoint(device.files()):
            device.serve(ready, trace.advance)
            now_s = trace.advance()


def _open_pty() -> tuple[int, str]:
    """A pseudo-terminal that passes every byte as it is, and the name of its port.

    It lives on while nobody has that open.
    """
    number, held = pty.openpty()
    raw = termios.tcgetattr(held)
    raw[0] = raw[1] = raw[3] = 0
    raw[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
    termios.tcsetattr(held, termios.TCSANOW, raw)
    os.set_blocking(number, False)
    return number, os.ttyname(held)


def _signals() -> int:
    """File number from which a byte can be read after each signal."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, lambda number, frame: None)
    signal.set_wakeup_fd(writer)
    return reader


@contextlib.contextmanager
def _linked(path: Path, port: str) -> Iterator[None]:
    """The symbolic link, made or replaced in one step; refuses to replace anything else. Removed if still ours."""
    if path.exists() and path.is_symlink():
        _fail(f"{path}: is the link of a device that exists: end that one, or choose another name")
    if path.exists():
        _fail(f"{path}: exists and is not a symbolic link")
    fresh = path.with_name(f"{path.name}.{os.getpid()}")
    fresh.symlink_to(port)
    fresh.rename(path)
    try:
        yield
    finally:
        if path.is_symlink() and str(path.readlink()) == port:
            path.unlink()


def _take_priority() -> None:
    """Take a real-time priority if that is allowed; else say so."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except PermissionError as error:
        sys.stderr.write(f"no real-time priority ({error.strerror}): replies may be late on a busy machine\n")


def _fail(why: str) -> NoReturn:
    """Say why on standard error, and end with 2."""
    sys.stderr.write(f"{why}\n")
    sys.exit(2)
