"""How a page gets from a tool to its file."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path

from rig.recording.folder import write_whole


def today() -> str:
    """The date that a page is dated by (UTC)."""
    return str(datetime.datetime.now(datetime.UTC).date())


def listed(items: Sequence[str]) -> str:
    """``a, b and c``."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"


def write(path: Path, text: str) -> None:
    """Write a page whole, or leave the old one; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text.encode("utf-8"))
