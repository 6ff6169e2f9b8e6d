"""What commands share that open a device: the checked config, the run with its progress, the end."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final, NoReturn

import click

from rig.backends.registry import backend_of
from rig.backends.serial.ports import CHIP_PORTS
from rig.cli.shared import EXIT_FAILED, asks_json, fail, say_json
from rig.cli.terminal import show_run
from rig.config import Experiment, read
from rig.core import person
from rig.core.faults import Fault
from rig.running import preflight

if TYPE_CHECKING:  # scipy comes with it
    from rig.config.schema import DeviceSetup
    from rig.running.session import OnStart, Outcome

_HAND_S: Final = 60.0  # longest wait for what a hand does


def checked(path: Path, pace: float | None = None, *, drives: bool = True, as_checked: str | None = None) -> Experiment:
    """The checked experiment of a config file. Exits with status 2 and the problems if the config is bad.

    pace    in place of loop.pace; None: as the config says
    drives  False: no motor turns, so the config need not name the bridge; `rig doctor` reads it from the firmware
    as_checked  as of ``checked_bench``
    """
    document = read(path, takes_pipe=True)
    if as_checked not in (None, document.digest):
        fail(f"{path} has changed since it was checked", "check it again")
    experiment, _ = preflight.check(document, () if drives else ("drive.bridge",), pace)
    return experiment


def checked_bench(path: Path, pace: float | None = None, as_checked: str | None = None) -> Experiment:
    """``checked`` for a command that drives a motor. No such port or chip: exits with status 1, before slow imports.

    Raises Fault as ``let_ask``.

    pace        seconds of virtual time in a second, as of ``checked``
    as_checked  digest of the file as somebody has confirmed it; another one exits with status 2; None: any
    """
    from rig.backends.links.device_file import require_device_file
    from rig.backends.serial.emulated.firmware_build import require_emulator

    experiment = checked(path, pace, as_checked=as_checked)
    require_device_file(experiment.daq.port)
    require_emulator(experiment.daq.port)
    say_chip_starts(experiment.daq.port)
    let_ask(experiment.device)
    return experiment


def let_ask(device: DeviceSetup, *, drives: bool = True) -> None:
    """Have devices ask who sits at this terminal for a hand; in a pipe, or with --json, nobody.

    Raises Fault SERVO_SWITCH_UNTRIED where a hand is needed before it ``drives`` and nobody can be asked.
    """
    if sys.stderr.isatty() and not asks_json():  # no colour that is asked for makes a terminal of a pipe
        person.asks = _ask_for
    if drives and person.asks is None and (hand := backend_of(device).hand(device)):
        raise Fault("SERVO_SWITCH_UNTRIED", hand)  # now: once it is open its registers are changed


def _ask_for(words: str, is_seen: Callable[[], bool]) -> bool:
    """As of ``person.asks``. Raises Fault INTERRUPTED where a signal asks the command to end: nothing drives yet."""
    from rig.control.loop.stop_request import stop_on_signals

    click.echo(words, err=True)
    until_s = time.monotonic() + _HAND_S
    with stop_on_signals() as stop:
        while True:
            has_seen = is_seen()
            if (reason := stop.look()) is not None:  # also one that came during the last look
                raise Fault("INTERRUPTED", reason)
            if has_seen or time.monotonic() > until_s:
                return has_seen


def say_chip_starts(port: str | None) -> None:
    """Say on a terminal that an emulated chip takes its time to start; in a pipe nothing."""
    if port in CHIP_PORTS and sys.stderr.isatty():
        click.echo("starting the emulated chip: some ten seconds, longer on a busy machine ...", err=True)


def perform(start: Callable[[OnStart], Outcome], *, verbose: bool = True) -> Outcome:
    """Run with live progress (in a pipe: one line per stage), then show the result; with --json neither."""
    from rig.run_folder.recording.follow import following

    with contextlib.ExitStack() as stack:

        def on_start(folder: Path, notes: tuple[str, ...]) -> None:
            for note in notes:
                click.echo(f"rig: {note}", err=True)
            if not asks_json():
                stack.enter_context(following(folder))

        outcome = start(on_start)
    if not asks_json():
        show_run(outcome, verbose=verbose)
    return outcome


def finish(outcome: Outcome) -> NoReturn:
    """End the command with the run: its result as JSON if that is asked for, and the exit status."""
    if asks_json():
        say_json(outcome.as_json())
    sys.exit(EXIT_FAILED if outcome.failure else 0)
