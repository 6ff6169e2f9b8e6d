"""`rig emulate`: run an emulated device."""

from __future__ import annotations

import time
from pathlib import Path
from shlex import quote

import click

from rig.cli.driving import checked, say_chip_starts
from rig.cli.shared import CONFIG, PATH, fail


@click.command()
@CONFIG
@click.option("--link", type=PATH, help="Make a symbolic link to the port with this name.")
@click.option("--trace", type=PATH, help="Write the drive at the pin over time to this CSV file.")
@click.option("--chip", is_flag=True, help="Emulate the Uno's chip, and run its firmware on it at daq.baud.")
def emulate(config_path: Path, link: Path | None, trace: Path | None, chip: bool) -> None:
    """Run the emulated device of a config until Ctrl-C."""
    from rig.backends.registry import backend_of, emulated_board

    experiment = checked(config_path, drives=False)
    d = experiment.device
    if d.emulated is None:
        fail(
            f"{config_path} has no section `emulated`",
            f"try the whole experiment on a motor made up for it: `rig rehearse {quote(str(config_path))}`; or add the "
            "section, as in config/demo.yaml",
        )
    backend = backend_of(d)
    if chip and not backend.has_chip:
        fail("--chip emulates the Uno, which does not speak Modbus", "leave --chip out")
    from rig.control.loop.stop_request import stop_on_signals

    if chip:
        say_chip_starts("emulated-chip")
    with stop_on_signals() as stop, emulated_board(d, link, trace, chip=chip) as board:
        port = board.port
        click.echo(
            f"emulated device on {link or port}; set daq.port to that, and run rig in another terminal. Ctrl-C ends it."
        )
        if hint := backend.emulated_hint(d, str(link or port)):
            click.echo(hint)
        while stop.reason is None:
            board.check()
            time.sleep(0.1)
