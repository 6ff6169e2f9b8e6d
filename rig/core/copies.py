"""What no copy of this process has: a law of a user's own may fork one, as a pool of processes does.

A copy has every open file, and with it what is locked or held by it. One that outlives the run would keep its flag and
its link, and would tell the keeper of its own signals.
"""

from __future__ import annotations

import os
from mmap import mmap

_own: dict[int, mmap | None] = {}


def keep_from_copies(descriptor: int, mapped: mmap | None = None) -> None:
    """From now on a copy of this process has nothing in the place of this open file, until ``no_longer_own``.

    mapped  its map, which keeps the file open, too
    """
    _own[descriptor] = mapped


def no_longer_own(descriptor: int) -> None:
    """Forget an open file that is about to be closed: its number may soon be another file's."""
    _own.pop(descriptor, None)


def _let_go() -> None:
    """In the copy. The numbers stay taken, so that nobody there closes another file by one of them."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor, mapped in _own.items():
        os.dup2(nothing, descriptor, inheritable=False)
        if mapped is not None:
            mapped.close()
    os.close(nothing)


if hasattr(os, "register_at_fork"):  # Windows makes no copies
    os.register_at_fork(after_in_child=_let_go)
