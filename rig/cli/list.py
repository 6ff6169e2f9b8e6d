"""`rig list`: the runs of a folder, one line each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from rig.cli.shared import JSON, PATH, asks_json, say_json
from rig.cli.terminal import show_runs


@click.command("list")
@click.argument("folder", metavar="[FOLDER]", default=Path("runs"), type=PATH)
@click.option(
    "--where", multiple=True, metavar="CONDITION",
    help="Only runs that meet it: a field, one of = != < <= > >= ~ (contains), and a value, such as verdict=ok, "
    "fc_V>0.5 or name~demo. Repeat for several, which must all hold.",
)  # fmt: skip
@click.option(
    "--sort", multiple=True, metavar="FIELD",
    help="Order by this field, such as fc_V; -fc_V: the largest first. Default: by start. Repeat for several.",
)  # fmt: skip
@JSON
def list_runs(folder: Path, where: Sequence[str], sort: Sequence[str]) -> None:
    """List the runs of a folder, one line each.

    Default: runs. The fields for --where and --sort are the keys of --json. The file .rig-index.jsonl in the folder
    holds what was read, so that the next time is quicker. You may delete it at any time.
    """
    from rig.run_folder.catalogue import catalogue, selected

    found = catalogue(folder)
    runs = selected(found.runs, where, sort)
    if asks_json():
        told = {"ok": True, "folder": str(folder), "of": len(found.runs), "runs": [run.as_json() for run in runs]}
        say_json({**told, "notes": list(found.notes)})
        return
    show_runs(runs, len(found.runs))
    for note in found.notes:
        click.echo(f"rig: {note}", err=True)
