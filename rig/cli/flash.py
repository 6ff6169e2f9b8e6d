"""`rig flash`: write the firmware to an Arduino Uno or a Raspberry Pi Pico."""

from __future__ import annotations

import os
import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rig.cli.shared import PATH, fail

if TYPE_CHECKING:  # it loads slowly
    from rig.backends.serial.emulated.firmware_build import Variant

_Options = dict[str, str | int | bool | None]


def _inputs_of(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    """The kind of inputs of the bridge that is named, by its inputs or as it is sold."""
    from rig.config.bridges import BRIDGES
    from rig.config.new_bench import AnswerError, require_braking

    if value is None or value in BRIDGES:
        return None if value is None else BRIDGES[value].inputs
    try:
        require_braking(value)
    except AnswerError as error:
        raise click.BadParameter(f"{error.cause}; {error.cure}", context, parameter) from error
    raise click.BadParameter(f"{value!r} is not one of {', '.join(BRIDGES)}", context, parameter)


@click.command()
@click.argument("config_path", metavar="[CONFIG]", required=False, type=PATH)
@click.option(
    "--board", type=click.Choice(["uno", "pico"]),
    help="Arduino Uno, or Raspberry Pi Pico. Default: as CONFIG's converter tells, else the Uno.",
)  # fmt: skip
@click.option(
    "--port",
    help="Serial port. Default: that of CONFIG, else the Uno or clone, if just one is plugged in. A Pico is only asked "
    "there who it is.",
)  # fmt: skip
@click.option(
    "--usb-serial", metavar="NUMBER",
    help="Refuse another board than the one with this serial number on USB: daq.usb_serial of the config. Without "
    "--port: find it.",
)  # fmt: skip
@click.option(
    "--drive", type=PATH,
    help="Folder where the Pico's drive is mounted. Default: the only one there is.",
)  # fmt: skip
@click.option(
    "--baud", type=click.Choice(["115200", "1000000"]),
    help="Baud rate of the firmware; the config's daq.baud must be the same. Default: daq.baud of CONFIG, else 115200.",
)  # fmt: skip
@click.option(
    "--bridge", metavar="[pwm-dir|in1-in2|MODULE]", callback=_inputs_of,
    help="Kind of inputs that the H-bridge has (docs/real-bench.md), or a module as `rig init` knows it, such as "
    "l298n. Default: drive.bridge of CONFIG, else pwm-dir.",
)  # fmt: skip
@click.option("--tachometer", is_flag=True, help="A tachometer is wired to A1 (Pico: GP27).")
@click.option("--supply", is_flag=True, help="The motor supply is wired to A2 (Pico: GP28), through its divider.")
@click.option("--end-switches", is_flag=True, help="End switches are wired to D5 and D6 (Pico: GP12 and GP13).")
@click.option("--encoder", is_flag=True, help="An encoder is wired to D2 and D3 (Pico: GP2 and GP3).")
@click.option(
    "--hex", "hex_file", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Write this file to the Uno. Default: the one that came with rig for the options above; without one it is "
    "built here.",
)  # fmt: skip
@click.option(
    "--uf2", type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Write this file to the Pico. Default: as of --hex.",
)  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Print what would be done; touch no board.")
def flash(
    config_path: Path | None,
    drive: Path | None,
    supply: bool,
    hex_file: Path | None,
    uf2: Path | None,
    dry_run: bool,
    **may_be_in_config: str | bool | None,
) -> None:
    """Write the firmware to a board.

    With CONFIG, bridge, sensor, baud rate, tachometer, port and board are those of the config; an option that
    contradicts it is refused. Options are for who has no config, and for what a config does not say.

    rig's wheel carries it, for any of these options; in the repository it is built. To an Uno avrdude writes it; then
    rig asks the board which firmware it runs. To a Pico in BOOTSEL mode, which is a drive then, rig copies it; with
    --port it asks the Pico, too.

    Switch off the motor's supply first: while a board is written, its pins float.
    """
    from rig.backends.serial.emulated.firmware_build import Variant

    asked: _Options = {name: value or None for name, value in may_be_in_config.items()}
    asked["baud"] = None if asked["baud"] is None else int(asked["baud"])
    told = asked if config_path is None else _told(config_path, asked)
    board = str(told["board"] or "uno")
    port, usb_serial = (None if told[name] is None else str(told[name]) for name in ("port", "usb_serial"))
    options = Variant(
        str(told["bridge"] or "pwm-dir").upper().replace("-", "_"),
        int(told["baud"] or 115200),
        bool(told["tachometer"]),
        supply,
        bool(told["end_switches"]),
        bool(told["encoder"]),
    )
    given, name = (hex_file, "--hex") if board == "uno" else (uf2, "--uf2")
    _refuse_the_other_boards(board, hex_file, uf2, drive)
    if given is not None and (supply or any(asked[one] for one in ("bridge", "tachometer", "end_switches", "encoder"))):
        fail(
            f"with {name} only --baud has an effect: the file is built already",
            f"leave out the other options, or {name}",
        )
    port = _port_of(port, usb_serial)
    if board == "uno":
        _flash_uno(options, port, given, dry_run=dry_run)
    else:
        _flash_pico(options, port, given, drive, dry_run=dry_run)


def _told(config_path: Path, asked: _Options) -> _Options:
    """What the config says of its board, and beside it what was asked for and the config does not say.

    Exits with status 2 where the config cannot be read, is not for such a board, or says something else.
    """
    from rig.backends.registry import backend_of
    from rig.backends.serial.backend import SerialBackend
    from rig.backends.serial.flashing import WRONG_BRIDGE, of_config
    from rig.config import load

    try:
        experiment = load(config_path)
        if not isinstance(backend_of(experiment.device), SerialBackend):
            raise ValueError(f"its device, `driver: {experiment.daq.driver}`, runs no firmware of rig")
        told = of_config(experiment.device)
    except ValueError as error:
        fail(f"{config_path}: {error}", "without a config: rig flash --board ... --bridge ... --baud ...")
    for name, (key, value) in told.items():
        wanted = asked[name]
        if value is None or wanted is None or wanted == value:
            continue
        if name == "port" and os.path.realpath(str(wanted)) == os.path.realpath(str(value)):
            continue  # another name of it
        option = f"--{name.replace('_', '-')}" + ("" if wanted is True else f" {wanted}")
        says = (
            f"{config_path} has no section {key}"
            if value is False
            else f"{key} of {config_path} is {'that of the ' if name == 'board' else ''}{value}"
        )
        fail(f"{option}, but {says}", f"leave {option} out, or correct the config")
    merged = {name: told[name][1] if told[name][1] is not None else asked[name] for name in asked}
    if merged["bridge"] is None:
        fail(
            f"{config_path} does not name the bridge, and {WRONG_BRIDGE}",
            "add drive.bridge, pwm-dir or in1-in2 (docs/real-bench.md, Which bridge); or give --bridge",
        )
    return merged


def _port_of(port: str | None, usb_serial: str | None) -> str | None:
    """The port that is given, or the one with that number on USB. Raises Fault OTHER_BOARD, LINK_OPEN."""
    from rig.backends.links.usb_port import check_board, port_of
    from rig.core.faults import Fault

    if usb_serial is None:
        return port
    if port is None and not (port := port_of(usb_serial)):
        raise Fault("LINK_OPEN", f"no port of this machine has serial number {usb_serial} on USB")
    check_board(port, usb_serial, "--usb-serial")
    return port


def _refuse_the_other_boards(board: str, hex_file: Path | None, uf2: Path | None, drive: Path | None) -> None:
    """What is given for another board than the one named was meant for something."""
    if board == "pico" and hex_file is not None:
        fail("--hex is for the Uno", "give the Pico a .uf2: --uf2 FILE")
    if board == "uno" and (uf2 is not None or drive is not None):
        fail(f"--{'drive' if uf2 is None else 'uf2'} is for the Pico", "say so: --board pico")


def _flash_uno(options: Variant, port: str | None, hex_file: Path | None, *, dry_run: bool) -> None:
    from rig.backends.serial import flash as uno
    from rig.backends.serial.emulated.firmware_build import build_uno

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
    file = hex_file or _shipped("uno", f"{options.name}.hex") or build_uno(options)
    command = uno.avrdude_command(avrdude or "avrdude", port, file)
    if dry_run:
        click.echo(f"would run: {shlex.join(command)}")
        if avrdude is None:
            click.echo(f"avrdude is missing here. {uno.no_avrdude().cure}")
        return
    with uno.held(port) as holds:
        click.echo(f"running: {shlex.join(command)}")
        uno.write(command, port, partial(click.echo, nl=False, err=True), holds)
    _ask(port, options.baud, "uno" if hex_file is None else None)
    if hex_file is None:
        click.echo(f"before you switch on the motor's supply: {uno.AT_REST[_bridge(options)]}")


def _flash_pico(options: Variant, port: str | None, uf2: Path | None, drive: Path | None, *, dry_run: bool) -> None:
    from rig.backends.serial import flash_pico as pico
    from rig.backends.serial.emulated.firmware_build import build_pico
    from rig.backends.serial.flash import FlashError

    program = uf2 or _shipped("pico", f"{options.name_for('pico')}.uf2") or build_pico(options)
    try:
        folder = pico.find_drive(drive)
    except FlashError as none:
        if not dry_run:
            raise
        click.echo(f"{none.cause}: DRIVE stands for its folder. {none.cure}")
        folder = Path("DRIVE")
    if dry_run:
        click.echo(f"would copy: {program} to {folder}")
        return
    click.echo(f"copying {program} to {folder}")
    pico.copy(program, folder, click.echo)
    if port is None:
        click.echo(
            "written. To ask it who it is, give the port of its serial adapter: --port PORT; or `rig doctor CONFIG`"
        )
    else:
        _ask(port, options.baud, "pico" if uf2 is None else None)
    if uf2 is None:
        click.echo(f"before you switch on the motor's supply: {pico.AT_REST[_bridge(options)]}")


def _ask(port: str, baud: int, board: str | None) -> None:
    """Ask a board that was written who it is. Raises FlashError; ``board``: where it is to run this rig's firmware."""
    from rig.backends.serial.flash import check_build, in_words, meet

    click.echo("written; waiting for the board to answer ...")
    hello = meet(port, baud)
    click.echo(f"{port}: {in_words(hello)}")
    if board is not None:
        check_build(hello, board)


def _shipped(board: str, file: str) -> Path | None:
    """The file that came with rig, which is said; None where there is none."""
    from rig.backends.serial.flash import NEVER_RUN, REAL_CHIP_REPORTS, prebuilt

    found = prebuilt(file)
    if found is None:
        return None
    click.echo(str(found))
    if board not in REAL_CHIP_REPORTS:
        click.echo(NEVER_RUN)
    return found.path


def _bridge(options: Variant) -> str:
    return options.bridge.lower().replace("_", "-")
