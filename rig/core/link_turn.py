"""Whose turn it is on a link that several processes have: of the two that may outlive a run, and stop its device."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

if sys.platform != "win32":
    import fcntl  # now: who stops a device must not wait for a disk

_LOOKS_S: Final = 0.001


@contextmanager
def turn_on(link: int | None, wait_s: float) -> Iterator[bool]:
    """For the block no other process that asks for its turn has it; False where it did not come: go on all the same.

    link    descriptor of the open port, None: in virtual time, where nobody else is. The lock is the process's own,
            though all have one open file; it ends with it
    wait_s  longest wait for the turn
    """
    held = link is None or _locked(link, time.monotonic() + wait_s)
    try:
        yield held
    finally:
        if held and link is not None and sys.platform != "win32":
            with contextlib.suppress(OSError):  # the port is gone, and the lock with it
                fcntl.lockf(link, fcntl.LOCK_UN)


def _locked(link: int, until_s: float) -> bool:
    if sys.platform == "win32":  # has no such locks
        return False
    while True:
        try:
            fcntl.lockf(link, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):
            if time.monotonic() > until_s:
                return False
            time.sleep(_LOOKS_S)
        except OSError:  # no such lock on that file
            return False
        else:
            return True
