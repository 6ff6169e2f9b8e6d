"""`rig predict-run`: what an answer says of any record, beside what was measured."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from rig.cli.log_options import log_options
from rig.cli.shared import FILE, JSON, PATH, ROWS, asks_json, fail, require_new, say_json
from rig.cli.terminal import patience
from rig.run_folder.recording.log_format import LogFormat
from rig.run_folder.results.answer_words import of_all

_TELLS_PERCENT = 50.0  # fit below which a model says less than half of the motion


@click.command("predict-run")
@click.argument("path", metavar="LOG", type=PATH)
@click.option(
    "--model", "model", required=True, type=PATH, metavar="FOUND",
    help="Run folder, or what `rig identify --json` printed into a file.",
)  # fmt: skip
@ROWS
@click.option(
    "--picture", type=FILE, metavar="FILE.png",
    help="Draw measured against predicted position, the residual, and the fit in %.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Replace this file if it is there already.")
@log_options
@JSON
def predict_run(
    path: Path,
    model: Path,
    rows: tuple[int | None, int | None] | None,
    picture: Path | None,
    force: bool,
    log: LogFormat | None,
) -> None:
    """Predict a record of a motor by the answer of another.

    The motor of the answer, with its laws and its delay, moves under the drive of the record. Only position and speed
    at the start are fitted. LOG is a run folder or a CSV file, with the options of a log as in `rig identify`.
    """
    require_new(picture, (".png",), force=force)
    from rig.identification.known_model import answer_in
    from rig.output.report.simulated import beyond, predicted_record, write_drawn
    from rig.output.report.style import AbsentError
    from rig.run_folder.recording.reader import read_all

    try:
        answer = answer_in(model)
        recordings = read_all(path, log)
        if rows is not None:
            recordings = [recording.only_rows(*rows) for recording in recordings]
        with patience("predicting"):
            shown = [predicted_record(answer, recording) for recording in recordings]
            if picture is not None:
                write_drawn(shown, answer.method, picture)
    except AbsentError as absent:
        fail(f"{model}: {absent}", "see why: `rig identify` of what it comes from; or give another")
    remarks = [beyond(answer, recording) for recording in recordings]
    if asks_json():
        found = [
            {
                "record": str(recording.source),
                "fit_percent": one.fit_percent,
                "rms_rad": one.rms_rad,
                "beyond": remark or None,
            }
            for recording, one, remark in zip(recordings, shown, remarks, strict=True)
        ]
        say_json({"model": str(model), "picture": picture and str(picture), "predictions": found})
        sys.exit(0)
    for recording, one, remark in zip(recordings, shown, remarks, strict=True):
        for note in recording.notes:
            click.echo(f"{one.name}: {note}")
        in_parts = f", in {one.parts} parts between its gaps, each from a start of its own" if one.parts > 1 else ""
        click.echo(f"{one.name}: fit {of_all(one.fit_percent)}, {one.rms_rad:.3g} rad off (RMS){in_parts}")
        if one.fit_percent < _TELLS_PERCENT:
            click.echo(f"{one.name}: this model does not tell that record: is it of another motor, or in other units?")
        if remark:
            click.echo(f"{one.name}: {remark}")
    if picture is not None:
        click.echo(f"picture: {picture}")
