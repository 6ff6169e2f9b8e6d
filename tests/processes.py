"""Processes that a test watches, and what emulated devices write of themselves."""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable
from pathlib import Path

PATIENCE_S = 600.0  # longer than any machine holds a process up: beyond it nothing comes any more


def alive(pid: int) -> bool:
    """Whether there is such a process."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def wait_until(true: Callable[[], bool], patience_s: float = PATIENCE_S) -> None:
    """Return once it is so; fails where it never is."""
    until_s = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < until_s, "it never happened"
        time.sleep(0.02)


def rows(trace: Path) -> list[dict[str, float]]:
    """Whole rows of an emulated device's trace so far."""
    lines = trace.read_text().splitlines(keepends=True)
    whole = [line for line in lines if line.endswith("\n")]
    return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(whole)]


_PLAIN = """
from rig.identification import identification
from rig.running import session

identification._add_motor_law = lambda *_: None
session.write_report = lambda folder, *_: (folder / "report.html").write_text("not in this test")
"""
# `rig` in a process of its own, but no laws are sought and no page is made, which takes longer than most runs do
PLAIN_RIG = f"{_PLAIN}\nfrom rig.cli import main\nmain()\n"


def plain_runs(folder: Path, *commands: str) -> dict[str, str]:
    """The environment of a process whose own `rig run`, or whatever ``commands`` are, end as those of PLAIN_RIG.

    commands  as they are typed after ``python -P -m``
    """
    typed = [command.split() for command in commands or ("rig run",)]
    begin = f"import sys\nif any(sys.orig_argv[3:][:len(one)] == one for one in {typed}):\n    exec({_PLAIN!r})\n"
    (folder / "sitecustomize.py").write_text(begin, encoding="utf-8")
    return os.environ | {"PYTHONPATH": str(folder)}
