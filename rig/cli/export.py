"""`rig export`: a run as one file."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rig.cli.failure import fail_input
from rig.cli.options import JSON, ROWS
from rig.recording.errors import RecordingError


@click.command()
@click.argument("run_folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--to", "file", required=True, type=click.Path(path_type=Path), metavar="FILE",
    help="Its suffix names the format: .mat (MATLAB, Octave), .npz (numpy), .csv (t_s,u_V,y_rad,t_u_s) or .json.",
)  # fmt: skip
@click.option("--stage", default=None, help="Only the rows of this stage, such as relay-1. Default: all.")
@ROWS
@click.option("--force", is_flag=True, help="Replace FILE if it is there already.")
@JSON
def export(
    run_folder: Path,
    file: Path,
    stage: str | None,
    rows: tuple[int | None, int | None] | None,
    force: bool,
    as_json: bool,
) -> None:
    """Write a run to one file that other programs open.

    The file holds samples, events and result; a .csv file holds the samples.
    """
    from rig.export import export as export_run

    try:
        run = export_run(run_folder, file, stage, rows, overwrite=force)
    except RecordingError as error:
        fail_input(error)
    number = len(run.recording)
    if as_json:
        click.echo(json.dumps({"ok": True, "file": str(file), "rows": number, "notes": run.notes}))
        return
    for note in run.notes:
        click.echo(note)
    click.echo(f"{file}: {number} rows")
