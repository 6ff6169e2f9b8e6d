"""`rig init`: write the first config of a bench, from a few answers."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click

from rig.cli.failure import EXIT_BAD_INPUT, fail, fail_config
from rig.config import ConfigError, new_bench


@click.command()
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False), default=Path("bench.yaml"))
@click.option("--board", type=click.Choice(list(new_bench.BOARDS)), help="The board.")
@click.option("--sensor", type=click.Choice(list(new_bench.SENSORS)), help="The position sensor.")
@click.option(
    "--bridge", type=click.Choice(list(new_bench.BRIDGES)), help="The bridge, as it is sold, or by its inputs."
)
@click.option("--port", help="The board's serial port. Default: the board that is plugged in, or /dev/ttyACM0.")
@click.option("--supply-V", "supply_V", type=float, help="The motor supply, V. Default: 12.")
@click.option(
    "--travel-deg", type=float,
    help="How far the shaft may turn from its centre to each side before it meets a stop, degrees. Default: 103.",
)  # fmt: skip
@click.option(
    "--no-load-rpm", type=float,
    help="Speed of the measured shaft without load at that supply, revolutions a minute: motor speed over gear ratio, "
    "rather too high than too low.",
)  # fmt: skip
@click.option("--yes", is_flag=True, help="Ask nothing: take the default of what is not given.")
def init(
    file: Path,
    board: str | None,
    sensor: str | None,
    bridge: str | None,
    port: str | None,
    supply_V: float | None,
    travel_deg: float | None,
    no_load_rpm: float | None,
    yes: bool,
) -> None:
    """Write a commented config for your bench to FILE, bench.yaml by default.

    Asks for what is not given as an option. The config passes `rig check`; its other numbers are examples, and its
    comments say how to measure each. It never replaces a file.
    """
    from rig import preflight
    from rig.backends.serial.flashing import flash_line

    asks = not yes
    if asks and not sys.stdin.isatty() and None in (bridge, supply_V, travel_deg, no_load_rpm):
        fail(EXIT_BAD_INPUT, "there is nobody to ask", "give --yes, and what has no default: --bridge, --no-load-rpm")
    if file.exists():
        fail(EXIT_BAD_INPUT, f"{file} is there already", "name another file: rig init FILE")
    for option, value in (("--bridge", bridge), ("--no-load-rpm", no_load_rpm)):
        if value is None and not asks:
            fail(EXIT_BAD_INPUT, f"{option} has no default: a wrong one is dangerous", "give it; `rig init --help`")
    try:
        answers = new_bench.Answers(
            board=_chosen("board", board, new_bench.BOARDS, asks),
            sensor=_chosen("sensor", sensor, new_bench.SENSORS, asks),
            bridge=_chosen("bridge", bridge, {name: one.words for name, one in new_bench.BRIDGES.items()}, asks),
            port=port or _asked("port of the board", _port(), asks),
            supply_V=supply_V or _number("motor supply, V", 12.0, asks),
            travel_deg=travel_deg
            or _number("free travel from the centre to a stop, on each side, degrees", 103.0, asks),
            no_load_rpm=no_load_rpm
            or click.prompt("speed of the measured shaft without load, at that supply, rpm", type=float),
        )
        text = new_bench.text(answers, str(file))
    except new_bench.AnswerError as error:
        fail(EXIT_BAD_INPUT, error.cause, error.cure)
    try:
        with file.open("x", encoding="utf-8") as new:
            new.write(text)
        experiment, _ = preflight.check(file)
    except OSError as error:
        fail(EXIT_BAD_INPUT, f"{file}: cannot be written: {error.strerror}", "name a file in an existing folder")
    except ConfigError as error:
        fail_config(error, f"{file} is written, but `rig check` refuses it: correct these numbers")
    click.echo(f"{file}: written; `rig check {shlex.quote(str(file))}` accepts it")
    click.echo(flash_line(experiment))
    click.echo("docs/real-bench.md has the wiring and the first steps")
    click.echo(f"then `rig calibrate {shlex.quote(str(file))}` measures most of what its comments ask for")


def _chosen(what: str, given: str | None, words: dict[str, str], asks: bool) -> str:
    """A key of ``words``: as given; the only one; or as answered."""
    if given is not None or len(words) == 1:
        return given or next(iter(words))
    assert asks
    width = max(map(len, words))
    click.echo(f"{what}:")
    for name, meaning in words.items():
        click.echo(f"  {name:{width}}  {meaning}")
    return str(click.prompt(f"{what}", type=click.Choice(list(words)), show_choices=False))


def _asked(what: str, default: str, asks: bool) -> str:
    return str(click.prompt(what, default=default)) if asks else default


def _number(what: str, default: float, asks: bool) -> float:
    return float(click.prompt(what, default=default, type=float)) if asks else default


def _port() -> str:
    """The board that is plugged in, or the name that an Uno usually gets."""
    from rig.backends.serial.flash import FlashError, only_candidate, serial_ports

    try:
        return only_candidate(serial_ports()).device
    except FlashError:
        return "/dev/ttyACM0"
