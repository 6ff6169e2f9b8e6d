"""The stop flag of what drives: a page that any process of the same user may set, and the loop reads.

The loop reads one byte of mapped memory each tick. The page also says who drives, since when, and whether a drive may
be on; it is locked while its process lives, and deleted at the end. It begins before the device is opened, in a hidden
folder of its own beside the run folders: ``.COMMAND-PID-TOKEN``. A run takes it along into its folder; what is not
recorded leaves it there.
"""

from __future__ import annotations

import errno
import math
import os
import re
import secrets
import signal
import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rig.core.errors import RigError
from rig.core.faults import Fault
from rig.core.signals import plain
from rig.run_folder.live.shared_page import SIZE, MappedPage, OthersPage


def born(pid: int) -> str:
    """What tells this process from a later one of the same number: the time at which it began; empty if there is none.

    A process that has ended, but whose end nobody has asked for, is none. Systems without /proc tell of none.
    """
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] == "Z" else fields[19]


NAME: Final = "stop.flag"
_HEAD: Final = struct.Struct("=8sIIdd")  # magic, version, pid, zero_s, period_s
_MAGIC: Final = b"rigstop\0"
_VERSION: Final = 1
_ASKED_AT: Final = 64
_BY_AT: Final = 72
_BY_SIZE: Final = 40
_DRIVE_AT: Final = 112
_UNKNOWN, _OFF, _ON = b"\0", b"\1", b"\2"  # of the drive
_UNRECORDED: Final = re.compile(r"\.([a-z-]+)-([0-9]+)-[0-9a-f]{16}")


class StopError(RigError):
    """The request to stop did not reach the run: says why, and what to do instead."""


@dataclass(frozen=True)
class Runner:
    """The process that makes a run.

    pid       its number
    zero_s    time of the monotonic clock at the run's time 0, s; nan in virtual time, and before the loop is made
    period_s  of the loop, s; nan before the loop is made
    drives    whether a drive may be on; False: not yet, or the device has confirmed 0 V; None: it does not say
    is_own    whether the page is this user's; in another's, ``pid`` may be the number of any process
    """

    pid: int
    zero_s: float
    period_s: float
    drives: bool | None = None
    is_own: bool = True

    def terminate(self) -> None:
        """Send it SIGTERM, which is a Stop. Raises OSError, also for one that is not this user's."""
        if not self.is_own:
            raise OSError(errno.EPERM, os.strerror(errno.EPERM))
        os.kill(self.pid, signal.SIGTERM)


class StopFlag:
    """The flag as its process has it: from ``open`` or ``begin`` to the end of the block there is a page.

    is_tried  whether a page was asked for, so that others can stop what drives; it may have failed, which is said
    """

    def __init__(self) -> None:
        self._page: MappedPage | None = None
        self._own: Path | None = None  # the hidden folder
        self.is_tried = False

    @classmethod
    def unseen(cls) -> StopFlag:
        """One without a page, for measurements on benches where nothing moves: no Stop knows of them."""
        flag = cls()
        flag.is_tried = True
        return flag

    def __enter__(self) -> StopFlag:
        return self

    def __exit__(self, *_: object) -> None:
        page, self._page = self._page, None
        if page is not None:
            page.close()
        self._leave_own()

    def open(self, runs: Path, command: str) -> None:
        """Make the page beside the run folders, before a device is opened. What killed commands have left goes.

        Nothing where there is a page: that of a series of runs stays the same.

        command  who drives: small letters, and ``-``
        Raises OSError where there is no room for it: then nobody can set it.
        """
        if self._page is not None:
            return
        self.is_tried = True
        runs.mkdir(parents=True, exist_ok=True)
        _clear(runs)
        own = runs / f".{command}-{os.getpid()}-{secrets.token_hex(8)}"
        own.mkdir(0o700)
        self._own = own
        try:
            self._page = MappedPage(own / NAME, _head(math.nan, math.nan))
            self._page.write(_DRIVE_AT, _OFF)
        except OSError:
            self._leave_own()
            raise

    def begin(self, folder: Path) -> None:
        """Put the page into the run folder, or another one where somebody has taken it away: a Stop on it counts on.

        Raises OSError where the folder cannot hold it: it stays where it is, if it is.
        """
        self.is_tried = True
        before = self._page
        if before is None:
            self._page = MappedPage(folder / NAME, _head(math.nan, math.nan))
            return
        try:
            before.move(folder / NAME)
        except OSError:  # the folder of the run before was renamed or deleted, and the page with it
            by = self.asked_by()
            content = bytearray(_head(math.nan, math.nan).ljust(SIZE, b"\0"))
            content[_DRIVE_AT : _DRIVE_AT + 1] = _OFF
            content[_BY_AT : _BY_AT + _BY_SIZE] = by.encode()[:_BY_SIZE].ljust(_BY_SIZE, b"\0")
            content[_ASKED_AT : _ASKED_AT + 1] = b"\1" if by else b"\0"
            self._page = MappedPage(folder / NAME, bytes(content))
            before.close()
        self._leave_own()

    def _leave_own(self) -> None:
        own, self._own = self._own, None
        if own is not None:
            with suppress(OSError):  # a read-only disk: it is empty, and that says the same
                own.rmdir()

    def tell(self, zero_s: float, period_s: float) -> None:
        """Tell the run's time 0 and its period, as ``Runner``; before the device is armed. Raises OSError."""
        if self._page is not None:
            self._page.write(0, _head(zero_s, period_s))

    def tell_drive(self, *, is_on: bool) -> None:
        """Tell whether a drive may be on from now on: before it is armed, and once the device has confirmed 0 V.

        Raises Fault RECORDER_DEAD where nobody would learn that it is on, as on a disk that has become read-only. The
        other way is only cautious.
        """
        try:
            if self._page is not None:
                self._page.write(_DRIVE_AT, _ON if is_on else _OFF)
        except OSError as error:
            if is_on:
                cause = f"the stop flag cannot be written, so no Stop would know of the drive: {error.strerror}"
                raise Fault("RECORDER_DEAD", cause) from error

    def forget(self) -> None:
        """A Stop was obeyed: what comes next may drive again. Raises OSError."""
        if self._page is not None:
            self._page.write(_ASKED_AT, b"\0")

    def check(self) -> None:
        """Raise Fault INTERRUPTED if somebody asked for a stop."""
        if by := self.asked_by():
            raise Fault("INTERRUPTED", f"Stop by {by}")

    def asked_by(self) -> str:
        """Who asked for a stop; empty: nobody did. A read of memory: the loop calls it each tick.

        A flag that was cut short cannot be set any more, so that is a Stop, too.
        """
        page = self._page
        if page is None or (asked := page.read(_ASKED_AT, 1)) == b"\0":
            return ""
        return _by(page) if asked else "whoever cut its stop flag short"


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
            runner.terminate()
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
            return _runner(page) if page.is_owned else None
    except (OSError, ValueError):
        return None


class AskedStop:
    """Whether the run in ``folder`` was asked to stop, as another process sees it.

    Nothing where it has no flag, or where that cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self._page: OthersPage | None = None
        with suppress(OSError, ValueError):
            self._page = OthersPage(folder / NAME)

    def by(self) -> str:
        """Who asked, as of ``StopFlag.asked_by``. It may wait for the disk."""
        page = self._page
        with suppress(OSError):
            if page is not None and page.read(_ASKED_AT, 1) not in (b"", b"\0"):
                return _by(page)
        return ""


class Unrecorded:
    """What drives without a run folder, as a Stop follows it: also after its page was deleted or moved, or taken along.

    Raises OSError, ValueError where there is no such page.
    """

    def __init__(self, folder: Path) -> None:
        self._page = OthersPage(folder / NAME)
        self._runs = folder.parent
        self.pid = int(_named(folder)[2])

    @property
    def is_owned(self) -> bool:
        """Whether its process still holds the page."""
        return self._page.is_owned

    @property
    def is_lost(self) -> bool:
        """Whether its process still holds the page, but somebody has deleted or moved it: no Stop finds it there."""
        return (self._page.has_no_name or not self._page.is_below(self._runs)) and self._page.is_owned

    def is_at_zero(self) -> bool | None:
        """Whether the drive is known to be at 0; False: it ended, and never said so; None: not yet."""
        is_owned = self._page.is_owned  # first: it says its last before it ends
        runner = _runner(self._page)
        if runner is not None and runner.drives is False:
            return True
        return None if is_owned else False

    def close(self) -> None:
        """Look no more."""
        self._page.close()


def is_recorded(folder: Path) -> bool:
    """Whether a folder with a flag is that of a run, or that of what is not recorded."""
    return _UNRECORDED.fullmatch(folder.name) is None


def command_of(folder: Path) -> str:
    """The command of what is not recorded, for people."""
    return f"rig {_named(folder)[1]}"


def _named(folder: Path) -> re.Match[str]:
    found = _UNRECORDED.fullmatch(folder.name)
    if found is None:
        raise ValueError(f"{folder} is the folder of a run")
    return found


def _by(page: MappedPage | OthersPage) -> str:
    return plain(page.read(_BY_AT, _BY_SIZE).split(b"\0", 1)[0].decode(errors="replace")) or "somebody"


def _runner(page: OthersPage) -> Runner | None:
    head = page.read(0, _HEAD.size)
    if len(head) < _HEAD.size:
        return None  # somebody has cut it short
    magic, version, pid, zero_s, period_s = _HEAD.unpack(head)
    if (magic, version) != (_MAGIC, _VERSION) or pid <= 1:
        return None
    drives = {_OFF: False, _ON: True}.get(page.read(_DRIVE_AT, 1))
    return Runner(pid, zero_s, period_s, drives, page.is_of_this_user)


def _clear(runs: Path) -> None:
    """Delete what commands have left that were killed."""
    if not born(os.getpid()):
        return  # a system that does not tell who lives
    with suppress(OSError), os.scandir(runs) as entries:
        for entry in entries:
            found = _UNRECORDED.fullmatch(entry.name)
            if found is None or not entry.is_dir(follow_symlinks=False) or born(int(found[2])):
                continue
            with suppress(OSError):  # of another user
                folder = Path(entry.path)
                if runner_of(folder) is not None:  # of a container, whose processes have other numbers
                    continue
                (folder / NAME).unlink(missing_ok=True)
                folder.rmdir()


def _head(zero_s: float, period_s: float) -> bytes:
    return _HEAD.pack(_MAGIC, _VERSION, os.getpid(), zero_s, period_s)
