"""What goes on at the moment: runs, and what drives without being recorded, which begins alone in its folder."""

from __future__ import annotations

import os
import threading
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NamedTuple

from rig.core import strict_json
from rig.core.errors import CauseError
from rig.core.plain_file import open_plain
from rig.run_folder.live.own_folder import START_LOCK, HeldError, OwnFolder
from rig.run_folder.live.stop_flag import NAME, Runner, StopFlag, Unrecorded, born, command_of, is_recorded, runner_of
from rig.run_folder.recording.writer import EVENTS

_NEWEST: Final = 50  # by name: a run has its flag soon after its folder
_OTHERS: Final = 200  # that one look is at
_LAST_BYTES: Final = 4096  # of the events, with the end of a run
_DIED: Final = b'"kind": "loop_died"'  # as the recorder writes it; in a text its quotes would have a backslash


class Running(NamedTuple):
    """A run that goes on: its folder, and the process that makes it. Or what is not recorded (``is_recorded``)."""

    folder: Path
    runner: Runner


def running(parent: Path) -> list[Running]:
    """What goes on in the folders of ``parent``, the newest run last; nothing where it cannot be read."""
    found: list[Running] = []
    looked: set[str] = set()
    while new := set(_folders(parent)) - looked:  # a run may have taken its flag along into a folder made meanwhile
        found += _of(parent, new)
        looked |= new
    return sorted(found, key=lambda one: one.folder.name)


class Lookout:
    """Looks again and again which runs go on, at a price that hardly grows with the past runs. Not for two threads.

    Each look is at the newest folders, at those whose run went on, and at some of the others, in turn.
    """

    def __init__(self, parent: Path) -> None:
        self._parent = parent
        self._going: set[str] = set()
        self._turn = 0

    def look(self) -> list[Running]:
        """As ``running``, but a run that begins in an old folder may be seen some looks later."""
        found = sorted(_folders(self._parent))
        hidden = {name for name in found if name.startswith(".")}
        there = [name for name in found if name not in hidden]
        newest, others = there[-_NEWEST:], there[:-_NEWEST]
        first = self._turn if self._turn < len(others) else 0
        self._turn = first + _OTHERS
        looked = {*hidden, *newest, *others[first : self._turn], *self._going.intersection(there)}
        going = _of(self._parent, looked)
        self._going = {one.folder.name for one in going}
        return going


class Seen:
    """The runs that were seen to go on: who deletes or replaces the flag of one does not make it go unseen.

    For several threads. Systems without /proc do not tell which process lives: there it goes unseen.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._runs: dict[int, tuple[Running, str]] = {}  # by process
        self._pages: dict[Path, tuple[Running, Unrecorded]] = {}  # of what is not recorded, by its hidden folder

    def others(self, found: Iterable[Running]) -> list[Running]:
        """Those that were seen before, are not found now, and go on.

        found  that have their flag
        """
        flagged = {one.runner.pid: one for one in found if is_recorded(one.folder)}
        with self._lock:
            before = dict(self._runs)
        others = [one for pid, (one, _) in before.items() if pid not in flagged and self.goes_on(one)]
        known = {pid: (one, before[pid][1] if pid in before else born(pid)) for pid, one in flagged.items()}
        with self._lock:
            self._runs = {**known, **{one.runner.pid: before[one.runner.pid] for one in others}}
        return others

    def unrecorded(self, found: Sequence[Running], pids: Collection[int]) -> list[Running]:
        """What drives without a run folder, and what was seen to: its process holds its page, whoever has deleted it.

        found  that have their page
        pids   of runs: they have taken it along
        """
        here = {one.folder for one in found}
        lost = []
        with self._lock:
            for one in found:
                if one.folder not in self._pages:
                    with suppress(OSError, ValueError):  # it has just ended
                        self._pages[one.folder] = one, Unrecorded(one.folder)
            for folder, (one, page) in list(self._pages.items()):
                if folder in here:
                    continue
                if one.runner.pid not in pids and page.is_lost:
                    lost.append(one)
                elif one.runner.pid in pids or not page.is_owned:
                    page.close()
                    del self._pages[folder]
        return [*found, *lost]

    def goes_on(self, one: Running) -> bool:
        """Whether what was seen before goes on: by its page; a run by its process and events: it lives, has no end."""
        with self._lock:
            page = self._pages.get(one.folder)
        if page is not None:
            return page[1].is_lost
        pid = one.runner.pid
        began = self._runs[pid][1] if pid in self._runs else ""
        return began != "" and born(pid) == began and not _has_ended(one.folder)


def _has_ended(folder: Path) -> bool:
    """Whether the events have the run's end, or that its process died.

    Its process may live a moment longer. One that lived in a container had another's number here, which lives on.
    """
    try:
        with os.fdopen(open_plain(folder / EVENTS), "rb") as file:
            file.seek(max(file.seek(0, os.SEEK_END) - _LAST_BYTES, 0))
            last = file.read(_LAST_BYTES)
        if _DIED in last:  # a keeper writes on after it
            return True
        event = strict_json.parse(last.rstrip().rpartition(b"\n")[2].decode("utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(event, dict) and event.get("kind") == "end"


def _folders(parent: Path) -> list[str]:
    try:
        with os.scandir(parent) as entries:
            return [entry.name for entry in entries if entry.is_dir(follow_symlinks=False)]
    except OSError:
        return []


def _of(parent: Path, names: Iterable[str]) -> list[Running]:
    found = []
    for name in sorted(names):
        if os.path.lexists(f"{parent}{os.sep}{name}{os.sep}{NAME}"):  # most have none
            folder = parent / name
            if (runner := runner_of(folder)) is not None:
                found.append(Running(folder, runner))
    return found


_WAIT_S: Final = 2.0  # for a panel that starts something


class BusyError(CauseError):
    """It cannot begin in this folder of runs."""

    status = 1


@contextmanager
def told(runs: Path, command: str) -> Iterator[StopFlag]:
    """The flag of a command that records nothing, for the block.

    It begins under the lock under which panels start things: so neither begins while the other looks what goes on.
    Raises BusyError if anything goes on in ``runs``, or a panel is starting it; or if there is no room for the flag.
    """
    with StopFlag() as flag:
        try:
            with OwnFolder(runs) as own, own.locked(START_LOCK, _WAIT_S):
                if going := running(runs):
                    last = going[-1].folder
                    what = last.name if is_recorded(last) else command_of(last)
                    raise BusyError(
                        f"{what} goes on in {runs}",
                        "wait for its end, or stop it; for another bench name another folder of runs: --out",
                    )
                flag.open(runs, command)
        except HeldError as error:
            raise BusyError(f"a panel of {runs} starts something", "wait for it, or end that panel") from error
        except OSError as error:
            raise BusyError(
                f"no stop flag in {runs}, so nobody else could stop the drive: {error.strerror}",
                "check the disk and its permissions, or name another folder of runs: --out",
            ) from error
        yield flag
