"""The entry of the command `rig`: a Ctrl-C while the program is still loading ends in one line, not in a traceback."""

from __future__ import annotations

import gc
import io
import os
import sys

from rig.core import ctrl_c
from rig.core.errors import LibraryError

# The matrices here are thin: a second thread of the linear algebra saves nothing, and spins on the loop's core.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")


OBJECTS = 20_000  # new ones between two searches for garbage: 80,000 are made while rig loads, and they stay


def never_stop_at_a_letter() -> None:
    """Print a letter that a terminal or pipe has no code for, such as ±, as a question mark, not as a traceback."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def run() -> None:
    """Load the commands and run the one that was asked for."""
    never_stop_at_a_letter()
    gc.set_threshold(OBJECTS)
    try:
        ctrl_c.begin()
        from rig.cli import main

        main()
    except KeyboardInterrupt:
        sys.stderr.write("rig: interrupted before the bench was opened; nothing has moved\n")
        sys.exit(1)
    except LibraryError as error:
        sys.stderr.write(f"rig: {error}\n")
        sys.exit(1)


if __name__ == "__main__":
    run()
