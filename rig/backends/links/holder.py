"""Who holds a link of this machine, for people: process, command and run folder, as far as this user may know."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Final

from rig.core.heartbeat import KEEPER
from rig.core.signals import plain

_FLAG: Final = "/stop.flag"  # in the run folder, which a run has open
_FOLDER: Final = ", run folder "
_LONGEST_COMMAND: Final = 200
_PROC: Final = Path("/proc")


def process_in_words(pid: int, proc: Path = _PROC) -> str:
    """A process that holds a link. ``proc`` stands for /proc."""
    words = f"process {pid}"
    with contextlib.suppress(OSError):
        command = plain((proc / f"{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip())
        words += f" ({command[:_LONGEST_COMMAND]})" if command else ""
    folders = {target.removesuffix(_FLAG) for target in _open_files(proc / str(pid)) if target.endswith(_FLAG)}
    return f"{words}{_FOLDER}{plain(min(folders))}" if folders else words


def holder_of_file(path: str, proc: Path = _PROC) -> str:
    """Who has this device file open, links followed, and what to do; empty where this user sees none.

    Of a run and its keepers the run. Of a pseudo-terminal not the one that stands for the device at its other end,
    which may have both ends open.
    """
    there = str(Path(path).resolve())
    found = [one for one in proc.glob("[0-9]*") if there in _open_files(one) and not _is_other_end(one, there)]
    holding = sorted(int(one.name) for one in found)
    for pid in holding:
        if _told(pid, "PPid", proc) in map(str, holding):
            continue  # a keeper: who has started it lives
        if _told(pid, "Name", proc) == KEEPER:
            return (
                f"process {pid}, rig's keeper, holds it: it stops the device of a run that has ended without that, and "
                "lets go within 30 s"
            )
        words = process_in_words(pid, proc)
        ends = ": a run; end it there with Ctrl-C, or stop it in its panel" if _FOLDER in words else ""
        return f"{words} holds it{ends}"
    return ""


def _told(pid: int, key: str, proc: Path) -> str:
    """What /proc says of a process; empty where it has ended."""
    with contextlib.suppress(OSError):
        for line in (proc / f"{pid}/status").read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":\t")
            if name == key:
                return value
    return ""


def _is_other_end(process: Path, terminal: str) -> bool:
    """Whether a process has the master of this pseudo-terminal open."""
    if not terminal.startswith("/dev/pts/"):
        return False
    index = f"tty-index:\t{terminal.removeprefix('/dev/pts/')}\n"
    with contextlib.suppress(OSError):
        for descriptor in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                if descriptor.readlink().name == "ptmx" and index in (process / "fdinfo" / descriptor.name).read_text():
                    return True
    return False


def _open_files(process: Path) -> list[str]:
    found = []
    with contextlib.suppress(OSError):  # of another user, or it has ended
        for descriptor in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                found.append(str(descriptor.readlink()))
    return found
