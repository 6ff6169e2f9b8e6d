"""Fits of several starts, laws, folds and recordings on all cores: the library of the physics needs no interpreter.

Each fit is what it is alone, and the fits stay in order: so nothing depends on how many cores there are.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

_Item = TypeVar("_Item")
_Found = TypeVar("_Found")

FEWEST_ROWS = 4000  # of shorter records the interpreter's own part is the larger one, and only one thread has it

_cores = ContextVar("_cores", default=1)  # a thread of a pool has a context of its own: it spreads nothing


@contextmanager
def on_all_cores() -> Iterator[None]:
    """Within it fits are spread over the cores that this process may use. A live fit is not: its loop needs one."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    before = _cores.set(allowed)
    try:
        yield
    finally:
        _cores.reset(before)


def side_by_side(work: Callable[[_Item], _Found], items: Iterable[_Item], rows: int) -> list[_Found]:
    """What ``work`` finds for each of the items, in their order; ``rows``: how many are fitted in each.

    Raises what ``work`` raises for the first item for which it does.
    """
    each = list(items)
    threads = min(_cores.get(), len(each))
    if threads < 2 or rows < FEWEST_ROWS:
        return [work(item) for item in each]
    with ThreadPoolExecutor(threads, "fit") as pool:
        return list(pool.map(work, each))
