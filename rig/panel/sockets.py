"""What a connection may cost: how many there are, a WebSocket's messages and bytes a second; a dead peer is cut off."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, Final

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

MOST_MESSAGES_S: Final = 60
LARGEST_MESSAGE: Final = 4096  # bytes
MOST_SOCKETS: Final = 32
MOST_CONNECTIONS: Final = 128  # beside the WebSockets; a browser opens six, and an open file is a scarce thing
PING_EVERY_S: Final = 2.0
PONG_WITHIN_S: Final = 2.5
_MOST_BYTES_S: Final = 64 * 1024  # far more than a page sends; a flood is cut off before it is parsed
_CLOSING_S: Final = 1.0


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


class CountedProtocol(H11Protocol):
    """uvicorn's HTTP, of which only so many connections are open: a new one ends that which has been quiet longest.

    So whoever opens connections and says nothing, or half a request, never keeps a Stop out.
    """

    heard_s: float

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take it; with one too many, let go of another."""
        self.heard_s = time.monotonic()
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
