"""What a connection may cost: how many there are, a WebSocket's messages and bytes a second; a dead peer is cut off.

A connection begins at the ``Door``. Over TLS it comes to HTTP only after the handshake, which may never end.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, ClassVar, Final

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

MOST_MESSAGES_S: Final = 60
LARGEST_MESSAGE: Final = 4096  # bytes
MOST_SOCKETS: Final = 32
MOST_AT_THE_DOOR: Final = 64  # connections in their TLS handshake
MOST_CONNECTIONS: Final = 128  # beside the WebSockets; a browser opens six, and an open file is a scarce thing
PING_EVERY_S: Final = 2.0
PONG_WITHIN_S: Final = 2.5
_MOST_BYTES_S: Final = 64 * 1024  # far more than a page sends; a flood is cut off before it is parsed
_CLOSING_S: Final = 1.0
_MOST_IN_A_ROW: Final = 16  # connections that are taken before what came on others


class Meter:
    """How much of something came in the last second, at most ``most`` of it.

    now_s  a clock
    """

    def __init__(self, most: int, now_s: Callable[[], float] = time.monotonic) -> None:
        self._most, self._now_s = most, now_s
        self._left, self._at_s = float(most), now_s()

    def take(self, amount: int = 1) -> bool:
        """Count ``amount``; False if it is too much."""
        now_s = self._now_s()
        self._left = min(self._left + (now_s - self._at_s) * self._most, self._most)
        self._at_s = now_s
        self._left -= amount
        return self._left >= 0.0


class Door(socket.socket):
    """The socket that listens. Only so many of its connections are in their TLS handshake: a new one ends another.

    That is the oldest of those from the address that has most of them. So whoever connects and never greets keeps
    nobody out, and takes up no files.
    """

    def __init__(self, family: socket.AddressFamily) -> None:
        super().__init__(family, socket.SOCK_STREAM)
        self._greeting: dict[Any, socket.socket] = {}  # by the peer's address and port, the oldest first
        self._in_a_row = 0

    def accept(self) -> tuple[socket.socket, Any]:
        """As of any socket; with one too many in their handshake, lets go of another.

        Of many that wait it says now and then that there is none: so the event loop turns to what else it has to do.
        """
        self._in_a_row = (self._in_a_row + 1) % _MOST_IN_A_ROW
        if not self._in_a_row:
            raise BlockingIOError
        connection, peer = super().accept()
        self._greeting = {other: one for other, one in self._greeting.items() if one.fileno() >= 0}
        if len(self._greeting) >= MOST_AT_THE_DOOR:
            [(address, _)] = Counter(other[0] for other in self._greeting).most_common(1)
            oldest = next(other for other in self._greeting if other[0] == address)
            with contextlib.suppress(OSError):  # it is gone already
                self._greeting.pop(oldest).shutdown(socket.SHUT_RDWR)
        self._greeting[peer] = connection
        return connection, peer

    def came_in(self, peer: Any) -> None:
        """Take note that this connection has done its handshake."""
        self._greeting.pop(peer, None)


class CountedProtocol(H11Protocol):
    """uvicorn's HTTP, of which only so many connections are open: a new one ends that which has been quiet longest.

    So whoever opens connections and says nothing, or half a request, never keeps a Stop out.
    """

    door: ClassVar[Door]
    heard_s: float

    @classmethod
    def behind(cls, door: Door) -> type[CountedProtocol]:
        """The same, for the connections that come in by this door."""
        return type(cls.__name__, (cls,), {"door": door})

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take it; with one too many, let go of another."""
        self.heard_s = time.monotonic()
        self.door.came_in(transport.get_extra_info("peername"))
        super().connection_made(transport)
        others = [one for one in self.connections if isinstance(one, CountedProtocol) and one is not self]
        if len(others) >= MOST_CONNECTIONS:
            quiet = min(others, key=lambda one: one.heard_s)
            self.connections.discard(quiet)
            quiet.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Take what came."""
        self.heard_s = time.monotonic()
        super().data_received(data)


class MeteredProtocol(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket, for which a flood of bytes is the end."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.close_timeout = _CLOSING_S
        self._bytes = Meter(_MOST_BYTES_S)

    def data_received(self, data: bytes) -> None:
        """Take what came, or cut the connection off."""
        if self._bytes.take(len(data)):
            super().data_received(data)
        else:
            self.transport.abort()
