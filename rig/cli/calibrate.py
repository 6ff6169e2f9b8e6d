"""`rig calibrate`: measure what a bench's config must say of sensor, travel and drive, in a dialogue."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import click

from rig.calibrate.dialogue import Ask, Hold, Say, Skipped, Strokes
from rig.calibrate.draft import Draft
from rig.calibrate.refusal import Refusal
from rig.calibrate.wiring import text as drawn
from rig.cli.driving import compiled
from rig.cli.failure import EXIT_BAD_INPUT, EXIT_FAILED, fail, fail_config, faults
from rig.cli.options import CONFIG, JSON, OUT
from rig.config.edit import EditError
from rig.config.load import load_with_places
from rig.config.problems import ConfigError, key_of
from rig.preflight import preflight
from rig.recording.folder import json_text
from rig.signals import plain

_NEEDED_BEFORE = ("daq", "drive.bridge", "emulated")  # keys without which no device can be opened


class _Quit(Exception):
    """Somebody ends the dialogue."""


@click.command()
@CONFIG
@click.argument("steps", nargs=-1, metavar="[STEP]...")
@click.option(
    "--answers", type=click.Path(path_type=Path, dir_okay=False),
    help="Take the answers from this file, a line each; lines that begin with # are comments. Default: ask; in a pipe: "
    "the lines of stdin.",
)  # fmt: skip
@OUT
@JSON
def calibrate(config_path: Path, steps: tuple[str, ...], answers: Path | None, out: Path, as_json: bool) -> None:
    """Measure sensor, travel and drive of a bench, and put the results into CONFIG.

    Asks you to turn the shaft by hand to known angles and to its stops. Then, only after you have said yes, it drives
    the motor to and fro in short strokes. It refuses what cannot be true, and says which wires to look at. At the end
    it shows each change, and asks before it writes: comments stay, and the file as it was is kept beside it.

    STEP: angles (of an encoder: turn), travel, strokes, dead-band. Default: all.
    """
    draft, text = _read(config_path)
    from rig.calibrate.bench import HandBench
    from rig.calibrate.steps import calibration, steps_for

    known = steps_for(draft.original)
    if unknown := [name for name in steps if name not in known]:
        words = ", ".join(f"{name} ({what})" for name, (what, _) in known.items())
        fail(EXIT_BAD_INPUT, f"this bench has no step {unknown[0]!r}", f"its steps: {words}")
    terminal = _Terminal(_lines(answers), echoes=answers is not None or not sys.stdin.isatty(), err=as_json)
    try:
        with faults(), HandBench(draft.original, out) as bench:
            dialogue = calibration(draft, steps or tuple(known))
            request = next(dialogue)
            while True:
                try:
                    if isinstance(request, Say):
                        terminal.say(request)
                        request = dialogue.send(None)
                    elif isinstance(request, Ask):
                        request = dialogue.send(terminal.ask(request))
                    else:
                        if isinstance(request, Strokes | Hold):
                            compiled()
                        request = dialogue.send(bench.perform(request))
                except (Skipped, Refusal) as instead:
                    request = dialogue.throw(instead)
    except StopIteration as end:
        found: Draft = end.value
    except _Quit as quit_:
        fail(EXIT_FAILED, str(quit_) or "ended; nothing is written", f"{config_path} is as it was")
    _finish(found, terminal, config_path, text, as_json)


def _read(path: Path) -> tuple[Draft, str]:
    """The config, and its text. A config that `rig check` refuses can be calibrated, if its device can be opened."""
    from rig.backends.links.device_file import require_device_file
    from rig.calibrate.save import read_text

    try:
        experiment, document = load_with_places(path)
        problems = [p for p in preflight(experiment).problems if p.key.startswith(_NEEDED_BEFORE)]
        if problems:
            raise ConfigError(map(document.located, problems))
        text = read_text(path)
    except ConfigError as error:
        fail_config(error)
    with faults():
        require_device_file(experiment.daq.port)
    return Draft(experiment, document.data), text


def _finish(found: Draft, terminal: _Terminal, file: Path, text: str, as_json: bool) -> NoReturn:
    """Show what would change, ask, write; the exit status."""
    from rig.calibrate.save import save

    backup, problems = None, preflight(found.experiment).problems
    if not found.changes:
        terminal.say(Say(f"{file}: nothing to change"))
    else:
        terminal.say(Say("changes: " + f"{file}\n" + "\n".join(f"  {line}" for line in found.lines()), "step"))
        if problems:
            terminal.say(Say("`rig check` will say:\n" + "\n".join(f"  {problem}" for problem in problems), "refused"))
        try:
            if not terminal.yes(f"write this to {file}?"):
                fail(EXIT_FAILED, "nothing is written", f"{file} is as it was")
            backup = save(file, text, found.changes)
        except _Quit as quit_:
            fail(EXIT_FAILED, str(quit_) or "nothing is written", f"{file} is as it was")
        except EditError as error:
            fail(EXIT_FAILED, error.cause, error.cure)
        except ConfigError as error:
            fail_config(error)
        except OSError as error:
            fail(EXIT_FAILED, f"{file}: cannot be written: {error.strerror}", f"{file} is as it was")
        terminal.say(Say(f"{file}: written; as it was: {backup}\nnext: rig check {shlex.quote(str(file))}"))
    if as_json:
        click.echo(
            json_text(
                {
                    "ok": not problems,
                    "changes": {key_of(path): value for path, value in found.changes.items()},
                    "backup": None if backup is None else str(backup),
                    "problems": [str(problem) for problem in problems],
                }
            ),
            nl=False,
        )
    sys.exit(EXIT_FAILED if problems else 0)


def _lines(answers: Path | None) -> Iterator[str]:
    """Answers, one after the other: from the file without its comments; else from stdin, as they come."""
    if answers is None:
        return sys.stdin
    try:
        lines = answers.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        fail(EXIT_BAD_INPUT, f"{answers}: cannot be read: {error.strerror}", "name a text file with an answer a line")
    except UnicodeDecodeError:
        fail(EXIT_BAD_INPUT, f"{answers} is no text in UTF-8", "name a text file with an answer a line")
    return (line for line in lines if not line.startswith("#"))


class _Terminal:
    """Shows and asks. In a pipe it prints each answer behind its question, so that the whole can be read afterwards."""

    def __init__(self, answers: Iterator[str], *, echoes: bool, err: bool) -> None:
        self._answers = answers
        self._echoes = echoes
        self._err = err
        self._refused = ""

    def say(self, what: Say) -> None:
        """Show it; a drawing below its words."""
        first = {"step": "\n", "found": "", "note": "", "refused": "NO: "}[what.kind]
        self._echo(click.style(first + what.words, bold=what.kind == "step"))
        for drawing in what.drawings:
            self._echo("\n" + "\n".join(f"    {line}".rstrip() for line in drawn(drawing).splitlines()) + "\n")
        if what.kind == "refused":
            self._refused = what.words.splitlines()[0]

    def ask(self, question: Ask) -> str:
        """The answer as it was typed. Raises Skipped and _Quit."""
        if any(meaning for _, meaning in question.choices):
            width = max(len(name) for name, _ in question.choices)
            for name, meaning in question.choices:
                self._echo(f"  {name:{width}}  {meaning}".rstrip())
        names = "/".join(name for name, _ in question.choices)
        hint = f" ({names})" if names else ""
        default = f" [{question.default}]" if question.default else ""
        click.echo(f"{question.words}{hint}{default}: ", nl=False, err=self._err)
        try:
            line = next(self._answers, None)
        except UnicodeDecodeError:
            fail(EXIT_BAD_INPUT, "an answer is no text in UTF-8", "nothing is written: start again")
        if line is None:
            self._echo("")
            because = f"; before: {self._refused}" if self._refused else ""
            raise _Quit(f"the answers ended at: {question.words}{because}")
        answer = line.rstrip("\r\n")
        if self._echoes:
            self._echo(plain(answer))
        if answer.strip() == "quit":
            raise _Quit("")
        if answer.strip() == "skip":
            raise Skipped("skipped")
        return answer

    def yes(self, words: str) -> bool:
        """Whether somebody says yes; Enter alone is yes. ``skip`` is no."""
        while True:
            try:
                answer = self.ask(Ask(words, "choice", "yes", (("yes", ""), ("no", "")))).strip().lower()
            except Skipped:
                return False
            if answer in ("", "y", "yes"):
                return True
            if answer in ("n", "no"):
                return False
            self.say(Say(f"{answer!r} is no answer here\ntype yes or no", "refused"))

    def _echo(self, words: str) -> None:
        click.echo(words, err=self._err)
