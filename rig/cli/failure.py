"""How a command that cannot be done ends: cause and cure, and the exit status."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, NoReturn

import click

from rig.backends.emulated.errors import EmulationError
from rig.core.faults import Fault
from rig.run_folder.live.unrecorded import BusyError
from rig.run_folder.recording.errors import CannotWriteError, RecordingError

if TYPE_CHECKING:  # each loads slowly
    from rig.config import ConfigError
    from rig.identification import IdentifyError

EXIT_FAILED = 1
EXIT_BAD_INPUT = 2


def fail(status: int, cause: str, cure: str = "") -> NoReturn:
    """Print the cause and the cure, a line each, on stderr; with --json one JSON object on stdout. Then exit."""
    if click.get_current_context().params.get("as_json"):
        click.echo(json.dumps({"ok": False, "cause": cause, "cure": cure}))
    else:
        click.echo(f"rig: {cause}", err=True)
        if cure:
            click.echo(f"     {cure}", err=True)
    sys.exit(status)


def fail_input(error: RecordingError | IdentifyError) -> NoReturn:
    """Exit for a bad recording or a full disk: print file and line, the cause, the cure."""
    place = ""
    if isinstance(error, RecordingError):
        place = f"{error.path}: " if error.line is None else f"{error.path}:{error.line}: "
    status = EXIT_FAILED if isinstance(error, CannotWriteError) else EXIT_BAD_INPUT
    fail(status, place + error.cause, error.cure)


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


@contextlib.contextmanager
def faults() -> Iterator[None]:
    """Exit for a fault, a bad recording, a broken emulated device, or a busy folder that the block raises."""
    try:
        yield
    except Fault as fault:
        fail(EXIT_FAILED, str(fault), fault.cure)
    except EmulationError as error:
        fail(EXIT_FAILED, *str(error).split("\n", maxsplit=1))
    except BusyError as error:
        fail(EXIT_FAILED, error.cause, error.cure)
    except RecordingError as error:
        fail_input(error)
