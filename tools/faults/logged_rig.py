"""`rig` with faults injected into its link: python -m faults.logged_rig LOG FAULT ARGUMENT...

LOG gets every byte that the link hands to the host. The file FAULT says what happens to the link. `cut`: nothing passes
either way. `gone`: the operating system says that there is no such port, or no such connection, any more.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import rig.running.session
from rig.backends.backend import Line, LineBackend
from rig.backends.clock import MonotonicClock
from rig.backends.driver import Transport
from rig.backends.links.serial_port import SerialPort
from rig.backends.links.tcp_link import TcpTransport
from rig.cli import main
from rig.config.schema import DeviceSetup
from rig.testing.line import lines_opened_by


def hung_up_terminal() -> int:
    """A terminal whose other end is closed: what a port is like whose device was pulled out."""
    ours, theirs = os.openpty()
    os.close(ours)
    return theirs


def reset_connection() -> int:
    """A connection that its other end has reset."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs, _ = server.accept()
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        theirs.close()
    return ours.detach()


class LinkFault:
    """The fault of a link, read from a file at each use of the link."""

    def __init__(self, log: int, word: Path) -> None:
        self._log, self._word = log, word
        self._is_gone = False

    def is_cut(self, descriptor: int, dead: Any) -> bool:
        """Whether nothing passes; where the link is to be gone the dead one takes its place."""
        try:
            word = self._word.read_text(encoding="ascii")
        except FileNotFoundError:
            return False
        if word == "gone" and not self._is_gone:
            self._is_gone = True
            os.dup2(dead(), descriptor)
        return word == "cut"

    def note(self, data: bytes) -> None:
        """What the host has received is in the file before the host looks at it."""
        os.write(self._log, data)


class FaultyLink:
    """A port or a connection of this machine whose link a ``LinkFault`` can break."""

    def __init__(self, link: Transport, fault: LinkFault) -> None:
        if isinstance(link, SerialPort):
            self._descriptor, self._dead = link.descriptor, hung_up_terminal
        elif isinstance(link, TcpTransport):
            self._descriptor, self._dead = link.descriptor, reset_connection
        else:
            raise TypeError(f"no wire of this machine: {link!r}")
        self._link, self._fault = link, fault

    @property
    def descriptor(self) -> int:
        """As of the link."""
        return self._descriptor

    def write(self, data: bytes) -> None:
        """As of a ``Transport``."""
        if not self._fault.is_cut(self._descriptor, self._dead):
            self._link.write(data)

    def read(self, timeout_s: float) -> bytes:
        """As of a ``Transport``."""
        if self._fault.is_cut(self._descriptor, self._dead):
            time.sleep(timeout_s)
            return b""
        data = self._link.read(timeout_s)
        self._fault.note(data)
        return data

    def now_s(self) -> float:
        """As of a ``Transport``."""
        return self._link.now_s()

    def close(self) -> None:
        """As of a ``Transport``."""
        self._link.close()


def run(log: str, word: str, arguments: list[str]) -> None:
    """Run the command."""
    fault = LinkFault(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644), Path(word))

    @contextmanager
    def opened(backend: LineBackend, setup: DeviceSetup) -> Iterator[Line]:
        with backend.line(setup) as line:
            if not isinstance(line.clock, MonotonicClock):  # in virtual time: no wire of this machine
                yield line
                return
            yield line._replace(transport=FaultyLink(line.transport, fault))

    with lines_opened_by(opened), patch.object(rig.running.session, "write_report", lambda *_: None):
        main(arguments)


if __name__ == "__main__":
    run(sys.argv[1], sys.argv[2], sys.argv[3:])
