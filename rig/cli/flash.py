"""`rig flash`: write the firmware to an Arduino Uno."""

from __future__ import annotations

import shlex
from functools import partial
from pathlib import Path

import click

from rig.cli.failure import EXIT_BAD_INPUT, fail, faults


@click.command()
@click.option("--port", default=None, help="Serial port. Default: the Uno or clone, if just one is plugged in.")
@click.option(
    "--baud", type=click.Choice(["115200", "1000000"]), default="115200", show_default=True,
    help="Baud rate of the firmware; the config's daq.baud must be the same.",
)  # fmt: skip
@click.option(
    "--bridge", type=click.Choice(["pwm-dir", "in1-in2"]), default="pwm-dir", show_default=True,
    help="Kind of inputs that the H-bridge has (docs/real-bench.md).",
)  # fmt: skip
@click.option("--tachometer", is_flag=True, help="A tachometer is wired to A1.")
@click.option("--supply", is_flag=True, help="The motor supply is wired to A2, through a divider by 4.")
@click.option("--end-switches", is_flag=True, help="End switches are wired to D5 and D6.")
@click.option(
    "--hex", "hex_file", type=click.Path(path_type=Path, exists=True, dir_okay=False), default=None,
    help="Write this file. Default: the one that came with rig for the options above; without one it is built here.",
)  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Print the command; touch no board.")
def flash(
    port: str | None,
    baud: str,
    bridge: str,
    tachometer: bool,
    supply: bool,
    end_switches: bool,
    hex_file: Path | None,
    dry_run: bool,
) -> None:
    """Write the firmware to an Arduino Uno.

    rig's wheel carries it, for any of these options; in the repository it is built. avrdude writes it; then rig asks
    the board which firmware it runs.

    Switch off the motor's supply first: while a board is written, its pins float.
    """
    from rig.backends.serial import flash as uno
    from rig.backends.serial.emulated.firmware_build import UnoOptions, build_uno

    options = UnoOptions(bridge.upper().replace("-", "_"), int(baud), tachometer, supply, end_switches)
    if hex_file is not None and options != UnoOptions(baud=int(baud)):
        fail(
            EXIT_BAD_INPUT,
            "with --hex only --baud has an effect: the file is built already",
            "leave out the other options, or --hex",
        )
    try:
        with faults():
            avrdude = uno.find_avrdude()
            if avrdude is None and not dry_run:
                raise uno.no_avrdude()
            if port is None:
                try:
                    found = uno.only_candidate(uno.serial_ports())
                except uno.FlashError as none:
                    if not dry_run:
                        raise
                    click.echo(f"{none.cause}: PORT stands for its port")
                    port = "PORT"
                else:
                    click.echo(f"found: {found}")
                    port = found.device
            shipped = None if hex_file is not None else uno.prebuilt(options.name)
            if shipped is not None:
                click.echo(str(shipped))
                if uno.REAL_CHIP_REPORT is None:
                    click.echo(uno.NEVER_RUN)
            file = hex_file or (build_uno(options) if shipped is None else shipped.path)
            command = uno.avrdude_command(avrdude or "avrdude", port, file)
            if dry_run:
                click.echo(f"would run: {shlex.join(command)}")
                if avrdude is None:
                    click.echo(f"avrdude is missing here. {uno.no_avrdude().cure}")
                return
            uno.check_port(port)
            click.echo(f"running: {shlex.join(command)}")
            uno.write(command, port, partial(click.echo, nl=False, err=True))
            click.echo("written; waiting for the board to answer ...")
            hello = uno.meet(port, int(baud))
            click.echo(f"{port}: {uno.in_words(hello)}")
            if hex_file is None:
                uno.check_build(hello)
                click.echo(f"before you switch on the motor's supply: {uno.AT_REST[bridge]}")
    except uno.FlashError as error:
        fail(error.status, error.cause, error.cure)
