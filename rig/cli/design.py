"""`rig design`: which test would tell most about a motor that is roughly known."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from rig.cli import shared
from rig.cli.driving import checked
from rig.cli.terminal import patience, show_design

NO_TEST = (
    "rig: no test stays inside the room for every motor within the doubt\n"
    "     lower --doubt, widen limits.soft_rad or raise limits.max_speed_rad_s; or run with relay.target"
)


@click.command()
@shared.CONFIG
@click.option(
    "--model", "model_run", required=True, type=shared.PATH,
    help="Run folder, or its result.json, from which the motor comes.",
)  # fmt: skip
@click.option(
    "--interval", "percent", type=shared.FiniteRange(0.01, 50.0), default=1.0, show_default=True,
    help="Half width of the 95 % intervals of tau, K and f_c to design for, in %.",
)  # fmt: skip
@click.option(
    "--doubt", type=shared.FiniteRange(1.0, 90.0), default=10.0, show_default=True,
    help="By how many % tau, K and f_c may all be wrong. No motor within that leaves the limits.",
)  # fmt: skip
@click.option("--to", "file", type=shared.FILE, metavar="FILE",
    help="Write the picture: .png, .svg or .pdf.",
)  # fmt: skip
@shared.JSON
def design(config_path: Path, model_run: Path, percent: float, doubt: float, file: Path | None) -> None:
    """Design relay gains and strokes for a known motor.

    By exact simulation, within the limits of CONFIG: how long a test takes until the 95 % intervals of tau, K and f_c
    are as narrow as you want. No device is opened.
    """
    shared.require_new(file, shared.PICTURES)
    experiment = checked(config_path)
    from rig.design.design_map import design_map
    from rig.identification.known_model import known_model
    from rig.output.report import design_map as picture
    from rig.run_folder.recording.reader import read_result
    from rig.run_folder.results.meta import REHEARSAL
    from rig.running.preflight.planned_tests import task_of_run

    try:
        motor = known_model(model_run, experiment.drive.max_V).motor
        result, _ = read_result(model_run.parent if model_run.is_file() else model_run)
        task = task_of_run(experiment, motor, result, doubt, percent)
    except ValueError as error:
        shared.fail(f"{model_run}: {error}", "give another run")
    with patience("simulating tests"):
        found = design_map(task, doubt)
    if file is not None:
        picture.save(found, f"{experiment.name}: tests for the motor of {model_run}", file)
    ok = bool(found.strokes or found.gains)
    made_up = result is not None and bool(result.rehearsal)
    if shared.asks_json():
        shared.say_json(
            {"ok": ok, "model": str(model_run), **({"rehearsal": True} if made_up else {}), **found.as_json()}
        )
    else:
        if made_up:
            click.echo(f"{model_run}: {REHEARSAL}")
        show_design(found)
        if file is not None:
            click.echo(f"picture: {file}")
    if not ok:
        click.echo(NO_TEST, err=True)
    sys.exit(0 if ok else shared.EXIT_FAILED)
