"""A port or a connection that another process has opened, as a ``Transport``."""

from __future__ import annotations

import os
import select
import time

from rig.core.faults import Fault

_READ_BYTES = 1024


class InheritedLink:
    """An open file or socket by its number. Who opened it has set it up."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    @property
    def descriptor(self) -> int:
        """Number of the open file or socket."""
        return self._descriptor

    def write(self, data: bytes) -> None:
        """Send all of ``data``. Raises Fault LINK_LOST if the link is dead or takes no more."""
        try:
            sent = os.write(self._descriptor, data)
        except OSError as error:
            raise Fault("LINK_LOST", str(error.strerror)) from error
        if sent != len(data):
            raise Fault("LINK_LOST", "the link takes no more bytes: the device does not read")

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, at least one byte, or b"" after ``timeout_s``. Raises Fault LINK_LOST."""
        try:
            if not select.select([self._descriptor], [], [], timeout_s)[0]:
                return b""
            data = os.read(self._descriptor, _READ_BYTES)
        except OSError as error:
            raise Fault("LINK_LOST", str(error.strerror)) from error
        if not data:
            raise Fault("LINK_LOST", "the link hung up")
        return data

    def now_s(self) -> float:
        """CLOCK_MONOTONIC, s."""
        return time.monotonic()

    def close(self) -> None:
        """Nothing: its opener closes it, or the end of this process does."""
