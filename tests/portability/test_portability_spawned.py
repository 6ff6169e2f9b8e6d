"""Processes that rig starts load rig and Python, and nothing that lies in the folder in which the user stands."""

from __future__ import annotations

import ast
from pathlib import Path

RIG = Path(__file__).resolve().parents[2] / "rig"
CLOSED = {"-P", "-I"}  # the working folder is not on the path

# Of those that start one: the search finds them, else it would find no open one either.
PLACES = {
    "backends/emulated/board_process.py",
    "backends/servo/keeper.py",
    "model/library_build.py",
    "control/loop/kernel_workers.py",
    "panel/calibration.py",
    "panel/processes.py",
    "run_folder/recording/follow.py",
    "run_folder/recording/recorder.py",
    "running/experiment/law_watch.py",
    "running/experiment/live_process.py",
}


def starts(path: Path) -> list[set[str]]:
    """The options of each list or tuple in a file that begins with this Python."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [
        {part.value for part in one.elts if isinstance(part, ast.Constant) and isinstance(part.value, str)}
        for one in ast.walk(tree)
        if isinstance(one, ast.List | ast.Tuple) and one.elts and "sys.executable" in ast.unparse(one.elts[0])
    ]


def test_no_process_has_the_working_folder_on_its_path() -> None:
    found = {path: starts(path) for path in RIG.rglob("*.py")}
    assert {str(path.relative_to(RIG)) for path, each in found.items() if each} >= PLACES
    open_ones = [str(path.relative_to(RIG)) for path, options in found.items() if any(not o & CLOSED for o in options)]
    assert open_ones == []
