"""Arguments and options that several commands have."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Any

import click

from rig.cli.ending import fail


class Rows(click.ParamType):  # type: ignore[type-arg]
    """``FIRST:LAST``; either may be left out."""

    name = "rows"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The two numbers; None for one that is left out."""
        first, colon, last = str(value).partition(":")
        if not colon or not all(part == "" or part.isdecimal() for part in (first, last)):
            self.fail(f"{value!r} must be FIRST:LAST: two row numbers, such as 120:899", param, ctx)
        return int(first) if first else None, int(last) if last else None


class FiniteRange(click.FloatRange):
    """A number within bounds; infinity and nan are none."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value!r} must be a number, such as 1", param, ctx)
        return number


class Positive(FiniteRange):
    """A number above 0."""

    def __init__(self) -> None:
        super().__init__(min=0.0, min_open=True)


class Pace(FiniteRange):
    """A number of seconds in a second; so slow that a tick takes no hour."""

    name = "pace"

    def __init__(self) -> None:
        super().__init__(1e-3)


PICTURES = (".png", ".svg", ".pdf")  # as rig.output.report.style.FORMATS, which loads slowly
CONFIG = click.argument("config_path", metavar="CONFIG", type=click.Path(path_type=Path))
# In every command --out is the folder in which rig makes run folders, and --to is the file that it writes.
OUT = click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("runs"), show_default=True,
    help="Folder in which rig makes the run folder.",
)  # fmt: skip
ROWS = click.option(
    "--rows", metavar="FIRST:LAST", type=Rows(), default=None,
    help="Only these rows, both included. They count from 0, as in messages and result.json. "
    "You may leave out FIRST or LAST.",
)  # fmt: skip
# Beside a real motor 1 is what it is anyway; anything else is refused there.
PACE = click.option(
    "--pace", type=Pace(), default=None,
    help="On a device in virtual time: let so many of its seconds pass in a second, as 1, for people who watch. "
    "Default: as fast as the machine.",
)  # fmt: skip
# for programs that have shown a config to somebody, as the panel has
AS_CHECKED = click.option("--as-checked", metavar="SHA256", default=None, hidden=True, help="The file's digest.")
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout, and nothing else.")


def require_new(path: Path | None, endings: Sequence[str], *, force: bool | None = None) -> None:
    """Refuse a file of another kind, one that no folder holds or takes, and one that is there, before the work.

    force  whether such a file may be replaced; None: the command has no --force
    """
    if path is None:
        return
    if path.suffix.lower() not in endings:
        fail(f"{path}: this file is of another kind", f"give a name that ends in {', '.join(endings)}")
    if not path.parent.is_dir():
        fail(f"{path.parent} is no folder", f"make it: `mkdir -p {quote(str(path.parent))}`")
    if not os.access(path.parent, os.W_OK):
        fail(f"{path.parent} takes no file of yours", "name a file in another folder")
    if path.exists() and not force:
        other = "give another name, or " + ("remove it" if force is None else "--force")
        fail(f"{path} is there already", other)
