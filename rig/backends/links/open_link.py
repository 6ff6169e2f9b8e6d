"""An open file or socket of this process as a ``Transport``, whoever has opened it and set it up."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable

from rig.core.faults import Fault

_READ_BYTES = 1024


class OpenLink:
    """A link by its number: one that another process has opened, as it stands; or a port of one's own.

    name   for faults
    """

    now_s = staticmethod(time.monotonic)  # a client asks for it four times in an exchange

    def __init__(self, descriptor: int, name: str = "the link") -> None:
        self._fd = descriptor
        self._name = name
        self._send: Callable[[int, bytes], int] = os.write
        self._receive: Callable[[int, int], bytes] = os.read

    @property
    def descriptor(self) -> int:
        """Number of the open file or socket; -1 once it is closed."""
        return self._fd

    def write(self, data: bytes) -> None:
        """Send all of ``data``. Raises Fault LINK_LOST if the link is dead or takes no more."""
        try:
            sent = self._send(self._fd, data)
        except OSError as error:
            raise Fault("LINK_LOST", f"{self._name}: {error.strerror}") from error
        if sent != len(data):
            raise Fault("LINK_LOST", f"{self._name} takes no more bytes: the device does not read")

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, at least one byte, or b"" after ``timeout_s`` at most. Raises Fault LINK_LOST."""
        try:
            if not select.select([self._fd], [], [], timeout_s)[0]:
                return b""
            data = self._receive(self._fd, _READ_BYTES)
            if not data and not select.select([self._fd], [], [], 0.0)[0]:
                return b""  # another process that has this link, as a keeper, was quicker; a dead one stays readable
        except BlockingIOError:
            return b""  # as well
        except (OSError, ValueError) as error:  # ValueError: select on a closed port
            raise Fault("LINK_LOST", f"{self._name}: {error}") from error
        if not data:
            raise Fault("LINK_LOST", f"{self._name} hung up")
        return data

    def close(self) -> None:
        """Nothing: its opener closes it, or the end of this process does."""
