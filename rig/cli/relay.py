"""`rig relay`: the experiment without the tracking check."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from rig.cli.driving import checked_bench, finish, perform
from rig.cli.shared import CONFIG, JSON, OUT, PACE


@click.command()
@CONFIG
@OUT
@PACE
@JSON
def relay(config_path: Path, out: Path, pace: float | None) -> None:
    """Run breakaway, gain search and relay tests, and identify.

    No tracking check follows.
    """
    experiment = checked_bench(config_path, pace)
    from rig.running.experiment import script

    finish(perform(partial(script.run_relay, experiment, out)))
