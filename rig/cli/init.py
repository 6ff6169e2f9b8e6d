"""`rig init`: write the first config of a bench, from a few answers."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NoReturn

import click

from rig.cli.shared import EXIT_FAILED, FILE, fail, fail_config, written
from rig.config import ConfigError, new_bench
from rig.config.bridges import BRIDGES, RUNS_FREE
from rig.config.edit import with_values
from rig.config.load import load

VALUES = {"--bridge": "NAME", "--no-load-rpm": "RPM", "--counts-per-turn": "COUNTS"}  # of what has no default
_SERVO: Final = "servo"


@click.command()
@click.argument("file", type=FILE, default=Path("bench.yaml"))
@click.option("--board", type=click.Choice([*new_bench.BOARDS, _SERVO]), help="The board; a servo: --servo MODEL.")
@click.option("--sensor", type=click.Choice(list(new_bench.SENSORS)), help="The position sensor.")
@click.option(
    "--bridge", type=click.Choice([*BRIDGES, *RUNS_FREE]),
    help="The bridge, as it is sold, or by its inputs.",
)  # fmt: skip
@click.option(
    "--limits", type=click.Choice(list(new_bench.LIMITS)), help="What bounds the shaft's travel. Default: stops."
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
@click.option(
    "--counts-per-turn", type=int, help="Of an encoder's own shaft, all four edges counted: four times its PPR."
)
@click.option("--gear", type=float, help="Turns of the encoder for one of the measured shaft. Default: 1.")
@click.option("--turns", type=float, help="With --limits turns: so many either way. Default: 10.")
@click.option(
    "--tests", type=click.Choice(list(new_bench.TESTS)),
    help="full: the whole experiment, with limit cycles. quick: tests that end when the motor is known (relay.until). "
    "Default: full.",
)  # fmt: skip
@click.option("--servo", metavar="MODEL", help="A smart servo, such as xl330-m288 or sts3215; then no other board.")
@click.option("--servo-id", type=click.IntRange(0, 252), default=1, show_default=True, help="Its id on its bus.")
@click.option("--yes", is_flag=True, help="Ask nothing: take the default of what is not given.")
def init(
    file: Path,
    servo: str | None,
    servo_id: int,
    board: str | None,
    sensor: str | None,
    bridge: str | None,
    limits: str | None,
    port: str | None,
    supply_V: float | None,
    travel_deg: float | None,
    no_load_rpm: float | None,
    counts_per_turn: int | None,
    gear: float | None,
    turns: float | None,
    tests: str | None,
    yes: bool,
) -> None:
    """Write a config with comments for your bench.

    To FILE, bench.yaml by default. Asks for what is not given as an option. The config passes `rig check`; its other
    numbers are examples, and its comments say how to measure each. It never replaces a file.

    With --servo it reads the servo at --port; without a port the config is of an emulated one.
    """
    if servo is not None:
        _refuse_beside_servo(
            {"--board": board, "--sensor": sensor, "--bridge": bridge, "--limits": limits, "--turns": turns,
             "--travel-deg": travel_deg, "--counts-per-turn": counts_per_turn, "--gear": gear, "--tests": tests}
        )  # fmt: skip
        _init_servo(file, servo, port, servo_id, supply_V, no_load_rpm)
        return
    if board == _SERVO:
        _ask_which_servo()
    from rig.backends.links.usb_port import usb_port
    from rig.backends.serial.flashing import board_of
    from rig.running import preflight
    from rig.running.preflight.breakaway_strokes import fitting_max_V
    from rig.running.preflight.rehearsal import FRICTION_SHARE, swings_in_reach
    from rig.running.preflight.room_to_stop import longest_watchdog_s

    asks = not yes
    if yes:
        board, sensor, limits = board or "uno", sensor or "potentiometer", limits or "stops"
    needed = {"--bridge": bridge, "--no-load-rpm": no_load_rpm}
    if sensor == "encoder":
        needed["--counts-per-turn"] = counts_per_turn
    missing = [option for option, value in needed.items() if value is None]
    wanted = [board, sensor, port, supply_V, *needed.values(), turns if limits == "turns" else travel_deg]
    if sensor == "encoder":
        wanted += [limits, gear]
    if asks and not sys.stdin.isatty() and None in wanted:
        needs = " ".join(["--yes", *(f"{option} {VALUES[option]}" for option in missing)])
        fail("there is nobody to ask", f"give {needs}; `rig init --help`")
    asks = asks and sys.stdin.isatty()
    if file.exists():
        fail(f"{file} is there already", "name another file: rig init FILE")
    if yes and missing:
        have = "has" if len(missing) == 1 else "have"
        fail(
            f"{', '.join(missing)} {have} no default: a wrong one is dangerous",
            f"give {'it' if len(missing) == 1 else 'them'}; `rig init --help`",
        )
    told: dict[str, str | float] = {}
    try:
        boards = {name: one.words for name, one in new_bench.BOARDS.items()}
        board = _chosen("board", board, boards | {_SERVO: "smart servo, Dynamixel X or Feetech STS: needs no board"})
        if board == _SERVO:
            _ask_which_servo()
        sensor = _chosen("sensor", sensor, new_bench.SENSORS)
        bridges = {name: one.words for name, one in BRIDGES.items()} | RUNS_FREE
        bridge = _chosen("bridge", bridge, bridges)
        new_bench.require_braking(bridge)
        is_encoder = sensor == "encoder"
        _refuse_unused(
            {} if is_encoder else {"--counts-per-turn": counts_per_turn, "--gear": gear}, "--sensor encoder", sensor
        )
        limits = _chosen("limits", limits, new_bench.LIMITS) if is_encoder else limits or "stops"
        _refuse_unused({} if limits == "turns" else {"--turns": turns}, "--limits turns", limits)
        port = port or _asked("port of the board", _port(board), asks)
        told |= {"board": board, "sensor": sensor, "bridge": bridge, "limits": limits, "port": port}
        counts = counts_per_turn if is_encoder else 64
        wanted_numbers = (  # name, in words, as given, default, and whether it means anything here
            ("supply_V", "motor supply, V", supply_V, 12.0, True),
            ("counts_per_turn", "counts for a turn of the encoder's own shaft (4 x PPR)", counts, None, True),
            ("gear", "turns of the encoder for one of the measured shaft", gear, 1.0, is_encoder),
            ("travel_deg", "free travel from the centre to a stop, on each side, degrees", travel_deg, 103.0,
             limits == "stops"),
            ("turns", "turns either way, at most", turns, 10.0, limits == "turns"),
            ("no_load_rpm", "speed of the measured shaft without load, at that supply, rpm", no_load_rpm, None, True),
        )  # fmt: skip
        possible = partial(new_bench.possible, board, sensor, bridge, limits)
        numbers = {
            name: _number(possible, name, words, given, default, asks and counts_here)
            for name, words, given, default, counts_here in wanted_numbers
        }
        numbers["counts_per_turn"] = int(numbers["counts_per_turn"])
        told |= numbers
        told["tests"] = tests = tests or (_chosen("tests", None, new_bench.TESTS, "full") if asks else "full")
        number_on_usb = usb_port(port).serial_number
        answers = new_bench.Answers(
            board, sensor, bridge, port, limits=limits, counts_per_turn=int(numbers.pop("counts_per_turn")), **numbers,
            usb_serial=number_on_usb or "", tests=tests,
        )  # fmt: skip
        text = new_bench.text(answers, str(file))
    except new_bench.AnswerError as error:
        again = (
            f"\n     your answers are not lost, change the wrong one here:\n     {_command(file, told)}"
            if asks and told
            else ""
        )
        fail(error.cause, error.cure + again)
    try:
        with written(file):
            with file.open("x", encoding="utf-8") as new:
                new.write(text)
            experiment = load(file)
            fitting = swings_in_reach(experiment)
            fitting["breakaway", "max_V"] = fitting_max_V(experiment, 2.0 * FRICTION_SHARE * experiment.drive.supply_V)
            if (longest_s := longest_watchdog_s(experiment)) is not None:
                fitting["daq", "watchdog_s"] = longest_s
            file.write_text(with_values(text, fitting), encoding="utf-8")
            experiment, _ = preflight.check(file)
    except ConfigError as error:
        fail_config(
            error,
            f"{file} is written, but `rig check` refuses it: correct these numbers. Is --no-load-rpm the speed of the "
            "measured shaft, behind its gear?",
        )
    click.echo(f"{file}: written; `rig check {shlex.quote(str(file))}` accepts it")
    if number_on_usb is None:
        click.echo(_without_number(port))
    else:
        click.echo(f"this config is for the board with USB serial number {number_on_usb}, and for no other")
    click.echo(
        f"`rig rehearse {shlex.quote(str(file))}` drives a made-up motor on it: does all fit, before you wire it?"
    )
    pico = " --board pico" if board == "pico" and (is_encoder or board_of(experiment.device) != "pico") else ""
    click.echo(
        f"switch the motor's supply off, then type: rig flash {shlex.quote(str(file))}{pico}; add --supply and "
        "--end-switches if these are wired: the config does not say"
    )
    wiring = (
        "docs/pico.md has the wiring, docs/real-bench.md"
        if board == "pico"
        else "docs/real-bench.md has the wiring and"
    )
    click.echo(f"{wiring} the first steps")
    click.echo(f"then `rig calibrate {shlex.quote(str(file))}` measures most of what its comments ask for")


def _without_number(port: str) -> str:
    """Why no USB serial number is known, and what follows."""
    if not Path(port).exists():
        return f"no board is at {port} yet: `rig calibrate` will note its USB serial number"
    return f"the board at {port} has no serial number on USB: rig cannot tell another one there from this one"


def _ask_which_servo() -> NoReturn:
    fail("a servo's config needs its model", "type --servo MODEL, such as: rig init --servo xl330-m288")


def _refuse_beside_servo(given: dict[str, object]) -> None:
    named = [option for option, value in given.items() if value is not None]
    if named:
        fail(f"{' and '.join(named)} mean nothing with --servo", "leave them out")


def _init_servo(
    file: Path, name: str, port: str | None, id: int, supply_V: float | None, no_load_rpm: float | None
) -> None:
    """A servo's config: what its registers tell is read where it has a port."""
    from rig.backends.links.usb_port import is_usb_name, usb_port
    from rig.backends.servo import first_config
    from rig.backends.servo.scan import USUAL_BAUDS, scan
    from rig.cli.servo import opened
    from rig.running import preflight

    if file.exists():
        fail(f"{file} is there already", "name another file: rig init FILE")
    try:
        answers = first_config.ServoAnswers(
            first_config.model_named(name, is_read=port is not None),
            port,
            id=id,
            supply_V=supply_V,
            no_load_rpm=no_load_rpm,
        )
        if port is not None:
            seen = next(scan(lambda baud: opened(port, baud), USUAL_BAUDS, (id,)), None)
            if seen is None or seen.model is None:
                fail(
                    f"no servo {id} that rig knows answers at {port}",
                    "`rig servo scan` looks for all ids",
                    status=EXIT_FAILED,
                )
            if not seen.model.name.startswith(name):
                fail(f"servo {id} is {seen.model.name}, not {name}", f"--servo {seen.model.name}")
            for words in seen.objections:
                click.echo(f"a run would be refused: {words}")
            adapter = usb_port(port).adapter if is_usb_name(port) else "none"
            answers = replace(
                answers,
                model=seen.model,
                adapter="ftdi-1ms" if adapter == "ftdi" else adapter,
                baud=seen.baud,
                supply_V=round(seen.supply_V, 1) if supply_V is None else supply_V,
                zero_counts=seen.position % seen.model.counts_per_turn,
            )
        text = first_config.text(answers)  # first: what it refuses leaves no file
        with written(file), file.open("x", encoding="utf-8") as new:
            new.write(text)
        preflight.check(file)
    except ConfigError as error:
        fail_config(error, f"{file} is written, but `rig check` refuses it: correct these numbers")
    click.echo(f"{file}: written; `rig check {shlex.quote(str(file))}` accepts it")
    if answers.adapter == "ftdi-1ms":
        click.echo("the adapter's latency timer must be at 1 ms: `rig doctor` says how")
    if port is None:
        click.echo("the servo in it is emulated, nothing moves; for yours give --port, such as --port /dev/ttyUSB0")
    where = "where its shaft stands now" if port is not None else "the middle of its turn"
    click.echo(
        f"zero is {where} (sensor.servo.zero_counts); take everything off the horn, then "
        f"`rig run {shlex.quote(str(file))}`"
    )


def _command(file: Path, told: dict[str, str | float]) -> str:
    """The command that gives these answers, without those that mean nothing beside the others."""
    unused = {"travel_deg"} if told["limits"] != "stops" else set()
    unused |= {"turns"} if told["limits"] != "turns" else set()
    unused |= {"counts_per_turn", "gear"} if told["sensor"] != "encoder" else set()
    options = [f"--{name.replace('_', '-')} {shlex.quote(f'{told[name]}')}" for name in told if name not in unused]
    return " ".join(["rig init", shlex.quote(str(file)), *options])


def _refuse_unused(given: dict[str, float | None], belongs: str, chosen: str) -> None:
    """Refuse options that were given, but mean nothing with what was chosen: the answers contradict each other."""
    for option, value in given.items():
        if value is not None:
            raise new_bench.AnswerError(
                f"{option} belongs to {belongs}, not to {chosen}", f"give {belongs}, or leave {option} out"
            )


def _chosen(what: str, given: str | None, words: dict[str, str], default: str | None = None) -> str:
    """A key of ``words``: as given, or as answered; ``default``, if any, for an empty answer."""
    if given is not None:
        return given
    width = max(map(len, words))
    click.echo(f"{what}:")
    for name, meaning in words.items():
        click.echo(f"  {name:{width}}  {meaning}")
    return str(_answer(what, default, click.Choice(list(words))))


def _answer(what: str, default: float | str | None, kind: click.ParamType[Any]) -> Any:
    """As answered; an empty answer is the default, and where there is none it is said so."""

    def converted(answer: Any) -> Any:
        if answer == "":
            raise click.UsageError("this has no default: type what your bench has")
        return kind.convert(answer, None, None)

    return click.prompt(
        what, "" if default is None else default, value_proc=converted, show_default=default is not None
    )


def _asked(what: str, default: str, asks: bool) -> str:
    return str(click.prompt(what, default=default)) if asks else default


def _number(
    possible: Callable[[str], new_bench.Answers],
    name: str,
    what: str,
    given: float | None,
    default: float | None,
    asks: bool,
) -> float:
    """As given; the default where nobody is asked; else as answered: an answer that cannot be is asked for again.

    possible  answers among which any number of this name is possible
    default   None: there is none, and without an answer it was given
    """
    if given is not None:
        return given
    if not asks and default is not None:
        return default
    trial = possible(name)
    while True:
        answer = _answer(what, default, click.INT if isinstance(getattr(trial, name), int) else click.FLOAT)
        try:
            replace(trial, **{name: answer})
        except new_bench.AnswerError as error:
            click.echo(f"Error: {error.cause}: {error.cure}.")
        else:
            return float(answer)


def _port(board: str) -> str:
    """The board that is plugged in, or the name that it usually gets."""
    from rig.backends.serial.flash import FlashError, only_candidate, serial_ports

    if board == "pico":
        return "/dev/ttyUSB0"  # of its adapter
    try:
        return only_candidate(serial_ports()).device
    except FlashError:
        return "/dev/ttyACM0"
