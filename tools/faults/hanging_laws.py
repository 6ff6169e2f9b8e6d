"""A law that drives to and fro, and one day does not return: in each of the ways that a program can.

``offered`` offers it as a package would, by an entry point.
"""

from __future__ import annotations

import collections
import contextlib
import ctypes
import itertools
import os
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from rig.core.signals import Sample

NAME = "hangs"
PERIOD_S = 0.3


def _spins() -> None:
    while True:
        pass


def _swallows() -> None:
    while True:
        with contextlib.suppress(BaseException):
            _spins()


def _sleeps() -> None:
    time.sleep(3600.0)


def _in_c(first: Iterable[object] = ()) -> None:
    """Holds the interpreter from the ``first`` on, and looks at no signal."""
    collections.deque(itertools.chain(first, itertools.repeat(None)), maxlen=0)


def _locked() -> None:
    """Asleep for ever in C, with the interpreter: no signal ends the wait for this lock."""
    lock = ctypes.create_string_buffer(64)
    library = ctypes.PyDLL(None)
    library.pthread_mutex_lock(lock)
    library.pthread_mutex_lock(lock)


def _exits() -> None:
    os._exit(0)


def _exits_in_c() -> None:
    ctypes.CDLL(None)._exit(0)


WAYS = {
    "spins": _spins, "swallows": _swallows, "sleeps": _sleeps, "in C": _in_c, "locked": _locked, "exits": _exits,
    "exits in C": _exits_in_c,
}  # fmt: skip
# other ways: the law returns, and then a thread of it holds the interpreter between two steps; in virtual time a loop
# that reads and writes at every tick lets no thread in, but for one that asks at once
THREAD, THREAD_AT_ONCE = "thread", "thread at once"


class Hangs:
    """Drives with ``u_V`` to and fro; ``after_s`` after its begin it does not return.

    way   of ``WAYS``, ``THREAD`` or ``THREAD_AT_ONCE``
    mark  file that it writes the time to just before, by the monotonic clock
    """

    def __init__(self, way: str, mark: str, u_V: float = 0.7, after_s: float = 1.0) -> None:
        self._hang, self._mark = WAYS.get(way, self._begin_thread), Path(mark)
        self._at_once = way == THREAD_AT_ONCE
        self._at_work = self._has_thread = False
        self._u_V, self._after_s = u_V, after_s
        self._began_s: float | None = None

    def step(self, sample: Sample) -> float:
        """As of a law."""
        self._at_work = True
        u_V = self._step(sample)
        self._at_work = False
        return u_V

    def _step(self, sample: Sample) -> float:
        if self._began_s is None:
            self._began_s = sample.t_s
        t_s = sample.t_s - self._began_s
        if t_s >= self._after_s and sample.u_V != 0.0:
            if self._hang != self._begin_thread:
                self._written().rename(self._mark)
            self._hang()
        return self._u_V if t_s % PERIOD_S < PERIOD_S / 2 else -self._u_V

    def _written(self) -> Path:
        fresh = self._mark.with_suffix(".new")
        fresh.write_text(repr(time.monotonic()), encoding="ascii")
        return fresh

    def _begin_thread(self) -> None:
        if not self._has_thread:
            self._has_thread = True
            if self._at_once:
                sys.setswitchinterval(1e-6)
            threading.Thread(target=self._hold, daemon=True).start()

    def _hold(self) -> None:
        rename, paths = ctypes.PyDLL(None).rename, (os.fsencode(self._written()), os.fsencode(self._mark))
        while self._at_work:
            pass
        _in_c(
            map(rename, *([path] for path in paths))
        )  # whoever sees the mark sees a thread that keeps the interpreter


def section(way: str, mark: Path) -> dict[str, Any]:
    """Section law of a config."""
    return {"name": NAME, "duration_s": 30.0, "options": {"way": way, "mark": str(mark)}}


@contextlib.contextmanager
def offered(folder: Path) -> Iterator[None]:
    """Offer the law as a package in ``folder``, on the path of this process for the block."""
    package = folder / "hanging_law-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: hanging-law\nVersion: 1.0\n", encoding="ascii")
    (package / "entry_points.txt").write_text(f"[rig.laws]\n{NAME} = {__name__}:Hangs\n", encoding="ascii")
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
