"""A TCP connection as a ``Transport``."""

from __future__ import annotations

import select
import socket
import time

from rig.backends.links.held_endpoint import HeldEndpoint
from rig.core.copies import keep_from_copies, no_longer_own
from rig.core.faults import Fault

_READ_BYTES = 1024


class TcpTransport:
    """A connection to host and port number; small frames leave at once (no Nagle delay).

    connect_s  longest wait for the connection
    unit       unit id behind it, which no other process of this machine has while this one does
    Raises Fault LINK_OPEN if there is no connection, SECOND_MASTER if another process has the unit.
    """

    def __init__(self, host: str, port: int, connect_s: float = 5.0, unit: int = 1) -> None:
        self._name = f"{host}:{port}"
        self._held = HeldEndpoint(host, port, unit)
        try:
            self._socket = socket.create_connection((host, port), timeout=connect_s)
        except OSError as error:
            self._held.close()
            raise Fault("LINK_OPEN", f"tcp://{self._name}: {error.strerror or error}") from error
        keep_from_copies(self._socket.fileno())
        try:
            self._held.hold(str(self._socket.getpeername()[0]))  # its name may have got another address since
        except (OSError, Fault) as error:
            self.close()
            raise error if isinstance(error, Fault) else Fault("LINK_OPEN", f"tcp://{self._name}: {error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)

    @property
    def descriptor(self) -> int:
        """Number of the open socket; -1 once it is closed."""
        return self._socket.fileno()

    def write(self, data: bytes) -> None:
        """Send all of ``data``; LINK_LOST if the connection is dead or takes no more."""
        try:
            sent = self._socket.send(data)
        except OSError as error:
            raise Fault("LINK_LOST", f"{self._name}: {error.strerror}") from error
        if sent != len(data):
            raise Fault("LINK_LOST", f"{self._name} takes no more bytes: the device does not read")

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, at least one byte, or b"" after ``timeout_s``; LINK_LOST if the connection is dead."""
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            data = self._socket.recv(_READ_BYTES)
        except (OSError, ValueError) as error:  # ValueError: select on a closed socket
            raise Fault("LINK_LOST", f"{self._name}: {error}") from error
        if not data:
            raise Fault("LINK_LOST", f"{self._name} hung up")
        return data

    def now_s(self) -> float:
        """CLOCK_MONOTONIC, s."""
        return time.monotonic()

    def close(self) -> None:
        """Close the connection. May be called twice."""
        no_longer_own(self._socket.fileno())
        self._socket.close()
        self._held.close()
