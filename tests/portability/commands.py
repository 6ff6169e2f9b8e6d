"""Commands of rig one after the other in one process, each an argument of this module: what they exit with, at its end."""

from __future__ import annotations

import json
import multiprocessing
import shlex
import sys

from rig.cli import main

if __name__ == "__main__":
    statuses = []
    for line in sys.argv[1:]:
        try:
            main(shlex.split(line))
        except SystemExit as end:
            statuses.append(end.code)
    print(json.dumps({"statuses": statuses, "start": multiprocessing.get_start_method()}))
