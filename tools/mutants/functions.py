"""Where a function is in a source file, Python or C: mutants are anchored to functions, which keep their names."""

from __future__ import annotations

import ast
import re
from functools import lru_cache

_C_HEAD = re.compile(r"^(?:ISR\((?P<isr>\w+)\)|(?!#)\w[\w \t*]*?\b(?P<name>\w+)(?:\[\w*\])? *(?:\(|=|;))")

Span = tuple[int, int]  # offsets in the text, the second one behind the end


def spans(text: str, name: str, *, is_c: bool) -> list[Span]:
    """Where the definitions of that name are: more than one where a compiler chooses.

    name  of Python qualified: ``Guard.allow``; of C also of an interrupt's vector or of a table; empty: the whole file
    """
    if not name:
        return [(0, len(text))]
    return [span for known, span in (_c(text) if is_c else _python(text)) if known == name]


def name_at(text: str, offset: int, *, is_c: bool) -> str:
    """The innermost function or class around an offset; empty outside all."""
    around = [
        (end - start, known) for known, (start, end) in (_c(text) if is_c else _python(text)) if start <= offset < end
    ]
    return min(around)[1] if around else ""


@lru_cache(maxsize=64)
def _python(text: str) -> list[tuple[str, Span]]:
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: list[tuple[str, Span]] = []

    def visit(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                first = min([child.lineno, *(decorator.lineno for decorator in child.decorator_list)])
                name = f"{prefix}{child.name}"
                found.append((name, (starts[first - 1], starts[child.end_lineno or first])))
                visit(child, f"{name}.")
            else:
                visit(child, prefix)

    visit(ast.parse(text), "")
    return found


@lru_cache(maxsize=64)
def _c(text: str) -> list[tuple[str, Span]]:
    """What begins at a line's beginning and ends with a brace there."""
    found: list[tuple[str, Span]] = []
    offset, name, start = 0, "", 0
    for line in text.splitlines(keepends=True):
        head = _C_HEAD.match(line)
        if head and not line.startswith("typedef"):
            name, start = head["isr"] or head["name"], offset
        if name and line.startswith("}"):
            found.append((name, (start, offset + len(line))))
            name = ""
        offset += len(line)
    return found
