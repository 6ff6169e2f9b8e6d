"""What is said is what can be typed: every command, option and key that a sentence of rig names is there."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import click
import pytest
from click import Group
from command_line import rig

from rig import config
from rig.cli import main
from rig.core.faults import FAULTS

ROOT = Path(__file__).resolve().parents[2]
COMMAND = re.compile(r"`rig (?P<name>[a-z-]+)(?P<rest>[^`]*)`(?P<after>(?: --[a-zA-Z-]+)*)")
OPTION = re.compile(r"(?<![\w-])--[a-zA-Z][a-zA-Z-]*")


def keys(schema: dict[str, Any]) -> set[str]:
    """Every key of a config, written with dots; of lists and of either-or, those of their items."""
    found: set[str] = set()

    def walk(node: dict[str, Any], above: tuple[str, ...], inside: tuple[str, ...]) -> None:
        if "$ref" in node:
            name = node["$ref"].rpartition("/")[2]
            if name not in inside:
                walk(schema["$defs"][name], above, (*inside, name))
        for several in ("anyOf", "allOf", "oneOf"):
            for one in node.get(several, ()):
                walk(one, above, inside)
        if isinstance(node.get("items"), dict):
            walk(node["items"], above, inside)
        for key, value in node.get("properties", {}).items():
            found.add(".".join((*above, key)))
            walk(value, (*above, key), inside)

    walk(schema, (), ())
    return found


KEYS = keys(config.json_schema())
SECTIONS = "|".join(sorted({key.split(".")[0] for key in KEYS if "." in key}))
REGISTERS = "daq.modbus.registers."
# elsewhere: a campaign's, and registers as the register map and its device call them
OTHER_KEYS = keys(config.json_schema(config.Campaign)) | {key.removeprefix(REGISTERS) for key in KEYS}
# a name with dots that begins with a section, and is no file, module or domain
KEY = re.compile(rf"(?<![\w./`{{])(?:{SECTIONS})(?:\.[A-Za-z_][A-Za-z0-9_]*)+(?![\w(.{{])")


def named_keys(text: str) -> list[str]:
    return [
        key
        for key in KEY.findall(text)
        if not key.endswith((".yaml", ".py", ".json", ".md", ".html", ".mat", ".xml", ".j2"))
    ]


def named_commands(text: str) -> Iterator[tuple[str, list[str]]]:
    for found in COMMAND.finditer(text):
        yield found["name"], OPTION.findall(found["rest"] + found["after"])


@cache
def sentences() -> tuple[tuple[str, str], ...]:
    """Every string of rig's own code that is no docstring, with its place; what an f-string fills in is {}."""
    return tuple(_sentences())


def _sentences() -> Iterator[tuple[str, str]]:
    for path in sorted((ROOT / "rig").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        nodes = list(ast.walk(tree))
        docstrings = {
            id(node.body[0].value)
            for node in nodes
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        passed_by = docstrings | {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
        file = path.relative_to(ROOT)
        for node in nodes:
            if isinstance(node, ast.JoinedStr):
                yield (
                    f"{file}:{node.lineno}",
                    "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values),
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in passed_by:
                yield f"{file}:{node.lineno}", node.value


def test_every_cure_of_a_fault_says_what_to_type_or_which_key() -> None:
    silent = [
        code
        for code, entry in FAULTS.items()
        if not any(key in KEYS for key in named_keys(entry.cure_with())) and not list(named_commands(entry.cure_with()))
    ]
    assert silent == []


def test_every_command_and_option_that_is_named_is_there() -> None:
    assert isinstance(main, Group)
    wrong = []
    number = 0
    for place, text in sentences():
        for name, options in named_commands(text):
            number += 1
            command = main.commands.get(name)
            there = set() if command is None else {o for p in command.params for o in p.opts} | {"--help"}
            if command is None or not set(options) <= there:
                wrong.append((place, name, options))
    assert wrong == []
    assert number > 40


def test_every_key_that_is_named_is_there() -> None:
    named = [(place, key) for place, text in sentences() for key in named_keys(text)]
    elsewhere = ("rig/campaign/", "rig/backends/modbus/", "rig/backends/serial/emulated/")
    assert [
        (place, key)
        for place, key in named
        if key not in KEYS and not (place.startswith(elsewhere) and key in OTHER_KEYS)
    ] == []
    assert len({key for _, key in named}) > 45


def test_advice_to_record_anew_names_a_key_or_a_command() -> None:
    """Cures of what identification refuses; what it doubts has one line of its own below the table."""
    advice = re.compile(r"^record (?:a|at|again|longer|the|it)\b")
    silent = [
        (place, text)
        for place, text in sentences()
        if place.startswith(("rig/identification/", "rig/run_folder/recording/series.py"))
        and advice.match(text)
        and "`rig" not in text
        and not named_keys(text)
    ]
    assert silent == []


def test_out_is_a_folder_and_to_is_a_file_in_every_command() -> None:
    assert isinstance(main, Group)
    seen = []
    for name, command in main.commands.items():
        for option in command.params:
            if isinstance(option, click.Option) and not option.hidden and {"--out", "--to"} & set(option.opts):
                seen.append((name, option.opts[0]))
                if option.metavar == "FILE|TOOL":  # a tool gets several files, in --into
                    assert name == "export"
                    continue
                assert isinstance(option.type, click.Path)
                assert ("--to" in option.opts) == (option.type.file_okay and option.metavar == "FILE"), name
                assert ("--out" in option.opts) == (not option.type.file_okay), name
    assert {("schema", "--to"), ("export", "--to"), ("run", "--out"), ("campaign", "--out")} <= set(seen)


@pytest.mark.parametrize("words", ["12", "a:b", "5:-1", "1:2:3"])
def test_rows_that_are_no_rows_are_refused(words: str, tmp_path: Path) -> None:
    result = rig("identify", tmp_path, "--rows", words)
    assert result.exit_code == 2
    assert "FIRST:LAST" in result.stderr
