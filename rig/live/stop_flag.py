"""The stop flag of a run: a page in its folder, which any process of the same user may set, and the loop reads.

The loop reads one byte of mapped memory each tick. The page also says who runs, and since when; it is locked while the
run lives, and deleted at its end.
"""

from __future__ import annotations

import math
import os
import signal
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rig.errors import RigError
from rig.live.shared_page import MappedPage, OthersPage
from rig.signals import plain

NAME: Final = "stop.flag"
_HEAD: Final = struct.Struct("=8sIIdd")  # magic, version, pid, zero_s, period_s
_MAGIC: Final = b"rigstop\0"
_VERSION: Final = 1
_ASKED_AT: Final = 64
_BY_AT: Final = 72
_BY_SIZE: Final = 40


class StopError(RigError):
    """The request to stop did not reach the run: says why, and what to do instead."""


@dataclass(frozen=True)
class Runner:
    """The process that makes a run.

    pid       its number
    zero_s    time of the monotonic clock at the run's time 0, s; nan in virtual time, and before the loop is made
    period_s  of the loop, s; nan before the loop is made
    """

    pid: int
    zero_s: float
    period_s: float


class StopFlag:
    """The flag as the run has it: from ``begin`` to the end of the block there is a page."""

    def __init__(self) -> None:
        self._page: MappedPage | None = None

    def __enter__(self) -> StopFlag:
        return self

    def __exit__(self, *_: object) -> None:
        page, self._page = self._page, None
        if page is not None:
            page.close()

    def begin(self, folder: Path) -> None:
        """Make the page in the run folder. Raises OSError where the folder cannot hold it: then nobody can set it."""
        self._page = MappedPage(folder / NAME, _head(math.nan, math.nan))

    def tell(self, zero_s: float, period_s: float) -> None:
        """Tell the run's time 0 and its period, as ``Runner``; before the device is armed. Raises OSError."""
        if self._page is not None:
            self._page.write(0, _head(zero_s, period_s))

    def asked_by(self) -> str:
        """Who asked for a stop; empty: nobody did. A read of memory: the loop calls it each tick."""
        page = self._page
        if page is None or not page[_ASKED_AT]:
            return ""
        return plain(page.read(_BY_AT, _BY_SIZE).split(b"\0", 1)[0].decode(errors="replace")) or "somebody"


def request_stop(folder: Path, by: str = "panel") -> Runner:
    """Ask the run in ``folder`` to stop; returns who will. The first request counts, others change nothing.

    by  who asks, for the run's record: up to 40 bytes
    If the page cannot be written, as on a disk that has become read-only, the process gets SIGTERM: that is the same.
    Raises StopError if nobody makes a run there, or this user may not stop it.
    """
    runner = runner_of(folder)
    if runner is None:
        raise StopError(f"{folder}: no run goes on there: nothing to stop")
    try:
        with OthersPage(folder / NAME, writes=True) as page:
            if not page.read(_ASKED_AT, 1)[0]:
                page.write(_BY_AT, by.encode()[:_BY_SIZE].ljust(_BY_SIZE, b"\0"))
                page.write(_ASKED_AT, b"\1")  # last: from here on the loop sees it
    except (OSError, ValueError) as error:
        try:
            os.kill(runner.pid, signal.SIGTERM)
        except OSError:
            raise StopError(
                f"{folder / NAME} cannot be written ({error}), and process {runner.pid} takes no signal of this user: "
                "use the e-stop"
            ) from error
    return runner


def runner_of(folder: Path) -> Runner | None:
    """The process that makes the run in ``folder`` now; None: none does, or nothing can be read there."""
    try:
        with OthersPage(folder / NAME) as page:
            head = page.read(0, _HEAD.size)
            if not page.is_owned:
                return None
    except (OSError, ValueError):
        return None
    magic, version, pid, zero_s, period_s = _HEAD.unpack(head)
    return Runner(pid, zero_s, period_s) if (magic, version) == (_MAGIC, _VERSION) and pid > 1 else None


def _head(zero_s: float, period_s: float) -> bytes:
    return _HEAD.pack(_MAGIC, _VERSION, os.getpid(), zero_s, period_s)
