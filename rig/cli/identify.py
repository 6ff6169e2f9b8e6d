"""`rig identify`: identify a motor from recordings."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click

from rig.cli.failure import EXIT_BAD_INPUT, EXIT_FAILED, fail, fail_input
from rig.cli.log_options import log_options
from rig.cli.options import JSON, ROWS
from rig.estimators import ESTIMATORS
from rig.recording.errors import RecordingError
from rig.recording.folder import json_text
from rig.recording.log_format import LogFormat
from rig.terminal import patience, show_estimates, show_friction_law, show_friction_map, show_motor_law


@click.command()
@click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=click.Path(path_type=Path))
@click.option(
    "--method",
    "methods",
    multiple=True,
    type=click.Choice([entry.name for entry in ESTIMATORS]),
    help="Repeat for several. Default: all that the data allows. "
    "least-squares takes two CSV files, each of a hysteretic relay.",
)
@click.option(
    "--without",
    multiple=True,
    metavar="STAGE",
    help="A stage of the run that is not read: breakaway, search, relay-1, relay-2, ... Repeat for several.",
)
@ROWS
@log_options
@JSON
def identify(
    paths: Sequence[Path],
    methods: Sequence[str],
    without: Sequence[str],
    rows: tuple[int | None, int | None] | None,
    log: LogFormat | None,
    as_json: bool,
) -> None:
    """Identify gain, time constant and friction from recordings.

    A recording is a run folder, or a CSV file with columns t_s,u_V,y_rad. Several recordings must be of one motor: rig
    says so if they do not agree.

    A log of your own may have any columns and units. Say which: --time ms --drive pwm --full 255 --supply-V 12
    --position counts --counts-per-turn 1440. A unit alone takes the column with a usual name; pos:counts names it, and
    3:counts numbers it. A log without a line of names has time, drive and position, in this order.
    """
    from rig.identify import IdentifyError
    from rig.identify import identify as identify_recordings
    from rig.recording.path_kind import require_distinct
    from rig.recording.reader import read

    if rows is not None and len(paths) > 1:
        fail(EXIT_BAD_INPUT, f"--rows takes one recording, not {len(paths)}", "identify one at a time")
    try:
        require_distinct(paths)
        with patience("reading and identifying"):
            recordings = [read(path, log) for path in paths]
            if rows is not None:
                recordings = [recording.only_rows(*rows) for recording in recordings]
            found = identify_recordings(recordings, tuple(methods) or None, without=without)
    except (RecordingError, IdentifyError) as error:
        fail_input(error)
    result = found.as_result()
    ok = any(not estimate.is_refused for estimate in result.estimates.values())
    if as_json:
        click.echo(json_text({"ok": ok, "records": [str(path) for path in paths], **result.as_json()}), nl=False)
    else:
        for note in result.notes:
            click.echo(note)
        show_estimates(result.estimates, None)
        show_friction_law(result.friction_law, of_plain=bool(result.law))
        show_motor_law(result)
        show_friction_map(result.friction_map)
    sys.exit(0 if ok else EXIT_FAILED)
