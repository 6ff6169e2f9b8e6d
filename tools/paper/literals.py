"""Numbers and verdicts typed into the report's text: they must come from the run, a setting or ``surviving``.

The source of the sections is searched: whatever stands in a string is typed, whatever stands in its braces is computed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
SECTIONS = (
    "example_4_1", "theorem_2_1", "example_4_2a", "example_4_2b", "example_4_2c", "table_1", "noise", "example_4_3",
    "section_5", "sampling",
)  # fmt: skip
MAKERS = ("Remark", "Comparison", "Paragraph", "Heading", "Table", "Section", "finish", "Cell")

# What names a place in the paper, or is part of a formula, is no claim.
REFERENCES = re.compile(
    r"""
    (Examples?|Theorems?|Property|Properties|Remarks?|Rem\.|Fig\.|section|Tables?)\s*\(?[IV\d]+(\.\d+)?
      (\s*(to|and|,)\s*\d+(\.\d+)?)*
    | \(\d{1,2}\)([–-]\(\d{1,2}\))?           # equations
    | docs/theory\.md\s\d+(\.\d+)*            # our own
    | ^4\.[123](\s\([a-d]\)(,\s\([a-d]\))?)?(,\sRem\.\s3\.1)?$   # places of the summary
    | ,\s3\.2\b | \b4\.1\sto\s4\.3
    | <su[bp]>[^<]*</su[bp]>                  # indices and exponents
    | \b[htkJ]\d\b | \bT/2\b                  # names
    | \by\(0\) | \bz\(0\) | \(0\)
    | 1/√N | 1/τ | ω/4 | \(1\s\+ | ^0$ | [=≠]\s0\b | \#[0-9a-fA-F]{6}
    | (from|at|At|starts?\sat)\s0(?=[\s,]) | stages?\s\d
    """,
    re.VERBOSE,
)
KEY = re.compile(r"^[a-z]+(-[a-z0-9]+)+$")  # of a section
NUMBER = re.compile(r"(?<![\w.])\d+(\.\d+)?")
WORDS = "words"  # the name under which they are searched
VERDICTS = ("agrees", "differs")


class Literal(NamedTuple):
    """Something typed: where, and what."""

    place: str
    text: str


def typed_numbers(modules: Mapping[str, str] | None = None) -> list[Literal]:
    """Numbers in the text that the sections hand to the page; ``modules``: name -> source, by default the sections'."""
    return [
        Literal(f"{name}:{node.lineno}", str(node.value))
        for name, call in _calls(modules)
        for node in _typed(call)
        if NUMBER.search(REFERENCES.sub(" ", str(node.value)))
    ]


def typed_verdicts(modules: Mapping[str, str] | None = None) -> list[Literal]:
    """Verdicts that no function computed: "agrees" or "differs" as they stand in a remark or a comparison."""
    return [
        Literal(f"{name}:{argument.lineno}", str(argument.value))
        for name, call in _calls(modules)
        if _name(call) in ("Remark", "Comparison")
        for argument in ast.walk(call)
        if isinstance(argument, ast.Constant) and argument.value in VERDICTS
    ]


def texts() -> int:
    """How many pieces of text were searched."""
    return sum(1 for _, call in _calls(None) for _ in _typed(call))


def _calls(modules: Mapping[str, str] | None) -> Iterator[tuple[str, ast.Call]]:
    """Whatever makes a part of the page; a function that returns text does, too: what it returns counts as a call."""
    sources = {name: (HERE / f"{name}.py").read_text(encoding="utf-8") for name in SECTIONS}
    for name, source in (sources if modules is None else modules).items():
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Call) and _name(node) in MAKERS:
                yield name, node
            if isinstance(node, ast.FunctionDef) and isinstance(node.returns, ast.Name) and node.returns.id == "str":
                body = [statement for statement in node.body if not isinstance(statement, ast.Expr)]  # no docstring
                yield name, ast.Call(ast.Name(WORDS), [_as_tuple(body)], [])


def _as_tuple(statements: list[ast.stmt]) -> ast.Tuple:
    """All expressions that the statements hold, as one argument."""
    found = [child for statement in statements for child in ast.walk(statement) if isinstance(child, ast.expr)]
    inner = {id(child) for outer in found for child in ast.walk(outer) if child is not outer}
    return ast.Tuple([expression for expression in found if id(expression) not in inner])


def _name(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else ""


def _typed(call: ast.Call) -> Iterator[ast.Constant]:
    """Strings among a call's arguments, those within other makers' calls aside, and format specifications."""
    waiting: list[ast.AST] = [*call.args, *(keyword.value for keyword in call.keywords)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Call) and _name(node) in MAKERS:
            continue
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and not KEY.match(node.value):
            yield node
        if isinstance(node, ast.FormattedValue):
            waiting.append(node.value)
        elif isinstance(node, ast.Subscript):
            waiting.append(node.value)  # a key is no text
        else:
            waiting.extend(ast.iter_child_nodes(node))
