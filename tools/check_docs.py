"""Holds the documents against the project: links lead somewhere, commands and make targets exist.

    python tools/check_docs.py

Exit status 1 with one line for each thing that does not hold.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import click

from rig.cli import main as rig_command

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)(?:#[^)]*)?\)")
CODE = re.compile(r"```(?:sh|console|bash)?\n(.*?)```|`([^`\n]+)`", re.DOTALL)


def commands(text: str) -> list[list[str]]:
    """Words of every line of code that starts with `rig` or `make`."""
    lines = [line for block, inline in CODE.findall(text) for line in (block or inline).splitlines()]
    words = [line.split("#")[0].replace("$ ", "").split() for line in lines]
    return [w for w in words if len(w) > 1 and w[0] in ("rig", "make")]


def options(command: click.Command) -> set[str]:
    """Every spelling of every option of a command."""
    return {name for parameter in command.params for name in parameter.opts} | {"--help", "-h"}


def problems(path: Path) -> list[str]:
    """What does not hold in one document."""
    text = path.read_text(encoding="utf-8")
    found = [
        f"link to {target}, which is not there"
        for target in LINK.findall(text)
        if "://" not in target and not (path.parent / target).exists()
    ]
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for words in commands(text):
        if words[0] == "make":
            if words[1].isalpha() and words[1] not in targets:
                found.append(f"`make {words[1]}`: no such target")
            continue
        command = rig_command.commands.get(words[1])
        if command is None:
            if words[1].isalpha():
                found.append(f"`rig {words[1]}`: no such command")
            continue
        found += [
            f"`rig {words[1]} {word}`: no such option"
            for word in words[2:]
            if re.fullmatch(r"--[A-Za-z0-9-]+", word) and word not in options(command)
        ]
    return found


def main() -> int:
    """Check every tracked Markdown file."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    bad = [f"{name}: {problem}" for name in listed.stdout.splitlines() for problem in problems(ROOT / name)]
    print("\n".join(bad) or "docs: links, commands and targets hold")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
