"""Which runs go on at the moment."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

from rig.live.stop_flag import NAME, Runner, runner_of

_NEWEST: Final = 50  # by name: a run has its flag soon after its folder
_OTHERS: Final = 200  # that one look is at


class Running(NamedTuple):
    """A run that goes on: its folder, and the process that makes it."""

    folder: Path
    runner: Runner


def running(parent: Path) -> list[Running]:
    """The runs that go on in the folders of ``parent``, the newest last; none where it cannot be read."""
    return _of(parent, _folders(parent))


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
        there = sorted(_folders(self._parent))
        newest, others = there[-_NEWEST:], there[:-_NEWEST]
        first = self._turn if self._turn < len(others) else 0
        self._turn = first + _OTHERS
        found = _of(self._parent, {*newest, *others[first : self._turn], *self._going.intersection(there)})
        self._going = {one.folder.name for one in found}
        return found


def _folders(parent: Path) -> list[str]:
    try:
        with os.scandir(parent) as entries:
            return [entry.name for entry in entries if entry.is_dir(follow_symlinks=False)]
    except OSError:
        return []


def _of(parent: Path, names: Iterable[str]) -> list[Running]:
    found = []
    for name in sorted(names):
        if os.path.lexists(os.path.join(parent, name, NAME)):  # most have none
            folder = parent / name
            if (runner := runner_of(folder)) is not None:
                found.append(Running(folder, runner))
    return found
