"""Processes that rig starts load rig and Python, and nothing that lies in the folder in which the user stands."""

from __future__ import annotations

import ast
from pathlib import Path

RIG = Path(__file__).resolve().parents[2] / "rig"
CLOSED = {"-P", "-I"}  # the working folder is not on the path


def starts(path: Path) -> list[set[str]]:
    """The options of each list or tuple in a file that begins with this Python."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [
        {part.value for part in one.elts if isinstance(part, ast.Constant) and isinstance(part.value, str)}
        for one in ast.walk(tree)
        if isinstance(one, ast.List | ast.Tuple) and one.elts and ast.unparse(one.elts[0]) == "sys.executable"
    ]


def test_no_process_has_the_working_folder_on_its_path() -> None:
    found = {path: starts(path) for path in RIG.rglob("*.py")}
    assert sum(map(len, found.values())) >= 10
    open_ones = [str(path.relative_to(RIG)) for path, options in found.items() if any(not o & CLOSED for o in options)]
    assert open_ones == []
