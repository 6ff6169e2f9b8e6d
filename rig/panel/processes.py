"""The commands that the panel starts: each a process in a session of its own, so that the panel's end does not end it.

A started process is noted in the folder ``.panel`` beside the run folders, with a file for what it says. So a panel
that was started anew finds it again. It cannot know the exit status then: only the process that started it is told.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rig.live.born import born
from rig.panel.attendance import FOLDER
from rig.panel.errors import RefusedError
from rig.signals import plain

_LAST_WORDS_BYTES: Final = 2000
_LAST_WORDS_LINES: Final = 12
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

    def __init__(self, note: Path, command: str, pid: int, born: str, child: subprocess.Popen[bytes] | None) -> None:
        self.command, self.pid = command, pid
        self.has_folder = False
        self._stopped = False
        self.is_others = False  # another panel that lives started it, and cleans up
        self._note, self._born, self._child = note, born, child

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
        for path in () if self.is_others else (self._note, self._words):
            with contextlib.suppress(OSError):
                path.unlink()
        return ended

    def last_words(self) -> str:
        """The last lines that it said on standard error, safe to print."""
        try:
            with self._words.open("rb") as file:
                file.seek(max(file.seek(0, os.SEEK_END) - _LAST_WORDS_BYTES, 0))
                lines = file.read().decode(errors="replace").splitlines()
        except OSError:
            return ""
        return "\n".join(plain(line) for line in lines[-_LAST_WORDS_LINES:])

    @property
    def _words(self) -> Path:
        return self._note.with_suffix(".stderr")


@contextlib.contextmanager
def one_at_a_time(out: Path) -> Iterator[None]:
    """No other panel of this folder starts anything in the block. Raises RefusedError if one does for ``_WAIT_S``."""
    try:
        (out / FOLDER).mkdir(parents=True, exist_ok=True)
        lock = (out / FOLDER / "start.lock").open("w")
    except OSError as error:
        raise RefusedError(
            503, f"nothing can be started: {error.strerror}", "check the disk and its permissions"
        ) from error
    with lock:
        until_s = time.monotonic() + _WAIT_S
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError as error:  # a panel that was frozen in its start may hold it for long
                if time.monotonic() > until_s:
                    raise RefusedError(
                        409, "another panel of this folder starts something", "wait for it, or end that panel"
                    ) from error
                time.sleep(0.02)
        yield


def start(out: Path, command: str, arguments: Sequence[str]) -> StartedProcess:
    """Start ``rig COMMAND ARGUMENTS --out OUT``. Raises RefusedError if it cannot be started."""
    folder = out / FOLDER
    note = folder / f"{secrets.token_hex(8)}.json"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with note.with_suffix(".stderr").open("xb") as words:
            child = subprocess.Popen(
                [sys.executable, "-P", "-m", "rig", command, *arguments, "--out", str(out)],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=words, start_new_session=True,
            )  # fmt: skip
        began = born(child.pid)
        note.write_text(json.dumps({"command": command, "pid": child.pid, "born": began}), encoding="utf-8")
    except OSError as error:
        raise RefusedError(
            503, f"the {command} cannot be started: {error.strerror}", "check the disk and its permissions"
        ) from error
    return StartedProcess(note, command, child.pid, began, child)


def found_again(out: Path) -> list[StartedProcess]:
    """The processes that an earlier panel started and that go on. What it noted of others is deleted."""
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


def _noted(out: Path) -> Iterator[StartedProcess]:
    for note in sorted((out / FOLDER).glob("*.json")) if (out / FOLDER).is_dir() else ():
        try:
            said = json.loads(note.read_text(encoding="utf-8"))
            yield StartedProcess(note, str(said["command"]), int(said["pid"]), str(said["born"]), None)
        except (OSError, ValueError, KeyError, TypeError):
            yield StartedProcess(note, "", 0, "?", None)
