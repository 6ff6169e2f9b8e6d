"""`rig run`: the whole experiment."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import click

from rig.cli.driving import checked_bench, perform
from rig.cli.shared import AS_CHECKED, CONFIG, EXIT_FAILED, JSON, OUT, PACE, PATH, asks_json, fail, say_json
from rig.cli.terminal import show_scatter


@click.command()
@CONFIG
@OUT
@click.option(
    "--repeat", type=click.IntRange(1, 1000), default=1,
    help="Run it N times and show the scatter between runs. An emulated bench takes seed, seed + 1, ...",
)  # fmt: skip
@click.option(
    "--model", "model_run", type=PATH,
    help="With relay.until: begin with the motor of this run folder, or of this result.json.",
)  # fmt: skip
@PACE
@AS_CHECKED
@click.option("--verbose", is_flag=True, help="Show the tests, each method with its tracking, and the loop, too.")
@JSON
def run(
    config_path: Path,
    out: Path,
    repeat: int,
    model_run: Path | None,
    pace: float | None,
    as_checked: str | None,
    verbose: bool,
) -> None:
    """Run the whole experiment, identify the motor, write a report.

    The stages: breakaway, search, tests, identify, verify, report.
    """
    experiment = checked_bench(config_path, pace, as_checked)
    known = None
    if model_run is not None:
        if experiment.relay.until is None or experiment.law is not None:
            fail(
                f"--model needs relay.until in {config_path}: only there the tests depend on what is known",
                "set relay.until (docs/until.md), or leave --model out",
            )
        from rig.identification.known_model import known_model

        known = known_model(model_run, experiment.drive.max_V)
    if sys.stderr.isatty() and not asks_json():
        click.echo("opening the bench ...", err=True)
    from rig.running.experiment import script

    shown = partial(perform, verbose=verbose)
    outcomes = script.repeated(experiment, repeat, out, shown, known)
    if asks_json():
        results = [outcome.as_json() for outcome in outcomes]
        ok = all(result["ok"] for result in results)
        say_json(results[0] if repeat == 1 else {"ok": ok, "runs": results})
    elif repeat > 1:
        show_scatter([outcome.result for outcome in outcomes])
    sys.exit(EXIT_FAILED if any(outcome.failure for outcome in outcomes) else 0)
