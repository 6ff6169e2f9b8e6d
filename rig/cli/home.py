"""`rig home`: tell a device where its encoder stands."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli.driving import checked_bench
from rig.cli.shared import CONFIG, JSON, OUT, PACE, asks_json, fail, say_json


@click.command()
@CONFIG
@click.option("--at-rad", type=float, default=0.0, show_default=True, help="By hand: where the shaft stands, rad.")
@click.option("--here", is_flag=True, help="By hand: the shaft stands there already; do not ask.")
@OUT
@PACE
@JSON
def home(config_path: Path, at_rad: float, here: bool, out: Path, pace: float | None) -> None:
    """Set the zero of an encoder.

    It counts from wherever it was switched on. By hand: turn the shaft to its zero, and press Enter. With an end
    switch (sensor.encoder.home): rig drives the shaft to the switch, and back inside. The device keeps the zero until
    its next reset, a fault of the encoder, or the next homing: that forgets it first, so that one that fails leaves
    none. Nothing is recorded: --out is the folder of the panels that can stop it.
    """
    experiment = checked_bench(config_path, pace)
    from rig.running.experiment import zero

    encoder = experiment.sensor.encoder
    if encoder is None:
        fail("`rig home` is for an encoder, and this config has a potentiometer", "nothing to set")
    if experiment.sensor.servo is not None:
        fail(
            "a servo knows where it stands",
            "set sensor.servo.zero_counts to its reading at the centre of travel: `rig servo show`",
        )
    if experiment.limits.is_endless:
        fail(
            "without travel limits zero is where a command finds the shaft",
            "nothing to set: press the e-stop and release it, then `rig run`",
        )
    by_switch = encoder.home is not None
    if by_switch and (here or at_rad):
        fail(
            "--here and --at-rad set zero by hand, and sensor.encoder.home names an end switch",
            "leave them out, or the section `home`",
        )
    soft_low, soft_high = experiment.limits.soft_rad
    if not soft_low <= at_rad <= soft_high:
        fail(
            f"--at-rad {at_rad:g} is outside limits.soft_rad",
            f"turn the shaft to a position within {soft_low:g} to {soft_high:g} rad",
        )
    if not by_switch and not here:
        zero.forget(experiment)
        click.prompt(
            f"the motor's supply is off, and the shaft stands at {at_rad:g} rad: press Enter",
            default="",
            show_default=False,
            prompt_suffix=" ",
            err=True,
        )
    found = zero.by_switch(experiment, out) if by_switch else zero.by_hand(experiment, at_rad)
    if asks_json():
        say_json({"y_rad": found.y_rad, "y_counts": found.y_counts, "from_counts": found.from_counts})
        return
    click.echo(
        f"zero is set: the shaft stands at {found.y_rad:+.4f} rad, {found.y_counts} counts ({found.from_counts} before)"
    )
    click.echo("the device keeps it until its next reset, or a fault of the encoder; `rig run` can start")
