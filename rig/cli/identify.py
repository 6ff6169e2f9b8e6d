"""`rig identify`: identify a motor from recordings."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rig.cli.log_options import log_options
from rig.cli.shared import EXIT_FAILED, FILE, JSON, PATH, ROWS, Positive, asks_json, fail, require_new, say_json
from rig.cli.terminal import patience, show_answer, show_details
from rig.core.estimators import ESTIMATORS
from rig.run_folder.recording.errors import CannotWriteError, RecordingError
from rig.run_folder.recording.log_format import LogFormat
from rig.run_folder.results.meta import REHEARSAL

_MOST_NOTES = 20  # on what was read: what a reader of logs changes or leaves out is told

if TYPE_CHECKING:  # it loads slowly
    from rig.identification import Identification
    from rig.run_folder.recording.recording import Recording


@click.command()
@click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=PATH)
@click.option(
    "--method", "methods", multiple=True, type=click.Choice([entry.name for entry in ESTIMATORS]),
    help="Repeat for several. Default: all that the data allows. "
    "least-squares takes two CSV files, each of a hysteretic relay.",
)  # fmt: skip
@click.option(
    "--without", multiple=True, metavar="STAGE",
    help="A stage of the run that is not read: breakaway, search, relay-1, relay-2, ... Repeat for several.",
)  # fmt: skip
@ROWS
@click.option(
    "--slew", "slew_V_s", metavar="V/S", type=Positive(),
    help="How fast the device of a log ramps its drive, V/s; an XL330 as shipped: 277. Default: no ramp.",
)  # fmt: skip
@click.option(
    "--picture", type=FILE, metavar="FILE.png",
    help="Draw measured against simulated position, the residual, and the fit in %.",
)  # fmt: skip
@click.option(
    "--report", type=FILE, metavar="FILE.html",
    help="Write a page with the answer, that picture, each method and the uncertainty.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Replace these files if they are there already.")
@click.option("--verbose", is_flag=True, help="Show notes, each method, and what the uncertainty is made of, too.")
@log_options
@JSON
def identify(
    paths: Sequence[Path],
    methods: Sequence[str],
    without: Sequence[str],
    rows: tuple[int | None, int | None] | None,
    slew_V_s: float | None,
    picture: Path | None,
    report: Path | None,
    force: bool,
    verbose: bool,
    log: LogFormat | None,
) -> None:
    """Identify gain, time constant and friction from recordings.

    A recording is a run folder, or a CSV file with columns t_s,u_V,y_rad. Several recordings must be of one motor: rig
    says so if they do not agree.

    A log of your own may have any columns and units. Say which: --time ms --drive pwm --full 255 --supply-V 12
    --position counts --counts-per-turn 1440. A unit alone takes the column with a usual name; pos:counts names it, and
    3:counts numbers it. A log without a line of names has time, drive and position, in this order.
    """
    require_new(picture, (".png",), force=force)
    require_new(report, (".html", ".htm"), force=force)
    from rig.identification import identify as identify_recordings
    from rig.run_folder.recording.path_kind import require_distinct
    from rig.run_folder.recording.reader import read_all

    if rows is not None and len(paths) > 1:
        fail(f"--rows takes one recording, not {len(paths)}", "identify one at a time")
    require_distinct(paths)
    with patience("reading and identifying"):
        recordings = [recording for path in paths for recording in read_all(path, log)]
        if rows is not None and len(recordings) > 1:
            fail(f"{paths[0]} holds {len(recordings)} runs, and --rows takes one", "cut the file")
        if rows is not None:
            recordings = [recording.only_rows(*rows) for recording in recordings]
        if slew_V_s is not None:
            _require_commanded(recordings)
            recordings = [replace(recording, slew_V_s=slew_V_s) for recording in recordings]
        found = identify_recordings(recordings, tuple(methods) or None, without=without)
    records = [str(recording.source) for recording in recordings]
    if len(paths) == 1 and not methods and not without and rows is None and slew_V_s is None:
        _keep(paths[0], recordings[0], found)
    undrawn = unsaved = ""
    try:
        undrawn = "" if picture is None else _draw(found, picture)
        if report is not None:
            from rig.output.report.page import write_identified

            with patience("drawing the report"):
                write_identified(found, records, report)
    except CannotWriteError as error:  # what was found is told all the same
        unsaved, picture, report = str(error), None, None
        click.echo(f"rig: {unsaved}", err=True)
    result = found.as_result()
    ok = result.answer is not None and not result.answer.is_refused and not unsaved
    if asks_json():
        files = {"picture": None if undrawn or picture is None else str(picture), "report": report and str(report)}
        say_json({"ok": ok, "records": records, **files, **result.as_json()})
        sys.exit(0 if ok else EXIT_FAILED)
    if found.rehearsal:
        click.echo(REHEARSAL)
    if not verbose:
        notes = [f"{recording.source.name}: {note}" for recording in recordings for note in recording.notes]
        for note in (*notes[:_MOST_NOTES], *found.changes):
            click.echo(note)
        if (more := len(notes) - _MOST_NOTES) > 0:
            click.echo(f"{more} more note{'s' if more > 1 else ''} on what was read")
    show_answer(result.answer)
    if verbose:
        show_details(result)
    if picture is not None:
        click.echo(f"picture: {undrawn or picture}")
    if report is not None:
        click.echo(f"report: {report}")
    if not verbose:
        click.echo("more: the same command with --verbose")
    sys.exit(0 if ok else EXIT_FAILED)


def _require_commanded(recordings: Sequence[Recording]) -> None:
    """Refuse --slew for a recording whose drives are as they acted."""
    for recording in recordings:
        if recording.config_text is not None or recording.own_loop is not None:
            what = "a run says when its drives acted" if recording.own_loop is None else "a servo's law has its ramp"
            fail(f"--slew is given, and {recording.source} has the ramp already: {what}", "leave it out")


def _keep(path: Path, recording: Recording, found: Identification) -> None:
    """Write the curves of a run folder whose result has this answer and no such curves yet, so that reports draw them.

    Where the disk does not take them, a line says so.
    """
    from rig.run_folder.recording.curves import read_curves, write_curves
    from rig.run_folder.recording.path_kind import is_run
    from rig.run_folder.recording.reader import read_result

    result, curves = read_result(path)[0] if is_run(path) else None, found.curves
    if result is None or result.answer is None or curves is None or not curves.is_of(result.answer):
        return
    try:
        read_curves(path, recording, result.answer)
    except RecordingError:
        try:
            write_curves(path, recording, curves)
        except CannotWriteError as error:
            click.echo(f"note: {error}", err=True)


def _draw(found: Identification, path: Path) -> str:
    """Write the picture; why there is none, in words, else empty. Raises CannotWriteError."""
    from rig.output.report.simulated import write_picture
    from rig.output.report.style import AbsentError

    try:
        write_picture(found, path)
    except AbsentError as absent:
        return f"none: {absent}"
    return ""
