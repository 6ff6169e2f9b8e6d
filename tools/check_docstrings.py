"""Docstrings say what the code needs them to say, in one format.

python tools/check_docstrings.py

    What it is, in a sentence.

    name, other   what they are: shape, unit, range
    Returns what, with its unit. Raises SomeError where.
    Source: equation or section.

Held here, for what is public in the rooms listed below (that there is a docstring, ruff holds everywhere):
a name in such a table is a parameter, a field or an attribute; a float or an array whose name ends in no unit stands in
the docstring; an error that a function raises is named in its docstring, or in that of its class. A method marked
`override` may go without one: the class above says what it is.
"""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

from check_signatures import functions, is_plain

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("rig",)

ROW = re.compile(r"^ *((?:[A-Za-z_]\w*)(?:, [A-Za-z_]\w*)*) {2,}\S")
UNITS = {"s", "ms", "us", "s2", "rad", "mrad", "deg", "V", "Hz", "ppm", "counts", "units", "ticks", "bytes"}
NUMBERS = {"float", "complex", "Array", "NDArray", "ndarray"}
Function = ast.FunctionDef | ast.AsyncFunctionDef


def table_of(text: str) -> list[str]:
    """Every name that a docstring has a row for."""
    rows = filter(None, map(ROW.match, text.splitlines()))
    return [name for row in rows for name in row.group(1).split(", ")]


def fields_of(owner: ast.ClassDef) -> set[str]:
    """Fields, attributes, properties and parameters of a class."""
    names = {node.attr for node in ast.walk(owner) if isinstance(node, ast.Attribute)}
    names |= {node.id for node in ast.walk(owner) if isinstance(node, ast.Name)}
    return names | {arg.arg for node in ast.walk(owner) if isinstance(node, ast.arguments) for arg in _given(node)}


def raised_in(function: Function) -> set[str]:
    """The errors that a function raises by their name."""
    raised = (node.exc for node in ast.walk(function) if isinstance(node, ast.Raise))
    return {error.func.id for error in raised if isinstance(error, ast.Call) and isinstance(error.func, ast.Name)}


def unexplained(function: Function, text: str) -> list[str]:
    """Numbers and arrays among the parameters that have their unit neither in the name nor in the docstring.

    A command's options have theirs in their help.
    """
    if any(isinstance(one, ast.Call) and ast.unparse(one.func).endswith(".command") for one in function.decorator_list):
        return []
    return [
        one.arg
        for one in _given(function.args)
        if _is_number(one.annotation) and not _has_unit(one.arg) and not re.search(rf"\b{one.arg}\b", text)
    ]


def problems(path: Path) -> list[str]:
    """What is wrong in a file, one line each."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    found = []
    for name, owner in classes.items():
        known = fields_of(owner)
        found += [
            f"{owner.lineno}: `{name}`: no such field: {row}"
            for row in table_of(ast.get_docstring(owner) or "")
            if row not in known
        ]
    for name, function in functions(tree.body):
        first, *rest = name.split(".")
        owner_class = classes.get(first) if rest else None
        built = rest in (["__init__"], ["__post_init__"])
        if any(part.startswith("_") for part in name.split(".")) and not (built and not first.startswith("_")):
            continue
        if len(rest) > (owner_class is not None):
            continue  # a function inside a function
        about = f"{function.lineno}: `{name}`"
        text = ast.get_docstring(function) or ""
        if not text and any(ast.unparse(one) == "override" for one in function.decorator_list):
            continue
        of_class = (ast.get_docstring(owner_class) or "") if owner_class is not None else ""
        text = text + of_class if built else text
        given = {one.arg for one in _given(function.args)}
        if not built:
            found += [f"{about}: no such parameter: {row}" for row in table_of(text) if row not in given]
        found += [f"{about}: say the unit of {one}" for one in unexplained(function, text)]
        found += [
            f"{about}: raises {error}, and does not say so"
            for error in raised_in(function)
            if error not in text + of_class
        ]
    return found


def _given(arguments: ast.arguments) -> list[ast.arg]:
    return [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]


def _is_number(annotation: ast.expr | None) -> bool:
    return is_plain(annotation) and any(
        isinstance(node, ast.Name | ast.Attribute) and (node.id if isinstance(node, ast.Name) else node.attr) in NUMBERS
        for node in ast.walk(annotation or ast.Constant(None))
    )


def _has_unit(name: str) -> bool:
    return "_" in name and name.rsplit("_", 1)[1] in UNITS


def _files(room: Path) -> list[Path]:
    return [room] if room.is_file() else sorted(room.rglob("*.py"))


def main() -> int:
    """Check every file of the rooms."""
    files = [path for room in ROOMS for path in _files(ROOT / room)]
    bad = [f"{path.relative_to(ROOT)}:{problem}" for path in files for problem in problems(path)]
    print("\n".join(bad) or f"docstrings: units, names and errors are said in {', '.join(ROOMS)}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
