"""Whether a process is the one that was met before, or a later one of its number."""

from __future__ import annotations

from pathlib import Path


def born(pid: int) -> str:
    """What tells this process from a later one of the same number: the time at which it began; empty if there is none.

    A process that has ended, but whose end nobody has asked for, is none. Systems without /proc tell of none.
    """
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] == "Z" else fields[19]
