"""`rig track`: the tracking check with the models of an earlier run."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from rig.cli.driving import checked_bench, finish, perform
from rig.cli.shared import CONFIG, JSON, OUT, PACE, PATH, fail


@click.command()
@CONFIG
@click.option("--model", "model_run", required=True, type=PATH, help="Run folder from which the models come.")
@OUT
@PACE
@JSON
def track(config_path: Path, model_run: Path, out: Path, pace: float | None) -> None:
    """Run the tracking check with the models of an earlier run."""
    experiment = checked_bench(config_path, pace)
    from rig.identification import identify
    from rig.identification.known_model import kept_models
    from rig.run_folder.recording.reader import read_run
    from rig.running.experiment import script

    if experiment.tracking is None:
        fail(f"{config_path} has no section `tracking`", "add one, as in config/demo.yaml")
    models = kept_models(model_run) or identify([read_run(model_run)]).as_result()
    finish(perform(partial(script.run_tracking, experiment, models, model_run, out)))
