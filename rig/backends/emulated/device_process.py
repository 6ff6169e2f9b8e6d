"""What the processes of emulated devices have in common: pseudo-terminal, signals, link, priority, end."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

ORPHAN_S = 0.3  # they outlive their parent by this time, as the emulated boards do
_PRIORITY = 70  # above the loop's 60: a real device does not wait for the host's processor


def open_pty() -> tuple[int, str]:
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


def signals() -> int:
    """File number from which a byte can be read after each signal."""
    ends, told = os.pipe()
    os.set_blocking(told, False)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, lambda number, frame: None)
    signal.set_wakeup_fd(told)
    return ends


@contextlib.contextmanager
def linked(path: Path, port: str) -> Iterator[None]:
    """The symbolic link, made or replaced in one step; refuses to replace anything else. Removed if still ours."""
    if path.exists() and path.is_symlink():
        fail(f"{path}: is the link of a device that exists: end that one, or choose another name")
    if path.exists():
        fail(f"{path}: exists and is not a symbolic link")
    fresh = path.with_name(f"{path.name}.{os.getpid()}")
    fresh.symlink_to(port)
    fresh.rename(path)
    try:
        yield
    finally:
        if path.is_symlink() and str(path.readlink()) == port:
            path.unlink()


def take_priority() -> None:
    """Take a real-time priority if that is allowed; else say so."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except PermissionError as error:
        sys.stderr.write(f"no real-time priority ({error.strerror}): replies may be late on a busy machine\n")


def fail(why: str) -> NoReturn:
    """Say why on standard error, and end with 2."""
    sys.stderr.write(f"{why}\n")
    sys.exit(2)
