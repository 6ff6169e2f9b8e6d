"""A serial port of this machine as a ``Transport``."""

from __future__ import annotations

import contextlib
import errno
import os
import sys

from typing_extensions import override

from rig.backends.links.holder import holder_of_file
from rig.backends.links.open_link import OpenLink
from rig.backends.links.usb_port import check_board
from rig.core.copies import keep_from_copies, no_longer_own
from rig.core.faults import Fault

_PSEUDO_TERMINALS = range(136, 144)  # major numbers on Linux


class SerialPort(OpenLink):
    """A serial port of this machine, or a pseudo-terminal; held exclusively.

    No other process of rig opens it meanwhile, by whatever link; of a real port also no other program, unless it is
    root's.

    parity       N, E or O
    usb_serial   number on USB that it has to have; None: any
    low_latency  whether the port's driver took the request not to batch what arrives; pseudo-terminals
                 and some USB chips have no such mode
    Raises Fault LINK_OPEN if the port cannot be opened; OTHER_BOARD as ``check_board``.
    """

    def __init__(
        self, port: str, baud: int = 115200, parity: str = "N", stop_bits: int = 1, usb_serial: str | None = None
    ) -> None:
        if sys.platform == "win32":
            raise Fault(
                "LINK_OPEN",
                f"{port}: serial ports work on Linux, and have not been tried on macOS; on Windows a device on Modbus "
                "TCP, or daq.driver: simulated",
            )
        import serial  # not everywhere can it be loaded

        check_board(port, usb_serial)  # first: opening a port resets most boards
        try:
            self._serial = serial.Serial(port, baud, parity=parity, stopbits=stop_bits, timeout=0, exclusive=True)
        except (OSError, ValueError) as error:  # SerialException is an OSError; ValueError: impossible baud
            raise Fault("LINK_OPEN", f"{port}: {_why_not_open(port, error)}") from error
        super().__init__(self._serial.fileno(), port)
        try:
            check_board(port, usb_serial)  # again: the boards may have been plugged in anew meanwhile
        except Fault:
            self._serial.close()
            raise
        self._keep_others_out(keeps=True)
        keep_from_copies(self._fd)
        try:
            self._serial.set_low_latency_mode(True)
            self.low_latency = True
        except (ValueError, NotImplementedError):
            self.low_latency = False

    def keep_on(self) -> None:
        """Leave DTR on when the port is closed: the next opening resets no Arduino, and its encoder keeps its zero."""
        import termios  # not everywhere

        attributes = termios.tcgetattr(self._fd)
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(self._fd, termios.TCSANOW, attributes)

    @override
    def close(self) -> None:
        """Give the port back. May be called twice."""
        if self._fd >= 0:
            self._keep_others_out(keeps=False)
            no_longer_own(self._fd)
        self._fd = -1  # the number may soon be another file's
        self._serial.close()

    def _keep_others_out(self, *, keeps: bool) -> None:
        """Whether the kernel lets others open a real port. A killed process would leave a pseudo-terminal so."""
        import fcntl  # not everywhere
        import termios

        if not _is_pseudo_terminal(self._fd):
            with contextlib.suppress(OSError):  # the port is dead
                fcntl.ioctl(self._fd, termios.TIOCEXCL if keeps else termios.TIOCNXCL)


def _is_pseudo_terminal(descriptor: int) -> bool:
    return os.major(os.fstat(descriptor).st_rdev) in _PSEUDO_TERMINALS


def _why_not_open(port: str, error: OSError | ValueError) -> str:
    """In a few words; pyserial's own name port and cause twice."""
    number = error.errno if isinstance(error, OSError) else None
    if number in (errno.EWOULDBLOCK, errno.EBUSY):
        return holder_of_file(port) or "another program holds it"
    return str(error) if number is None else os.strerror(number)
