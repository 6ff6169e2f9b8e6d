"""One calibration from the config to the changed config, whoever asks the questions: a terminal or a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rig.backends.links.device_file import require_device_file
from rig.backends.links.usb_port import usb_port
from rig.backends.registry import backend_of
from rig.config.edit import EditError
from rig.config.load import load_with_places
from rig.config.problems import ConfigError
from rig.control.loop.stop_request import Gone
from rig.core.errors import CauseError
from rig.run_folder.live.stop_flag import StopFlag
from rig.running.calibrate.dialogue import Front, Say, Skipped, Talk
from rig.running.calibrate.draft import Draft, require_writable, save
from rig.running.calibrate.steps import calibration
from rig.running.preflight import preflight

_NEEDED_BEFORE = ("daq", "drive.bridge", "emulated", "loop.pace")  # keys without which no device can be opened


class NotWrittenError(CauseError):
    """The calibration ended and nothing is written."""

    status = 1


@dataclass(frozen=True)
class Opened:
    """A config that can be calibrated: its file, the text as it was read, and the draft."""

    file: Path
    text: str
    draft: Draft


@dataclass(frozen=True)
class Finished:
    """What came of a calibration.

    draft     the config with all changes
    backup    the file as it was; None: there was nothing to change
    problems  what `rig check` says of the changed config, a line each
    """

    draft: Draft
    backup: Path | None
    problems: tuple[str, ...]


def open_config(file: Path, pace: float | None = None) -> Opened:
    """Read a config. One that `rig check` refuses can be calibrated, if its device can be opened.

    pace  in place of loop.pace; None: as the file says
    Raises ConfigError; Fault if the device's port is not there.
    """
    experiment, document = load_with_places(file)
    experiment = experiment.at_pace(pace)
    problems = [p for p in preflight(experiment).problems if p.key.startswith(_NEEDED_BEFORE)]
    if problems:
        raise ConfigError(map(document.located, problems))
    require_device_file(experiment.daq.port)
    return Opened(file, document.text, _with_its_board(Draft(experiment, document.data)))


def _with_its_board(draft: Draft) -> Draft:
    """With the USB serial number of the board that is there, where the config has none and the board has one."""
    daq = draft.original.daq
    if daq.usb_serial is not None or daq.port is None or not daq.port.startswith("/"):
        return draft
    if "usb_serial" not in backend_of(draft.original.device).shared_keys:
        return draft
    number = usb_port(daq.port).serial_number
    return draft if number is None else draft.with_changes({("daq", "usb_serial"): number})


def calibrate(
    opened: Opened, steps: Sequence[str], runs: Path, front: Front, flag: StopFlag, gone: Gone | None = None
) -> Finished:
    """Go through the steps, show what would change, ask, write.

    steps  names among ``steps_for`` the config
    runs   folder in which the strokes' run folders are made
    flag   of the calibration, open: every Stop knows it
    gone   who has to be there while it drives, and is not: as of ``StopRequest``
    Raises NotWrittenError, Fault, ConfigError; RecordingError for a full disk.
    """
    from rig.running.calibrate.hand_bench import (
        HandBench,  # scipy comes with it: a config that is refused need not wait for it
    )

    file = opened.file
    try:
        require_writable(file)  # before anybody turns a shaft
    except EditError as error:
        raise NotWrittenError(error.cause, error.cure) from error
    except OSError as error:
        raise NotWrittenError(f"{file}: {error.strerror}", "check the path") from error
    with HandBench(opened.draft.original, runs, flag, gone) as bench:
        talk = Talk(front, bench.perform)
        found = calibration(talk, opened.draft, steps)
    problems = tuple(map(str, preflight(found.experiment).problems))
    if not found.changes:
        front.say(Say(f"{file}: nothing to change"))
        return Finished(found, None, problems)
    front.say(Say("changes: " + f"{file}\n" + "\n".join(f"  {line}" for line in found.lines()), "step"))
    if problems:
        front.say(Say("`rig check` will say:\n" + "\n".join(f"  {problem}" for problem in problems), "refused"))
    if not _yes(talk, f"write this to {file}?"):
        raise NotWrittenError("nothing is written", f"{file} is as it was")
    front.writes()
    try:
        backup = save(file, opened.text, found.changes)
    except EditError as error:
        raise NotWrittenError(error.cause, error.cure) from error
    except OSError as error:
        raise NotWrittenError(f"{file}: cannot be written: {error.strerror}", f"{file} is as it was") from error
    return Finished(found, backup, problems)


def _yes(talk: Talk, words: str) -> bool:
    """Whether somebody says yes; the empty answer is yes. Leaving it out is no."""
    try:
        return talk.choice(None, words, (("yes", ""), ("no", "")), skips=False) == "yes"
    except Skipped:
        return False
