"""The link's lease while a law of a user's own is at work: who may speak on the link, the loop or its keeper.

The loop holds the lease, but while the law is at work it does nothing itself. If the law does not come back in time,
the keeper, another process, takes the link: ``take`` and ``end`` agree who has it, however near they are to each other.
"""

from __future__ import annotations

import mmap
import time
from typing import Final

SIZE: Final = 4096
_COUNT: Final = 0  # steps begun so far
_AT_WORK: Final = 1  # number of the step in which the law is; 0: in none
_CPU_NS: Final = 2  # CPU time of the loop's thread when that step began
_LOOKS: Final = 3  # of the loop at what asks for a stop: each tick one
_DRIVES: Final = 4  # 1: a drive may be on
_IDLE: Final = 5  # 1: the loop waits for its tick, or has a drive to give out: for no reply of the device
_TAKEN: Final = 8  # 1: the link is the keeper's; this and the next on a cache line of their own
_ASKED: Final = 9  # number of the step that the keeper has asked to end
_SEEN_S: Final = 0.002  # by far enough for a write to be seen by another processor


class LawLease:
    """The memory that loop and keeper share.

    descriptor  of a file of ``SIZE`` bytes that both map; -1: there is no keeper
    Raises OSError where it cannot be mapped.
    """

    def __init__(self, descriptor: int) -> None:
        self._map = mmap.mmap(descriptor, SIZE)
        self._words = memoryview(self._map).cast("q")

    # -- the loop's

    def begin(self, cpu_ns: int) -> None:
        """The law begins a step. Until ``end`` this process does not speak on the link."""
        words = self._words
        words[_COUNT] += 1
        words[_CPU_NS] = cpu_ns
        words[_AT_WORK] = words[_COUNT]

    def end(self) -> bool:
        """The law is back. Returns whether the link is the loop's: if not, it must not speak."""
        self._words[_AT_WORK] = 0
        return self._words[_TAKEN] == 0

    def look(self) -> None:
        """The loop goes on."""
        self._words[_LOOKS] += 1

    def tell_drive(self, *, is_on: bool) -> None:
        """Tell whether a drive may be on from now on."""
        self._words[_DRIVES] = is_on

    def tell_idle(self, *, is_idle: bool) -> None:
        """Tell whether the loop waits for nothing but its tick from now on."""
        self._words[_IDLE] = is_idle

    @property
    def is_asked(self) -> bool:
        """Whether the keeper has asked the step in which the law is to end, and not an earlier one."""
        return self._words[_ASKED] == self._words[_AT_WORK]

    # -- the keeper's

    @property
    def at_work(self) -> int:
        """Number of the step in which the law is; 0: in none."""
        return self._words[_AT_WORK]

    @property
    def cpu_ns(self) -> int:
        """CPU time of the loop's thread when the step began, ns."""
        return self._words[_CPU_NS]

    @property
    def looks(self) -> int:
        """How often the loop has looked so far."""
        return self._words[_LOOKS]

    @property
    def drives(self) -> bool:
        """Whether a drive may be on."""
        return self._words[_DRIVES] != 0

    @property
    def idle(self) -> bool:
        """Whether the loop waits for nothing but its tick."""
        return self._words[_IDLE] != 0

    def ask(self, step: int) -> None:
        """Ask that step to end; a signal has to follow."""
        self._words[_ASKED] = step

    def take(self, step: int) -> bool:
        """Take the link if the law is still in that step. Returns whether the keeper has it.

        First the claim, a wait until the loop must see it, then the look. A law that comes back before the look keeps
        the link; one that comes back later finds it taken.
        """
        self._words[_TAKEN] = 1
        time.sleep(_SEEN_S)
        if self.at_work == step:
            return True
        self.give_back()
        return False

    # -- both

    def give_back(self) -> None:
        """The link is the loop's: as the keeper, or where there is none any more."""
        self._words[_TAKEN] = 0

    @property
    def is_taken(self) -> bool:
        """Whether the keeper has the link, or is about to say whether it has."""
        return self._words[_TAKEN] != 0

    def close(self) -> None:
        """Unmap."""
        self._words.release()
        self._map.close()
