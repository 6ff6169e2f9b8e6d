"""`rig rehearse`: the whole experiment of a config on an emulated device, with a motor made from its data sheet."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import click

from rig import config
from rig.cli.driving import finish, perform
from rig.cli.shared import CONFIG, JSON, OUT, PACE, asks_json
from rig.running import preflight


@click.command()
@CONFIG
@click.option("--no-load-rpm", type=float, help="Speed of the motor's own shaft without load; needs --gear.")
@click.option(
    "--rated-V", "rated_V", type=float, help="Supply that this speed is given for, V. Default: drive.supply_V."
)
@click.option("--gear", type=float, help="Turns of the motor for one of the measured shaft; 1: there is no gear.")
@click.option(
    "--friction-V", "friction_V", type=float,
    help="Coulomb friction, V: supply times no-load current over stall current. Default: 5 % of the supply.",
)  # fmt: skip
@click.option(
    "--tau-s", type=float, help="Time constant with the load, s. Default: half of limits.coast_tau_s.",
)  # fmt: skip
@click.option(
    "--coasting", is_flag=True,
    help="The bridge lets the motor run free while PWM is low, as an L298 with PWM at its enable (docs/real-bench.md).",
)  # fmt: skip
@OUT
@PACE
@JSON
def rehearse(config_path: Path, out: Path, pace: float | None, **sheet: Any) -> None:
    """Run the whole experiment of a bench on an emulated motor.

    The checks, the experiment and the report are those of `rig run`; the device is emulated, in virtual time. The
    motor is made from the data sheet: from these options, else from motor.no_load_speed_rad_s and drive.supply_V. A
    config with a section `emulated` has a motor already; options change it. Every result says that it is a rehearsal.
    """
    given = preflight.DataSheet(**sheet | {"coasting": sheet["coasting"] or None})
    document = config.read(config_path, takes_pipe=True)
    experiment = preflight.rehearsed(document, given, pace)
    if not asks_json():
        _show_motor(experiment)
    from rig.running.experiment import script

    finish(perform(partial(script.run, experiment, out), verbose=False))


def _show_motor(e: config.Experiment) -> None:
    """The motor that is behind the emulated device."""
    assert e.emulated is not None
    motor = e.emulated.motor
    click.echo(
        f"rehearsal with a motor of tau {motor.tau_s:g} s, K {motor.K_rad_s_V:g} (rad/s)/V, f_c "
        f"{0.5 * (motor.fc_plus_V + motor.fc_minus_V):.3g} V"
    )
