"""Whether a container ends with a process: the kernel ends all of its processes as soon as its first one ends.

Every process is a child of another one, up to the first. A process that only waits for its child ends with it, and so
may its own parent. That a shell takes commands one after the other, and lives on, shows in how it was called; that
something else does, in that it gives its child a group of processes of its own.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, NamedTuple

from rig.core.signals import plain

_MACHINES_OWN: Final = 0xEFFFFFFC  # number of the machine's own PID namespace (PROC_PID_INIT_INO of Linux)
# what waits for its child, and may give it a group of its own
_WAITING: Final = {
    "docker-init", "podman-init", "tini", "tini-static", "dumb-init", "catatonit", "sudo", "su", "runuser", "script",
    "screen", "tmux: server", "tmux: client",
}  # fmt: skip
_SHELLS: Final = {"sh", "dash", "bash", "ash", "busybox", "zsh", "ksh", "fish"}
_WITH_A_WORD: Final = {"rcfile", "init-file"}  # a shell's options behind which a file stands that it does not end with
_PROC: Final = Path("/proc")
_LONGEST_COMMAND: Final = 100


class _Process(NamedTuple):
    """Its name, its parent's number (0: not of this container), its group, and how it was called."""

    name: str
    parent: int
    group: int
    words: tuple[str, ...]


def first_that_ends_with(pid: int, proc: Path = _PROC) -> str:
    """The first process of the container, as it was called, where it ends with this one; empty where it does not.

    ``proc`` stands for /proc. Empty, too, where this process may not see who its parents are.
    """
    try:
        if pid != 1 and (proc / "self/ns/pid").stat().st_ino == _MACHINES_OWN:
            return ""
        child = _process(pid, proc)
        while pid != 1:
            pid = child.parent
            if pid == 0:  # it has come into the container from outside, as by `docker exec`
                return ""
            parent = _process(pid, proc)
            if not _only_waits(parent, child):
                return ""
            child = parent
    except (OSError, ValueError, IndexError):
        return "process 1" if pid == os.getpid() == 1 else ""
    return plain(" ".join(child.words))[:_LONGEST_COMMAND] or child.name


def _only_waits(parent: _Process, child: _Process) -> bool:
    if parent.group == child.group or parent.name in _WAITING:
        return True
    return parent.name in _SHELLS and _ends_by_itself(parent.words[2 if parent.name == "busybox" else 1 :])


def _ends_by_itself(options: tuple[str, ...]) -> bool:
    """Whether a shell that is called with these has a command or a script: else it takes commands, and lives on."""
    words = iter(options)
    for word in words:
        name = word.lstrip("-+")
        if word.startswith("--"):
            if name.startswith("command"):
                return True
            with_a_word = name in _WITH_A_WORD
        elif not word.startswith(("-", "+")) or "c" in name:
            return True
        else:
            with_a_word = name.endswith(("o", "O"))
        if with_a_word:
            next(words, None)
    return False


def _process(pid: int, proc: Path) -> _Process:
    """Raises OSError, ValueError, IndexError."""
    begin, _, rest = (proc / f"{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")
    _, parent, group = rest.split()[:3]
    words = (proc / f"{pid}/cmdline").read_text(encoding="utf-8", errors="replace").rstrip("\0").split("\0")
    return _Process(begin.partition("(")[2], int(parent), int(group), tuple(words))
