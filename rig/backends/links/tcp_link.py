"""A TCP connection as a ``Transport``."""

from __future__ import annotations

import socket

from typing_extensions import override

from rig.backends.links.held_endpoint import HeldEndpoint
from rig.backends.links.open_link import OpenLink
from rig.core.copies import keep_from_copies, no_longer_own
from rig.core.faults import Fault


class TcpTransport(OpenLink):
    """A connection to host and port number; small frames leave at once (no Nagle delay).

    connect_s  longest wait for the connection
    unit       unit id behind it, which no other process of this machine has while this one does
    Raises Fault LINK_OPEN if there is no connection, SECOND_MASTER if another process has the unit.
    """

    def __init__(self, host: str, port: int, connect_s: float = 5.0, unit: int = 1) -> None:
        name = f"{host}:{port}"
        self._held = HeldEndpoint(host, port, unit)
        try:
            self._socket = socket.create_connection((host, port), timeout=connect_s)
        except OSError as error:
            self._held.close()
            raise Fault("LINK_OPEN", f"tcp://{name}: {error.strerror or error}") from error
        super().__init__(self._socket.fileno(), name)
        keep_from_copies(self._fd)
        try:
            self._held.hold(str(self._socket.getpeername()[0]))  # its name may have got another address since
        except (OSError, Fault) as error:
            self.close()
            raise error if isinstance(error, Fault) else Fault("LINK_OPEN", f"tcp://{name}: {error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        self._send = lambda _, data: self._socket.send(data)  # Windows writes to no socket by its number
        self._receive = lambda _, most: self._socket.recv(most)

    @override
    def close(self) -> None:
        """Close the connection. May be called twice."""
        no_longer_own(self._fd)
        self._fd = -1  # the number may soon be another file's
        self._socket.close()
        self._held.close()
