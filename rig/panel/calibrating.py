"""A calibration that a page goes through, as a process: ``python -m rig.panel.calibrating CONFIG OUT``.

It writes what it says, asks and does as a JSON object a line, and reads answers as a JSON object a line. If its input
ends, nobody is there any more: it ends, and writes nothing. A signal stops what drives; at any other time it ends the
process, until it writes the config.

What it drives ends when the panel no longer promises to be there (``attendance``).
"""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Literal, cast

from rig.config.problems import ConfigError
from rig.core.errors import RigError
from rig.core.faults import Fault
from rig.panel.calibration import watched
from rig.panel.messages import Answer, CalibrationEnd, Doing, Question, Said
from rig.run_folder.live.running import BusyError, told
from rig.run_folder.recording.errors import RecordingError
from rig.running.calibrate.dialogue import Ask, Hold, Motion, Read, Refusal, Say, Skipped, Strokes
from rig.running.calibrate.session import NotWrittenError, calibrate, open_config
from rig.running.calibrate.steps import steps_for
from rig.running.calibrate.wiring import svg


class _Page:
    """Shows and asks through standard output and input."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def say(self, what: Say) -> None:
        """Show it, with its drawings."""
        drawings = [{"title": wiring.title, "svg": svg(wiring)} for wiring in what.drawings]
        _tell("say", Said(kind=what.kind, words=what.words, drawings=drawings))

    def ask(self, question: Ask) -> str:
        """The answer. Raises Skipped; NotWrittenError if somebody ends the calibration."""
        _tell("ask", cast(Question, asdict(question)))
        said = self.heard()
        if said.get("skip"):
            raise Skipped("skipped")
        return said.get("answer", "")

    def steps(self, known: dict[str, str]) -> list[str]:
        """Which of these steps to go through. Raises NotWrittenError if it is none."""
        _tell("ask", Question(words="Which steps?", kind="steps", choices=list(known.items()), skips=False))
        wanted = self.heard().get("steps")
        chosen = [name for name in known if name in (wanted or ())]
        if not chosen:
            raise NotWrittenError("no step was chosen", "tick one or more")
        return chosen

    def heard(self) -> Answer:
        """What the page says. Raises NotWrittenError if it ends the calibration, or is gone."""
        line = sys.stdin.readline()
        said: Answer = json.loads(line) if line else {"end": True}
        if said.get("end"):
            raise NotWrittenError("ended; nothing is written", f"{self._file.name} is as it was")
        return said

    def does(self, motion: Motion) -> None:
        """Rig is about to read or to drive."""
        words = "reads the sensor"
        if isinstance(motion, Strokes):
            words = "drives the motor"
        elif isinstance(motion, Hold):
            words = f"drives the bridge with {motion.u_V:+.2f} V for {motion.seconds:g} s"
        elif not isinstance(motion, Read):
            words = "sets the zero"
        _tell("does", Doing(words=words))

    def writes(self) -> None:
        """Rig is about to write the config. A Stop that comes now is too late: the page is told what was written."""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        _tell("does", Doing(words="writes the config"))


def _tell(type_: Literal["say", "ask", "does", "end"], what: Said | Question | Doing | CalibrationEnd) -> None:
    sys.stdout.write(json.dumps({"type": type_, **what}) + "\n")
    sys.stdout.flush()


def _end(words: str, cure: str, *, written: bool = False) -> None:
    _tell("end", CalibrationEnd(written=written, words=words, cure=cure))


@contextmanager
def _attended(out: Path) -> Iterator[Callable[[], str]]:
    """What tells, for the block, that the panel is gone. Raises NotWrittenError where its leases have no room."""
    with ExitStack() as stack:
        try:
            gone = stack.enter_context(watched(out))
        except OSError as error:
            raise NotWrittenError(
                f"no file can be made below {out}: {error.strerror}; without one rig cannot notice a dead panel",
                "check the disk and its permissions",
            ) from error
        yield gone


def main(config: Path, out: Path) -> None:
    """Go through one calibration."""
    page = _Page(config)
    try:
        with told(out, "calibrate") as flag:
            opened = open_config(config, pace=1.0)
            known = {name: what for name, (what, _) in steps_for(opened.draft.original).items()}
            with _attended(out) as gone:
                done = calibrate(opened, page.steps(known), out, page, flag, gone)
    except ConfigError as error:
        _end("rig cannot calibrate with this config", str(error))
    except (BusyError, Fault, Refusal, NotWrittenError, RecordingError) as error:
        _end(str(error) if isinstance(error, Fault) else getattr(error, "cause", str(error)), error.cure)
    except RigError as error:  # such as of an emulated device that does not start
        words, _, cure = str(error).partition("\n")
        _end(words, cure)
    else:
        if done.backup is None:
            words, cure = "nothing to change", f"{config.name} is as it was"
        else:
            words, cure = f"{config.name} is written", f"as it was: {done.backup}"
        _end(words, cure, written=done.backup is not None)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
