"""`rig schema`: the JSON Schemas."""

from __future__ import annotations

from pathlib import Path

import click

from rig import config
from rig.cli.shared import FILE, fail, written
from rig.run_folder.results import RunMeta, RunResult


@click.command()
@click.option(
    "--to", "file", type=FILE, metavar="FILE",
    help="File to write. Default: stdout.",
)  # fmt: skip
@click.option(
    "--of", "of", type=click.Choice(["config", "campaign", "meta", "result"]), default="config", show_default=True,
    help="What it describes: a config, a config of `rig campaign`, a run's meta.json, or its result.json.",
)  # fmt: skip
@click.option("--campaign", "of_campaign", is_flag=True, help="The same as --of campaign.")
def schema(file: Path | None, of: str, of_campaign: bool) -> None:
    """Write a JSON Schema of a config, or of a run's files."""
    if of_campaign and of not in ("config", "campaign"):
        fail(f"--campaign and --of {of} name two schemas", "leave one of them out")
    if of in ("meta", "result"):
        from rig.run_folder.results.result import schema_text

        text = schema_text(RunMeta if of == "meta" else RunResult)
    else:
        text = config.schema_text(config.Campaign if of_campaign or of == "campaign" else config.Experiment)
    if file is None:
        click.echo(text, nl=False)
    else:
        with written(file):
            file.write_text(text, encoding="utf-8")
