"""`rig report`: write the report of a run again."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli.shared import EXIT_FAILED, PATH, fail
from rig.cli.terminal import patience


@click.command()
@click.argument("run_folder", metavar="RUN", type=PATH)
def report(run_folder: Path) -> None:
    """Write the report of a run again, and print its path."""
    from rig.output.report import write_report
    from rig.run_folder.recording.path_kind import require_run

    try:
        require_run(run_folder)
        with patience("drawing the report"):
            path = write_report(run_folder)
    except OSError as error:
        fail(
            f"{run_folder}: cannot be read: {error.strerror}", "check the disk and its permissions", status=EXIT_FAILED
        )
    click.echo(path)
