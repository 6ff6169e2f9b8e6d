"""Which runs go on at the moment."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from rig.live.stop_flag import Runner, runner_of


class Running(NamedTuple):
    """A run that goes on: its folder, and the process that makes it."""

    folder: Path
    runner: Runner


def running(parent: Path) -> list[Running]:
    """The runs that go on in the folders of ``parent``, the newest last; none where it cannot be read."""
    try:
        folders = sorted(one for one in parent.iterdir() if one.is_dir() and not one.is_symlink())
    except OSError:
        return []
    return [Running(folder, runner) for folder in folders if (runner := runner_of(folder)) is not None]
