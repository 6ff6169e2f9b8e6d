"""Every command that a sentence of the program names is there, with its options; tools/check_docs.py does the pages."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click

from rig.cli import main

ROOT = Path(__file__).resolve().parents[2]


def named() -> Iterator[tuple[str, str]]:
    """File and command, in the backticks of its sentences and the code of its pages."""
    for path in sorted([*(ROOT / "rig").rglob("*.py"), *(ROOT / "rig").rglob("*.j2")]):
        text = re.sub(r'"\s*\n\s*f?"', "", path.read_text(encoding="utf-8"))  # one literal over several lines
        yield from ((path.name, command) for command in re.findall(r"(?:`|<code>)(rig [a-z][^`<]*)[`<]", text))


def test_every_named_command_and_option_exists() -> None:
    seen = list(named())
    assert len(seen) > 20
    wrong = []
    for place, command in seen:
        words = shlex.split(command.split(" | ")[0].replace("...", ""), comments=True)[1:]
        known = main.commands.get(words[0])
        if known is None:
            wrong.append(f"{place}: {command}")
            continue
        options = {name for p in known.params if isinstance(p, click.Option) for name in (*p.opts, *p.secondary_opts)}
        asked = {word.split("=")[0].rstrip(",.;:") for word in words[1:] if word.startswith("--")}
        if not asked <= options | {"--help"}:
            wrong.append(f"{place}: {command}")
    assert wrong == []
