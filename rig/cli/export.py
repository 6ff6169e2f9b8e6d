"""`rig export`: a run as one file, or its motor as a model for another tool."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rig.cli.shared import JSON, PATH, ROWS, Positive, asks_json, fail


@click.command()
@click.argument("run_folder", metavar="RUN", type=PATH)
@click.option(
    "--to", "to", required=True, metavar="FILE|TOOL",
    help="A file, whose suffix names the format: .mat (MATLAB, Octave), .npz (numpy), .csv (t_s,u_V,y_rad,t_u_s) or "
    ".json. Or a tool that gets the model: control, matlab, mujoco, wpilib, c or bam.",
)  # fmt: skip
@click.option(
    "--into", type=PATH, metavar="FOLDER",
    help="For a tool: the folder that gets its files. Default: the working folder.",
)  # fmt: skip
@click.option(
    "--N-m-per-V", "torque_N_m_V", type=Positive(),
    help="For mujoco and bam: the torque of a volt, as `rig newton-metres` tells it. Then torques are in N m.",
)  # fmt: skip
@click.option("--R-ohm", "R_ohm", type=Positive(), help="For bam: of the winding.")
@click.option("--stage", help="Only the rows of this stage, such as relay-1. Default: all.")
@ROWS
@click.option("--force", is_flag=True, help="Replace files that are there already.")
@JSON
def export(
    run_folder: Path,
    to: str,
    into: Path | None,
    torque_N_m_V: float | None,
    R_ohm: float | None,
    stage: str | None,
    rows: tuple[int | None, int | None] | None,
    force: bool,
) -> None:
    """Write a run, or its motor, for another program.

    One file that other programs open, or a model that another tool loads. A file holds samples, events and result; a
    .csv file holds the samples. A model has the numbers of the motor with units and intervals, its laws, and where it
    comes from.
    """
    from rig.output.export import FORMATS, TOOLS

    if to in TOOLS:
        if stage is not None or rows is not None:
            fail(f"--to {to} takes the model of the whole run", "leave out --stage and --rows")
        _model(run_folder, to, into or Path(), (torque_N_m_V, R_ohm), force)
    elif torque_N_m_V is not None or R_ohm is not None:
        fail(f"--N-m-per-V and --R-ohm are for a tool, and {to!r} is none", "leave them out")
    elif into is not None:
        fail(f"--into is for a tool, and {to!r} is none", f"--to one of {', '.join(TOOLS)}")
    elif Path(to).suffix.lower() not in FORMATS:
        fail(
            f"{to}: ends in none of {', '.join(FORMATS)}, and is no tool",
            f"give a file with one of these suffixes, or one of {', '.join(TOOLS)}",
        )
    else:
        _whole_run(run_folder, Path(to), (stage, rows), force)


def _whole_run(
    run_folder: Path, file: Path, chosen: tuple[str | None, tuple[int | None, int | None] | None], force: bool
) -> None:
    """Write the run to one file; ``chosen``: stage and rows."""
    from rig.output.export import export as export_run

    run = export_run(run_folder, file, *chosen, overwrite=force)
    number = len(run.recording)
    if asks_json():
        click.echo(json.dumps({"ok": True, "file": str(file), "rows": number, "notes": run.notes}))
        return
    for note in run.notes:
        click.echo(note)
    click.echo(f"{file}: {number} rows")


def _model(run_folder: Path, tool: str, into: Path, stated: tuple[float | None, float | None], force: bool) -> None:
    """Write the model for a tool; ``stated``: torque of a volt, N m, and resistance of the winding, ohm."""
    from rig.output.export import export_model

    torque_N_m_V, R_ohm = stated
    written = export_model(run_folder, tool, into, overwrite=force, torque_N_m_V=torque_N_m_V, R_ohm=R_ohm)
    files = [str(file) for file in written.files]
    if asks_json():
        told = {key: written.motor.as_json()[key] for key in ("laws", "lacks")}
        click.echo(json.dumps({"ok": True, "tool": tool, "files": files, **told, "notes": written.notes}))
        return
    for note in (*written.notes, *written.motor.lacks_in_words()):
        click.echo(note)
    for file in files:
        click.echo(file)
