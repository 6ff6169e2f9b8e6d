"""The command `rig`. Each command stands in the file of its name; ``rig.cli.terminal`` shows the results.

shared   arguments and options that several commands have, and how a command ends
driving  what commands share that open a device

Exit status: 0 done, 1 the experiment failed or was refused, 2 bad input.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from functools import cache, wraps
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn, cast

import click

from rig.core.errors import RigError
from rig.core.package import VERSION

_GROUPS = {
    "Try it, without hardware": ("config", "emulate", "predict"),
    "Measure a motor": ("run", "identify", "relay", "survey", "design", "track"),
    "Use what was measured": ("report", "predict-run", "list", "compare", "tune", "newton-metres", "export"),
    "A bench of your own": (
        "init", "servo", "rehearse", "flash", "doctor", "calibrate", "home", "jog", "check", "panel", "schema",
    ),
    "Evidence": ("replay", "campaign"),
}  # fmt: skip
_NAMES = tuple(name for names in _GROUPS.values() for name in names)


class _ByName(Mapping[str, click.Command]):
    """The commands by name, each loaded when it is asked for: all of them together take half a second."""

    def __getitem__(self, name: str) -> click.Command:
        if name not in _NAMES:
            raise KeyError(name)
        return _loaded(name)

    def __iter__(self) -> Iterator[str]:
        return iter(_NAMES)

    def __len__(self) -> int:
        return len(_NAMES)


@cache
def _loaded(name: str) -> click.Command:
    loaded = vars(import_module(f"rig.cli.{name.replace('-', '_')}")).values()
    command = next(one for one in loaded if isinstance(one, click.Command) and one.name == name)
    for one in command.commands.values() if isinstance(command, click.Group) else (command,):
        if one.callback is not None:
            one.callback = _in_words(one.callback)
    return command


def _in_words(does: Callable[..., Any]) -> Callable[..., Any]:
    """A command that ends with cause and cure where it raises one of rig's errors."""

    @wraps(does)
    def done(*given: Any, **named: Any) -> Any:
        try:
            return does(*given, **named)
        except RigError as error:
            from rig.cli.shared import fail_with

            fail_with(error)

    return done


def _first_sentence(name: str) -> str:
    """The first paragraph of a command's help, from its file: the command itself need not be loaded."""
    file = Path(__file__).with_name(f"{name.replace('-', '_')}.py")
    for one in ast.parse(file.read_bytes()).body:
        if isinstance(one, ast.FunctionDef) and any("click" in ast.dump(line) for line in one.decorator_list):
            return (ast.get_docstring(one) or "").split("\n\n")[0]
    raise LookupError(f"{file} has no command")


def _interrupted() -> NoReturn:
    from rig.cli.shared import EXIT_FAILED

    click.echo("rig: interrupted; no drive is on", err=True)
    raise click.exceptions.Exit(EXIT_FAILED)


class _Commands(click.Group):
    """Commands in groups. A Ctrl-C ends them with one line, not a traceback, while no run's loop is going."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        try:
            return super().make_context(info_name, args, parent, **extra)
        except KeyboardInterrupt:
            _interrupted()

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            _interrupted()

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Each command with the whole first sentence of its help, group by group."""
        widest = max(map(len, _NAMES))
        for title, names in _GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(widest), _first_sentence(name)) for name in names])


@click.group(
    cls=_Commands,
    commands=cast(MutableMapping[str, click.Command], _ByName()),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(VERSION, prog_name="rig")
def main() -> None:
    """Identify and control a friction-impeded DC motor by relay feedback."""
