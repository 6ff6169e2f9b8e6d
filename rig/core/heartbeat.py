"""The memory in which a process tells the keeper of its device that it lives, and the keeper that it was too late.

A beat is one store of 8 bytes: no system call, and nobody is woken. Times are of the monotonic clock, which both have.
"""

from __future__ import annotations

import mmap
import time
from typing import Final

SIZE: Final = 4096
KEEPER: Final = "motor-keeper"  # name of its process: no `killall -9 python3`, `pkill -9 rig` or the like ends it
AT_REST: Final = 0.0  # in place of a time: nothing drives, and silence is no sign of anything
_HEARD_S: Final = 0  # when the process was heard last
_SILENT: Final = 8  # 1: the keeper has found it silent; on a cache line of its own


class Heartbeat:
    """The memory that both share, at rest at first.

    descriptor  of a file of ``SIZE`` bytes that both map
    Raises OSError where it cannot be mapped.
    """

    def __init__(self, descriptor: int) -> None:
        self._map = mmap.mmap(descriptor, SIZE)
        self._words = memoryview(self._map).cast("d")

    # -- the process's

    def beat(self) -> None:
        """It lives, and may drive."""
        self._words[_HEARD_S] = time.monotonic()

    def waits(self) -> None:
        """It lives, and asks. Says nothing at rest."""
        if self._words[_HEARD_S] != AT_REST:
            self._words[_HEARD_S] = time.monotonic()

    def rest(self) -> None:
        """Nothing drives. That it was found silent is over."""
        self._words[_HEARD_S] = AT_REST
        self._words[_SILENT] = 0.0

    @property
    def was_silent(self) -> bool:
        """Whether the keeper has found it silent since it rested last: then it stops the device, or has."""
        return self._words[_SILENT] != 0.0

    # -- the keeper's

    @property
    def heard_s(self) -> float:
        """When the process was heard last, s, or AT_REST."""
        return self._words[_HEARD_S]

    def tell_silent(self) -> None:
        """It was silent for too long."""
        self._words[_SILENT] = 1.0

    # -- both

    def close(self) -> None:
        """Unmap."""
        self._words.release()
        self._map.close()
