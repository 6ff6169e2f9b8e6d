"""`rig calibrate`: measure what a bench's config must say of sensor, travel and drive, in a dialogue."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import click

from rig.cli.driving import let_ask
from rig.cli.shared import (
    CONFIG,
    EXIT_FAILED,
    FILE,
    JSON,
    OUT,
    PACE,
    asks_json,
    end_no_more,
    ended_in_words,
    fail,
    say_json,
)
from rig.config.problems import key_of
from rig.core.signals import plain
from rig.run_folder.live.running import told
from rig.running.calibrate.dialogue import Ask, Motion, Say, Skipped
from rig.running.calibrate.wiring import text as drawn


@click.command()
@CONFIG
@click.argument("steps", nargs=-1, metavar="[STEP]...")
@click.option(
    "--answers", type=FILE,
    help="Take the answers from this file, a line each; lines that begin with # are comments. Default: ask; in a pipe: "
    "the lines of stdin.",
)  # fmt: skip
@OUT
@PACE
@JSON
def calibrate(config_path: Path, steps: tuple[str, ...], answers: Path | None, out: Path, pace: float | None) -> None:
    """Measure what a config must say of sensor, travel and drive.

    Asks you to turn the shaft by hand to known angles and to its stops. Then, only after you have said yes, it drives
    the motor to and fro in short strokes. It refuses what cannot be true, and says which wires to look at. At the end
    it shows each change, and asks before it writes: comments stay, and the file as it was is kept beside it.

    STEP: angles (of an encoder: turn), travel, strokes, dead-band. Default: all.
    """
    from rig.running.calibrate.session import calibrate as go_through
    from rig.running.calibrate.session import open_config
    from rig.running.calibrate.steps import steps_for

    opened = open_config(config_path, pace)
    known = steps_for(opened.draft.original)
    if unknown := [name for name in steps if name not in known]:
        words = ", ".join(f"{name} ({what})" for name, (what, _) in known.items())
        fail(f"this bench has no step {unknown[0]!r}", f"its steps: {words}")
    terminal = _Terminal(
        config_path, _lines(answers), echoes=answers is not None or not sys.stdin.isatty(), err=asks_json()
    )
    let_ask(opened.draft.original.device, drives=not {"strokes", "dead-band"}.isdisjoint(steps or known))
    with told(out, "calibrate") as flag, ended_in_words("nothing is written", f"{config_path} is as it was"):
        terminal.say(Say("At any question `skip` leaves the step out, `quit` ends without writing."))
        done = go_through(opened, steps or tuple(known), out, terminal, flag)
    if done.backup is not None:
        terminal.say(
            Say(f"{config_path}: written; as it was: {done.backup}\nnext: rig check {shlex.quote(str(config_path))}")
        )
    if asks_json():
        say_json(
            {
                "ok": not done.problems,
                "changes": {key_of(path): value for path, value in done.draft.changes.items()},
                "backup": None if done.backup is None else str(done.backup),
                "problems": list(done.problems),
            }
        )
    sys.exit(EXIT_FAILED if done.problems else 0)


def _lines(answers: Path | None) -> Iterator[str]:
    """Answers, one after the other: from the file without its comments; else from stdin, as they come."""
    if answers is None:
        return sys.stdin
    try:
        lines = answers.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        fail(f"{answers}: cannot be read: {error.strerror}", "name a text file with an answer a line")
    except UnicodeDecodeError:
        fail(f"{answers} is no text in UTF-8", "name a text file with an answer a line")
    return (line for line in lines if not line.startswith("#"))


class _Terminal:
    """Shows and asks. In a pipe it prints each answer behind its question, so that the whole can be read afterwards."""

    def __init__(self, file: Path, answers: Iterator[str], *, echoes: bool, err: bool) -> None:
        self._file = file
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
        """The answer as it was typed. Raises Skipped and NotWrittenError."""
        from rig.running.calibrate.session import NotWrittenError

        if any(meaning for _, meaning in question.choices):
            width = max(len(name) for name, _ in question.choices)
            for name, meaning in question.choices:
                self._echo(f"  {name:{width}}  {meaning}".rstrip())
        names = "/".join(name for name, _ in question.choices)
        hint = f" ({names})" if names else ""
        default = f" [{question.default}]" if question.default else ""
        words = question.words + _of_enter(question)
        click.echo(f"{words}{hint}{default}: ", nl=False, err=self._err)
        try:
            line = next(self._answers, None)
        except UnicodeDecodeError:
            fail("an answer is no text in UTF-8", "nothing is written: start again")
        if line is None:
            self._echo("")
            because = f"; before: {self._refused}" if self._refused else ""
            raise NotWrittenError(f"the answers ended at: {words}{because}", f"{self._file} is as it was")
        answer = line.rstrip("\r\n")
        if self._echoes:
            self._echo(plain(answer))
        if answer.strip() == "quit":
            raise NotWrittenError("ended; nothing is written", f"{self._file} is as it was")
        if answer.strip() == "skip":
            raise Skipped("skipped")
        return answer

    def does(self, motion: Motion) -> None:
        """Nothing: who sits at a terminal sees the bench."""

    def writes(self) -> None:
        """A signal is too late now. Ctrl-C says that it was interrupted, not what is written."""
        end_no_more()

    def _echo(self, words: str) -> None:
        click.echo(words, err=self._err)


def _of_enter(question: Ask) -> str:
    """What Enter alone does, for the end of a question."""
    if question.kind == "enter":
        return ", and press Enter"
    return f"; Enter alone: {question.empty}" if question.empty else ""
