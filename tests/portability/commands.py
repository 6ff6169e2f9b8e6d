"""Commands of rig one after the other in one process, each an argument of this module: what they exit with, at its end.

A word with a * in it is a path, as a shell has it. Nobody looks for laws of the motor, and only `rig report` draws its
figures: either takes longer than a run.
"""

from __future__ import annotations

import json
import multiprocessing
import shlex
import sys
from pathlib import Path

from rig.cli import main
from rig.identification import identification
from rig.output.report import page

vars(identification)["_add_motor_law"] = lambda *_: None

if __name__ == "__main__":
    statuses = []
    drawn = page.drawn
    for line in sys.argv[1:]:
        vars(page)["drawn"] = drawn if line.startswith("report ") else lambda *_: page.Figure(None, "not in this test")
        words: list[str] = []
        for word in shlex.split(line):
            words += map(str, Path().glob(word)) if "*" in word else [word]
        try:
            main(words)
        except SystemExit as end:
            statuses.append(end.code)
    print(json.dumps({"statuses": statuses, "start": multiprocessing.get_start_method()}))
