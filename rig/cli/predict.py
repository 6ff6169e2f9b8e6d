"""`rig predict`: the limit cycle that theory expects."""

from __future__ import annotations

import json
import sys

import click

from rig.cli.shared import EXIT_FAILED, JSON, asks_json, fail
from rig.cli.terminal import show_prediction


@click.command()
@click.option("--tau", type=float, required=True, help="Time constant, s.")
@click.option("--K", "K", type=float, required=True, help="Velocity gain, (rad/s)/V.")
@click.option("--fc", type=float, required=True, help="Coulomb friction, V.")
@click.option("--fs", type=float, help="Static friction, V. Default: as --fc.")
@click.option("--h1", type=float, required=True, help="Gain of the relay on position, V.")
@click.option("--h2", type=float, required=True, help="Gain of the relay on the integral, V.")
@JSON
def predict(tau: float, K: float, fc: float, fs: float | None, h1: float, h2: float) -> None:
    """Predict limit cycle and stability for given relay gains.

    By Theorems 2.1 and 2.2, and by the describing function.
    """
    from rig.model.prediction import predict_cycle

    try:
        prediction = predict_cycle(tau, K, fc, fc if fs is None else fs, h1, h2)
    except ValueError as error:
        fail(str(error), "--tau and --K must be > 0, friction and gains >= 0, --fs at least --fc")
    if asks_json():
        click.echo(json.dumps(prediction.as_json()))
    else:
        show_prediction(prediction)
    sys.exit(EXIT_FAILED if prediction.exact is None else 0)
