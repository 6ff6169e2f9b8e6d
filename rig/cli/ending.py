"""How a command ends: its JSON on stdout; or cause and cure, and the exit status."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

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


def say_json(value: Part | Mapping[str, object]) -> None:
    """Print a command's answer as JSON on stdout, as of ``json_text``."""
    from rig.run_folder.recording.folder import json_text

    click.echo(json_text(value), nl=False)


def fail(cause: str, cure: str = "", *, status: int = EXIT_BAD_INPUT) -> NoReturn:
    """Print the cause and the cure, a line each, on stderr; with --json one JSON object on stdout. Then exit."""
    if click.get_current_context().params.get("as_json"):
        click.echo(json.dumps({"ok": False, "cause": cause, "cure": cure}))
    else:
        click.echo(f"rig: {cause}", err=True)
        if cure:
            click.echo(f"     {cure}", err=True)
    sys.exit(status)


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
    if click.get_current_context().params.get("as_json"):
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
        fail(str(error), error.cure, status=EXIT_FAILED)
    if isinstance(error, RecordingError):
        place = f"{error.path}: " if error.line is None else f"{error.path}:{error.line}: "
        status = EXIT_FAILED if isinstance(error, CannotWriteError) else EXIT_BAD_INPUT
        fail(place + error.cause, error.cure, status=status)
    if isinstance(error, CauseError):
        fail(error.cause, error.cure, status=error.status)
    if isinstance(error, EmulationError):
        fail(*str(error).split("\n", maxsplit=1), status=EXIT_FAILED)
    raise error
