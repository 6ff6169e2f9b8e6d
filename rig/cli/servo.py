"""`rig servo`: smart servos on a bus, before they have a config."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rig.cli.shared import FILE, JSON, OUT, asks_json, ended_in_words, fail, require_new, say_json, written
from rig.cli.terminal import patience
from rig.core.faults import Fault
from rig.run_folder.recording.folder import json_text

if TYPE_CHECKING:  # pyserial comes with it
    from rig.backends.links.serial_port import SerialPort
    from rig.backends.servo.guardian import Guardian
    from rig.backends.servo.scan import Seen
    from rig.run_folder.live.stop_flag import StopFlag

_SILENCE_S = 0.2  # after which the keeper stops a horn that turns
_BAUDS = click.IntRange(9600, 4_500_000)  # that any servo has
_BAUD = click.option("--baud", type=_BAUDS, default=1_000_000, show_default=True, help="Of the bus.")
_YES = click.option("--yes", is_flag=True, help="Do not ask.")
_PORT = click.argument("port")
_ID = click.argument("id", type=click.IntRange(0, 252))


@click.group()
def servo() -> None:
    """Find, show and set smart servos on a bus.

    Dynamixel with protocol 2, and Feetech STS. None has been driven with rig yet: docs/servo.md.
    """


@servo.command()
@click.argument("port", required=False)
@click.option("--baud", "bauds", type=_BAUDS, multiple=True, help="Of the bus; default: 1000000, 57600, 115200.")
@JSON
def scan(port: str | None, bauds: tuple[int, ...]) -> None:
    """Show who is on a bus, and what a run would refuse. It changes nothing.

    Without PORT, each serial port on USB.
    """
    from rig.backends.servo.scan import USUAL_BAUDS, scan

    asked, found = bauds or USUAL_BAUDS, list[dict[str, object]]()
    for name in [port] if port is not None else _ports():
        for baud in asked:
            with patience(f"{name}: {baud} baud, asks each id, in both protocols"):
                there = list(scan(lambda baud, name=name: opened(name, baud), (baud,)))  # type: ignore[misc]
            for seen in there:
                found.append({"port": name, **_told(seen)})
                if not asks_json():
                    _say(name, seen)
    if asks_json():
        say_json({"servos": found})
    elif not found:
        at = ", ".join(map(str, asked))
        click.echo(f"no servo answers at {at} baud: check its supply, the wires and the port, or name another --baud")


@servo.command()
@_PORT
@_ID
@_BAUD
@JSON
def show(port: str, id: int, baud: int) -> None:
    """Show every register of a servo. It changes nothing."""
    from rig.backends.servo.scan import all_registers, known_servo

    with opened(port, baud) as line:
        link = known_servo(line, id, baud)
        rows = list(all_registers(link))
    if asks_json():
        say_json({"model": link.model.name, "registers": {name: value for name, _, value, _ in rows}})
        return
    click.echo(f"{link.model.name}, id {id}")
    for name, address, value, words in rows:
        click.echo(f"{address:4} {name:24} {value:8}  {words}")


@servo.command()
@_PORT
@_ID
@_BAUD
@_YES
def reboot(port: str, id: int, baud: int, yes: bool) -> None:
    """Start a servo anew, after an error of its hardware. Its torque goes off: what it holds falls."""
    from rig.backends.servo.scan import known_servo
    from rig.backends.servo.scan import reboot as start_anew

    with opened(port, baud) as line:
        link = known_servo(line, id, baud)
        _ask(f"reboot {link.model.name}, id {id}? Its torque goes off", yes=yes)
        start_anew(link)
    click.echo(f"servo {id} answers again")


@servo.command("baud")
@_PORT
@_ID
@click.argument("to", type=int)
@_BAUD
@_YES
def set_baud(port: str, id: int, to: int, baud: int, yes: bool) -> None:
    """Have a servo speak at another baud, TO, for good. --baud is what it speaks at now."""
    from rig.backends.servo.before import store_of
    from rig.backends.servo.scan import known_servo
    from rig.backends.servo.scan import set_baud as change

    store = store_of(port, id)
    with opened(port, baud) as line:
        link = known_servo(line, id, baud)
        _ask(f"set {link.model.name}, id {id}, from {baud} to {to} baud? Other programs must know", yes=yes)
        change(lambda at: _reopened(line, port, at), link, to, store)
    click.echo(f"servo {id} speaks at {to} baud")


@servo.command()
@_PORT
@_ID
@_BAUD
def restore(port: str, id: int, baud: int) -> None:
    """Put back the registers that a run has left changed. The next run does that by itself."""
    from rig.backends.servo.before import store_of
    from rig.backends.servo.scan import known_servo
    from rig.backends.servo.scan import restore as put_right

    store = store_of(port, id)
    with opened(port, baud) as line:
        values = put_right(known_servo(line, id, baud), store)
    if values is None:
        click.echo(f"nothing to put back: there is no {store.path}")
    elif not values:
        click.echo(f"nothing was written: no register holds what the run set; its values are in {store.aside_path}")
    else:
        click.echo(f"put back: {', '.join(f'{name} {value}' for name, value in values.items())}")


@servo.command()
@_PORT
@_ID
@_BAUD
@click.option("--to", type=FILE, help="File to write. Default: facts-MODEL.json.")
@OUT
@_YES
def facts(port: str, id: int, baud: int, to: Path | None, out: Path, yes: bool) -> None:
    """Try on a servo what no manual says, and write one file to send in.

    Take everything off the horn: it turns, slowly. Of a Feetech it asks you to cut the supply once; not with --yes.
    No run folder is made: --out is the folder of the panels that can stop it.
    """
    from rig.backends.servo.before import store_of
    from rig.backends.servo.facts import facts as tried
    from rig.backends.servo.keeper import starter
    from rig.backends.servo.scan import known_servo
    from rig.run_folder.live.running import told

    def powered() -> None:
        click.prompt(
            "cut the servo's supply for a second, switch it on, wait a second, then press Enter",
            default="", show_default=False, prompt_suffix=" ",
        )  # fmt: skip

    with opened(port, baud) as line:
        link = known_servo(line, id, baud)
        file = to or Path(f"facts-{link.model.name}.json")
        require_new(file, (".json",))
        _ask(f"{link.model.name}, id {id}: is its horn free? It will turn", yes=yes)
        found = []
        watched = starter(line.descriptor, _SILENCE_S)
        with told(out, "servo") as flag, ended_in_words(
            "no file is written", "rig, or its keeper, has put the servo's registers back; else the next run does"
        ):  # fmt: skip
            flag.tell_drive(is_on=True)
            trying = tried(
                link, store_of(port, id), None if yes else powered, lambda *of: _Stoppable(watched(*of), flag)
            )
            try:
                with closing(trying):  # the registers are put back while the port is open, whatever happens here
                    for fact in trying:
                        click.echo(fact.words)
                        found.append(fact)
            except Fault as fault:
                if fault.code == "INTERRUPTED":  # else nobody knows
                    flag.tell_drive(is_on=False)
                raise
            except click.Abort:  # the last question; a pipe, or Ctrl-C
                click.echo("\nthe supply was not cut: what that would show is left out")
            flag.tell_drive(is_on=False)
        firmware = link.value(link.model.roles["firmware"])
    text = json_text({"model": link.model.name, "firmware": firmware} | {fact.name: fact.found for fact in found})
    with written(file):
        try:
            file.write_text(text, encoding="utf-8")
        except OSError:
            click.echo(text)  # nobody has to turn the servo again
            raise
    click.echo(f"{file}: written; send it in (docs/driven.md)")


class _Stoppable:
    """A servo's keeper, as of ``Guardian``; a beat raises Fault INTERRUPTED once somebody has asked for a stop."""

    def __init__(self, keeper: Guardian, flag: StopFlag) -> None:
        self._keeper, self._flag = keeper, flag
        self.waits, self.rest, self.end = keeper.waits, keeper.rest, keeper.end

    @property
    def has_acted(self) -> bool:
        return self._keeper.has_acted

    def beat(self) -> None:
        self._flag.check()
        self._keeper.beat()


def _ask(question: str, *, yes: bool) -> None:
    try:
        agreed = yes or click.confirm(question)
    except click.Abort:  # nobody is there: a pipe, or Ctrl-C
        click.echo()
        fail("nobody answered; nothing was changed", "answer y at a terminal; in a pipe say `--yes`")
    if not agreed:
        fail("nothing was changed")


@contextmanager
def opened(port: str, baud: int) -> Iterator[SerialPort]:
    """A serial port at a baud in bits per second, for the block. Raises Fault LINK_OPEN."""
    from rig.backends.links.serial_port import SerialPort

    one = SerialPort(port, baud)
    try:
        yield one
    except Fault as fault:
        fault.fit("servo")
        if fault.code in ("LINK_TIMEOUT", "LINK_REPLY", "LINK_LOST"):  # there is no config to look into, and no run
            fault.cure = (
                "check the servo's supply, cable and adapter, and that nothing else talks on its bus; "
                f"`rig servo scan {shlex.quote(port)}` shows who answers, and at which --baud"
            )
        raise
    finally:
        one.close()


@contextmanager
def _reopened(before: SerialPort, port: str, baud: int) -> Iterator[SerialPort]:
    """The port at another baud, once the one before is closed."""
    before.close()
    with opened(port, baud) as one:
        yield one


def _ports() -> list[str]:
    from rig.backends.serial.flash import serial_ports

    ports = [one.device for one in serial_ports() if one.vid is not None]
    if not ports:
        fail("there is no serial port on USB", "plug the adapter in, or name its PORT")
    return ports


def _told(seen: Seen) -> dict[str, object]:
    return {
        "baud": seen.baud,
        "id": seen.id,
        "model": None if seen.model is None else seen.model.name,
        "model_number": seen.number,
        "firmware": seen.firmware,
        "mode": seen.mode,
        "supply_V": round(seen.supply_V, 1),
        "temperature_degC": seen.temperature_degC,
        "errors": seen.errors,
        "refused": list(seen.objections),
    }


def _say(port: str, seen: Seen) -> None:
    where = f"{Path(port).name}, {seen.baud} baud, id {seen.id}"
    if seen.model is None:
        click.echo(f"{where}: model number {seen.number}, which rig does not know; docs/servo.md says which it does")
        return
    click.echo(
        f"{where}: {seen.model.name}, firmware {seen.firmware}, mode {seen.mode}, {seen.supply_V:.1f} V, "
        f"{seen.temperature_degC} degC"
    )
    for words in seen.objections:
        click.echo(f"  refused: {words}")
