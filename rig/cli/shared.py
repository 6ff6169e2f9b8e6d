"""What commands share: arguments and options; and how they end: JSON on stdout, or cause, cure and exit status."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from shlex import quote
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

import click

from rig.backends.emulated.errors import EmulationError
from rig.core.errors import CauseError, RigError
from rig.core.faults import Fault
from rig.run_folder.recording.errors import CannotWriteError, RecordingError

if TYPE_CHECKING:  # it loads slowly
    from rig.config import ConfigError
    from rig.run_folder.results.part import Part

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2
_JSON = "rig.cli.json"
_ENDS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


def asks_json() -> bool:
    """Whether the command is to print one JSON object (``JSON``)."""
    return bool(click.get_current_context().meta.get(_JSON))


def say_json(value: Part | Mapping[str, object]) -> None:
    """Print a command's answer as JSON on stdout, as of ``json_text``."""
    from rig.run_folder.recording.folder import json_text

    click.echo(json_text(value), nl=False)


def fail(cause: str, cure: str = "", *, status: int = EXIT_BAD_INPUT) -> NoReturn:
    """Print the cause and the cure, a line each, on stderr; with --json one JSON object on stdout. Then exit."""
    if asks_json():
        click.echo(json.dumps({"ok": False, "cause": cause, "cure": cure}))
    else:
        click.echo(f"rig: {cause}", err=True)
        if cure:
            click.echo(f"     {cure}", err=True)
    sys.exit(status)


class EndedError(CauseError):
    """A signal has ended the command."""

    status = EXIT_FAILED


@contextlib.contextmanager
def ended_in_words(cause: str, cure: str) -> Iterator[None]:
    """Within the block a SIGTERM or SIGHUP ends it in these words, and what is open is closed; unless what drives does.

    One more is too late: it would end the putting back. A SIGHUP that is ignored, as after `nohup`, stays so.
    Raises EndedError.
    """

    def ended(number: int, frame: FrameType | None) -> NoReturn:
        end_no_more()
        raise EndedError(f"ended by {signal.Signals(number).name}; {cause}", cure)

    before = {one: signal.getsignal(one) for one in _ENDS}
    for one, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(one, ended)
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def end_no_more() -> None:
    """It is too late for the signals of ``ended_in_words``."""
    for one in _ENDS:
        signal.signal(one, signal.SIG_IGN)


def as_typed(cure: str) -> str:
    """A cure, with the command that was typed where it says `rig run CONFIG`."""
    context = click.get_current_context()
    names = [
        one.human_readable_name for one in context.command.params if isinstance(one, click.Argument) and one.required
    ]
    return cure.replace("`rig run CONFIG`", f"`{' '.join(['rig', *context.command_path.split()[1:], *names])}`")


@contextlib.contextmanager
def written(file: Path) -> Iterator[None]:
    """Exit where the block cannot write this file."""
    try:
        yield
    except FileExistsError:
        fail(f"{file} is there already", "name another file")
    except OSError as error:
        fail(f"{file}: cannot be written: {error.strerror}", "name a file in an existing folder")


def fail_config(error: ConfigError, verdict: str = "") -> NoReturn:
    """Exit for a bad config: print each problem with file, line and key; then ``verdict`` on stdout."""
    if asks_json():
        last = {"verdict": verdict.removeprefix("verdict: ")} if verdict else {}
        click.echo(json.dumps({"ok": False, **last, "problems": str(error).splitlines()}))
    else:
        click.echo(str(error), err=True)
        if verdict:
            click.echo(verdict)
    sys.exit(EXIT_BAD_INPUT)


def fail_with(error: RigError) -> NoReturn:
    """Exit for what went wrong on purpose: a fault, a bad config or recording, a busy folder, a wish that cannot be.

    Raises the error itself where it has no words for people.
    """
    from rig.config.problems import ConfigError

    if isinstance(error, ConfigError):
        fail_config(error)
    if isinstance(error, Fault):
        fail(str(error), as_typed(error.cure), status=EXIT_FAILED)
    if isinstance(error, RecordingError):
        place = f"{error.path}: " if error.line is None else f"{error.path}:{error.line}: "
        status = EXIT_FAILED if isinstance(error, CannotWriteError) else EXIT_BAD_INPUT
        fail(place + error.cause, error.cure, status=status)
    if isinstance(error, CauseError):
        fail(error.cause, error.cure, status=error.status)
    if isinstance(error, EmulationError):
        fail(*str(error).split("\n", maxsplit=1), status=EXIT_FAILED)
    raise error


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


PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)
PICTURES = (".png", ".svg", ".pdf")  # as rig.output.report.style.FORMATS, which loads slowly
CONFIG = click.argument("config_path", metavar="CONFIG", type=PATH)
# In every command --out is the folder in which rig makes run folders, and --to is the file that it writes.
OUT = click.option(
    "--out", type=FOLDER, default=Path("runs"), show_default=True,
    help="Folder in which rig makes the run folder.",
)  # fmt: skip
ROWS = click.option(
    "--rows", metavar="FIRST:LAST", type=Rows(),
    help="Only these rows, both included. They count from 0, as in messages and result.json. "
    "You may leave out FIRST or LAST.",
)  # fmt: skip
# Beside a real motor 1 is what it is anyway; anything else is refused there.
PACE = click.option(
    "--pace", type=Pace(),
    help="On a device in virtual time: let so many of its seconds pass in a second, as 1, for people who watch. "
    "Default: as fast as the machine.",
)  # fmt: skip
# for programs that have shown a config to somebody, as the panel has
AS_CHECKED = click.option("--as-checked", metavar="SHA256", hidden=True, help="The file's digest.")
JSON = click.option(
    "--json", is_flag=True, expose_value=False, callback=lambda context, _, value: context.meta.update({_JSON: value}),
    help="Print one JSON object on stdout, and nothing else.",
)  # fmt: skip


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
