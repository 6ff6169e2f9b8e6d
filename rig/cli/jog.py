"""`rig jog`: drive the shaft for a moment."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli.driving import checked_bench, finish, perform
from rig.cli.shared import AS_CHECKED, CONFIG, JSON, OUT, PACE, FiniteRange, asks_json, fail
from rig.config import Experiment
from rig.run_folder.results import known

USUAL_S, LONGEST_S = 0.3, 5.0
USUAL_LEASED_S, LONGEST_LEASED_S = 60.0, 600.0


@click.command()
@CONFIG
@click.option("--u-V", "u_V", type=float, help="Drive, V; its sign is the direction.")
@click.option("--leased", is_flag=True, help="For programs: drive only while a lease in the run folder is renewed.")
@click.option(
    "--seconds", type=FiniteRange(0.01, LONGEST_LEASED_S),
    help=f"How long: {USUAL_S:g} by default, at most {LONGEST_S:g}; with --leased at the longest: {USUAL_LEASED_S:g} "
    f"by default, at most {LONGEST_LEASED_S:g}.",
)  # fmt: skip
@OUT
@PACE
@AS_CHECKED
@JSON
def jog(
    config_path: Path,
    u_V: float | None,
    leased: bool,
    seconds: float | None,
    out: Path,
    pace: float | None,
    as_checked: str | None,
) -> None:
    """Drive the shaft for a moment, within the limits.

    If it stands outside the limits, it can only be driven inward: that brings it back.

    With --leased another program gives the drive, as the panel does: by leases of at most 150 ms, which it renews as
    long as somebody holds the button (docs/panel.md). If that program ends or hangs, the drive is 0.
    """
    if leased == (u_V is not None):
        fail("a jog has either --u-V or --leased", "give --u-V and the drive in V, as `--u-V 0.5`")
    longest_s = LONGEST_LEASED_S if leased else LONGEST_S
    duration_s = seconds if seconds is not None else USUAL_LEASED_S if leased else USUAL_S
    if duration_s > longest_s:
        fail(f"--seconds {duration_s:g} is too long", f"ask for at most {longest_s:g}")
    experiment = checked_bench(config_path, pace, as_checked)
    from rig.running.experiment import script

    if u_V is None:
        outcome = perform(lambda on_start: script.jog_leased(experiment, duration_s, out, on_start))
    else:
        drive_V = _within(experiment, u_V)
        outcome = perform(lambda on_start: script.jog(experiment, drive_V, duration_s, out, on_start))
    moved = outcome.result.jog
    if moved is not None and not asks_json():
        click.echo(f"y {known(moved.from_rad):+.3f} -> {known(moved.to_rad):+.3f} rad")
        if moved.refused_ticks:
            click.echo(f"the guard cut the drive in {moved.refused_ticks} ticks: it drove outward; try the other sign")
    finish(outcome)


def _within(experiment: Experiment, u_V: float) -> float:
    """The drive, if the config allows it; else the command ends."""
    if not abs(u_V) <= experiment.drive.max_V:
        fail(
            f"--u-V {u_V:g} is beyond drive.max_V {experiment.drive.max_V:g}",
            f"ask for --u-V between {-experiment.drive.max_V:g} and {experiment.drive.max_V:g}, or raise drive.max_V",
        )
    return u_V
