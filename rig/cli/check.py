"""`rig check`: check a config."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rig import config
from rig.cli.shared import CONFIG, JSON, asks_json, fail_config
from rig.running import preflight


@click.command()
@CONFIG
@JSON
def check(config_path: Path) -> None:
    """Check a config; no device is needed, nothing moves.

    Checks keys, units, limits, stopping distance and link budget, and prints what a run would do.
    """
    try:
        document = config.read(config_path, takes_pipe=True)
        if config.is_campaign(document):
            lines = list(config.campaign_lines(config.load_campaign(document)))
        else:
            lines = list(preflight.check(document)[1].lines)
    except config.ConfigError as error:
        fail_config(error, f"verdict: refused, {_counted(len(error.problems), 'problem')}; nothing would be run")
    notes = sum(line.startswith("note: ") for line in lines)
    verdict = f"ok with {_counted(notes, 'note')}" if notes else "ok"
    if asks_json():
        click.echo(json.dumps({"ok": True, "verdict": verdict, "lines": lines}))
    else:
        click.echo("\n".join([*lines, f"verdict: {verdict}"]))


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")
