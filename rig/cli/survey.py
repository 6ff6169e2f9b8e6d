"""`rig survey`: slow sweeps of the travel, and the friction map."""

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
def survey(config_path: Path, out: Path, pace: float | None) -> None:
    """Sweep the travel slowly to and fro, and draw the friction map.

    The stages: breakaway, search, one relay test, survey, identify. The map shows the drive over speed and over
    position.
    """
    experiment = checked_bench(config_path, pace)
    from rig.running.experiment import script

    finish(perform(partial(script.run_survey, experiment, out)))
