"""The commands that the panel starts: each a process in a session of its own, so that the panel's end does not end it.

A started process is noted in rig's own folder beside the run folders, with a file for what it says. So a panel that was
started anew finds it again. It cannot know the exit status then: only the process that started it is told.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import signal
import subprocess
import sys
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rig.core.signals import plain
from rig.panel.messages import RefusedError
from rig.run_folder.live.own_folder import START_LOCK, HeldError, NotOwnError, OwnFolder
from rig.run_folder.live.stop_flag import born

_LAST_WORDS_BYTES: Final = 2000
_LAST_WORDS_LINES: Final = 12
_NOTE: Final = re.compile(r"[0-9a-f]{16}\.json")
_LARGEST_NOTE: Final = 4096  # bytes
_WAIT_S: Final = 2.0  # for another panel that starts something


@dataclass(frozen=True)
class Ended:
    """How a started command ended.

    status   its exit status, negative for the signal that killed it; None: not known
    words    the last that it said on standard error
    stopped  whether a Stop ended it before it had a run folder
    began    whether it had a run folder: what became of the run is told there
    """

    pid: int
    command: str
    status: int | None
    words: str
    stopped: bool
    began: bool


class StartedProcess:
    """A command that a panel started: this one, or one before it.

    command     run or jog
    has_folder  whether its run folder was seen
    """

    def __init__(
        self, out: Path, note: str, command: str, pid: int, born: str, child: subprocess.Popen[bytes] | None
    ) -> None:
        self.command, self.pid = command, pid
        self.has_folder = False
        self._stopped = False
        self.is_others = False  # another panel that lives started it, and cleans up
        self._out, self._note, self._born, self._child = out, note, born, child

    def status(self) -> int | None:
        """Its exit status if it has ended and is known."""
        return None if self._child is None else self._child.poll()

    @property
    def lives(self) -> bool:
        """Whether it goes on."""
        if self._child is not None:
            return self._child.poll() is None
        return bool(self._born) and born(self.pid) == self._born

    def interrupt(self) -> None:
        """Ask it to stop: it counts from the command's first moment on."""
        self._stopped = True
        if self.lives:
            with contextlib.suppress(OSError):
                os.kill(self.pid, signal.SIGTERM)

    def end(self) -> Ended:
        """How it ended; it is forgotten."""
        ended = Ended(self.pid, self.command, self.status(), self.last_words(), self._stopped, self.has_folder)
        if not self.is_others:
            for name in (self._note, _words_of(self._note)):
                with contextlib.suppress(OSError), OwnFolder(self._out, makes=False) as folder:
                    folder.delete(name)
        return ended

    def last_words(self) -> str:
        """The last lines that it said on standard error, safe to print."""
        try:
            with (
                OwnFolder(self._out, makes=False) as folder,
                os.fdopen(folder.open(_words_of(self._note)), "rb") as file,
            ):
                file.seek(max(file.seek(0, os.SEEK_END) - _LAST_WORDS_BYTES, 0))
                lines = file.read(_LAST_WORDS_BYTES).decode(errors="replace").splitlines()
        except OSError:
            return ""
        return "\n".join(plain(line) for line in lines[-_LAST_WORDS_LINES:])


@contextlib.contextmanager
def one_at_a_time(out: Path) -> Iterator[None]:
    """No other panel of this folder starts anything in the block. Raises RefusedError if one does for ``_WAIT_S``."""
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(stack.enter_context(OwnFolder(out)).locked(START_LOCK, _WAIT_S))
        except HeldError as error:  # a panel that was frozen in its start may hold it for long
            raise RefusedError(
                409, "another panel of this folder starts something", "wait for it, or end that panel"
            ) from error
        except OSError as error:
            raise RefusedError(503, *_cannot_start("nothing can", error)) from error
        yield


def start(out: Path, command: str, arguments: Sequence[str]) -> StartedProcess:
    """Start ``rig COMMAND ARGUMENTS --out OUT``. Raises RefusedError if it cannot be started."""
    note = f"{secrets.token_hex(8)}.json"
    try:
        with OwnFolder(out) as folder:
            with os.fdopen(folder.open(_words_of(note), os.O_WRONLY | os.O_CREAT | os.O_EXCL), "wb") as words:
                child = subprocess.Popen(
                    [sys.executable, "-P", "-m", "rig", command, *arguments, "--out", str(out)],
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=words, start_new_session=True,
                )  # fmt: skip
            began = born(child.pid)
            folder.write(note, json.dumps({"command": command, "pid": child.pid, "born": began}).encode())
    except OSError as error:
        raise RefusedError(503, *_cannot_start(f"the {command} cannot", error)) from error
    return StartedProcess(out, note, command, child.pid, began, child)


def _cannot_start(what: str, error: OSError) -> tuple[str, str]:
    """What is wrong, and the cure."""
    cure = "" if isinstance(error, NotOwnError) else "check the disk and its permissions"
    return f"{what} be started: {error.strerror}", cure


def found_again(out: Path) -> list[StartedProcess]:
    """The processes that an earlier panel started and that go on. Its notes of others are deleted, and nothing else."""
    found = []
    for process in _noted(out):
        if process.lives:
            found.append(process)
        else:
            process.end()
    return found


def of_others(out: Path, known: Collection[int]) -> list[StartedProcess]:
    """The processes that go on, and that another panel of the same folder has started meanwhile.

    known  the numbers of those that are known already
    """
    found = [process for process in _noted(out) if process.pid not in known and process.lives]
    for process in found:
        process.is_others = True
    return found


def _noted(out: Path) -> list[StartedProcess]:
    """What the notes in rig's folder say. What is no note of ``start`` is not rig's to judge."""
    try:
        with OwnFolder(out, makes=False) as folder:
            return [one for name in folder.names() if (one := _of_note(out, folder, name)) is not None]
    except OSError:
        return []


def _of_note(out: Path, folder: OwnFolder, name: str) -> StartedProcess | None:
    if _NOTE.fullmatch(name) is None:
        return None
    try:
        said = json.loads(folder.read(name, _LARGEST_NOTE))
    except (OSError, ValueError, RecursionError):
        return None
    match said:
        case {"command": str(command), "pid": int(pid), "born": str(began), **others} if not others and pid > 1:
            return StartedProcess(out, name, command, pid, began, None)
    return None


def _words_of(note: str) -> str:
    """The name of the file with what the process of a note says."""
    return f"{note.removesuffix('.json')}.stderr"
