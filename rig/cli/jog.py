"""`rig jog`: drive the shaft for a moment."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli.driving import checked_bench, finish, perform
from rig.cli.failure import EXIT_BAD_INPUT, fail
from rig.cli.options import CONFIG, JSON, OUT
from rig.results import known


@click.command()
@CONFIG
@click.option("--u-V", "u_V", type=float, required=True, help="Drive, V; its sign is the direction.")
@click.option("--seconds", type=click.FloatRange(0.01, 5.0), default=0.3, show_default=True, help="How long.")
@OUT
@JSON
def jog(config_path: Path, u_V: float, seconds: float, out: Path, as_json: bool) -> None:
    """Drive the shaft for a moment, within the limits.

    If it stands outside the limits, it can only be driven inward: that brings it back.
    """
    experiment = checked_bench(config_path)
    from rig import experiment as script

    if not abs(u_V) <= experiment.drive.max_V:
        fail(
            EXIT_BAD_INPUT,
            f"--u-V {u_V:g} is beyond drive.max_V {experiment.drive.max_V:g}",
            f"ask for --u-V between {-experiment.drive.max_V:g} and {experiment.drive.max_V:g}, or raise drive.max_V",
        )
    outcome = perform(lambda on_start: script.jog(experiment, u_V, seconds, out, on_start), as_json)
    moved = outcome.result.jog
    if moved is not None and not as_json:
        click.echo(f"y {known(moved.from_rad):+.3f} -> {known(moved.to_rad):+.3f} rad")
        if moved.refused_ticks:
            click.echo(f"the guard cut the drive in {moved.refused_ticks} ticks: it drove outward; try the other sign")
    finish(outcome, as_json)
