"""No function of rig takes more than six parameters of plain values.

python tools/check_signatures.py

Plain are numbers, texts, truth values, paths, arrays, None, and unions of them: what a caller can put in the wrong
order without anybody noticing. An object of a type of its own is not counted, nor is ``self``. Who needs more plain
values gives them a frozen dataclass with a name from the field.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MOST = 6
PLAIN = {"int", "float", "str", "bool", "bytes", "complex", "None", "Path", "Array", "NDArray", "ndarray", "ArrayLike"}

# By file; a function that takes fewer has to leave the list.
ALLOWED: dict[str, set[str]] = {
    # click gives each option of a command as a parameter of its own
    "rig/cli/campaign.py": {"campaign"},
    "rig/cli/export.py": {"export"},
    "rig/cli/init.py": {"init"},
    "rig/cli/jog.py": {"jog"},
    "rig/cli/run.py": {"run"},
    "rig/cli/tune.py": {"tune"},
    "rig/cli/panel.py": {"panel"},
}


def is_plain(annotation: ast.expr | None) -> bool:
    """Whether a parameter of this annotation is a plain value; so is one without an annotation."""
    if isinstance(annotation, ast.BinOp):
        return is_plain(annotation.left) and is_plain(annotation.right)
    if isinstance(annotation, ast.Subscript):
        return is_plain(annotation.value)
    if isinstance(annotation, ast.Attribute):
        return annotation.attr in PLAIN
    if isinstance(annotation, ast.Name):
        return annotation.id in PLAIN
    return annotation is None or (isinstance(annotation, ast.Constant) and annotation.value is None)


def functions(body: list[ast.stmt], inside: str = "") -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Every function under these statements, with the classes and functions that it stands in."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = f"{inside}.{node.name}" if inside else node.name
            if not isinstance(node, ast.ClassDef):
                yield name, node
            yield from functions(node.body, name)
        elif isinstance(node, ast.If | ast.Try | ast.With):
            yield from functions(node.body, inside)


def plain_parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """How many of its parameters are plain values."""
    given = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return sum(is_plain(one.annotation) for one in given if one.arg not in ("self", "cls"))


def problems(path: Path, allowed: set[str]) -> list[str]:
    """What is wrong in a file, one line each."""
    found, crowded = [], set()
    for name, function in functions(ast.parse(path.read_text(encoding="utf-8")).body):
        plain = plain_parameters(function)
        if plain > MOST:
            crowded.add(name)
            if name not in allowed:
                found.append(f"{function.lineno}: `{name}` takes {plain} plain values; a dataclass makes them one")
    return found + [f"1: `{name}` takes {MOST} or fewer: take it off the list" for name in sorted(allowed - crowded)]


def main() -> int:
    """Check every file of the package."""
    files = {str(path.relative_to(ROOT)): path for path in sorted((ROOT / "rig").rglob("*.py"))}
    bad = [f"{name}:{what}" for name, path in files.items() for what in problems(path, ALLOWED.get(name, set()))]
    bad += [f"{name}: no such file: take it off the list" for name in ALLOWED.keys() - files]
    print("\n".join(bad) or f"signatures: {MOST} plain values at most")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
