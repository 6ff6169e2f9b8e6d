"""Runs the whole matrix and writes the page: `make faults`, or `PYTHONPATH=tools python -m faults`."""

from __future__ import annotations

import argparse
import datetime
import sys
import time
from pathlib import Path

from faults.backends import BACKENDS
from faults.matrix import PHASES, in_real_time, in_virtual_time
from faults.page import render
from faults.rows import ROWS
from rig.recording.folder import write_whole

OUT = Path("docs/fault-table.md")
REAL_PHASES = 1


def main() -> int:
    """Measure, write the page; 1 if anything is not as it should be."""
    parser = argparse.ArgumentParser(prog="faults", description="Run every fault on every emulated device.")
    parser.add_argument(
        "--phases",
        type=int,
        default=PHASES,
        help=f"of the limit cycle, a quarter of them on the devices that differ in the link alone (default: {PHASES})",
    )
    parser.add_argument("--only", default="", help="rows whose name contains this, in virtual time")
    parser.add_argument("--device", choices=[backend.key for backend in BACKENDS], help="one device, in virtual time")
    parser.add_argument("--out", type=Path, default=OUT, help=f"where the page goes (default: {OUT})")
    given = parser.parse_args()
    began_s = time.monotonic()
    rows = [row for row in ROWS if given.only in row.name]
    backends = [backend for backend in BACKENDS if given.device in (None, backend.key)]
    if not any(row.is_for(backend.traits) for row in rows for backend in backends):
        parser.error(f"no row with {given.only!r} in its name is for that device")
    is_part = given.only != "" or given.device is not None
    if is_part and given.out == OUT:
        parser.error(f"a part of the table would replace {OUT}: name another file with --out")
    lines = in_virtual_time(rows, backends, given.phases)
    real = [] if is_part else in_real_time(REAL_PHASES)
    made = str(datetime.datetime.now(datetime.UTC).date())
    write_whole(given.out, render(made, lines, rows, backends, real).encode("utf-8"))
    trouble = [words for line in lines for words in line.trouble]
    trouble += [
        f"{one.row}, {one.device}, real time, phase {one.phase:.2f}: {words}" for one in real for words in one.trouble
    ]
    cases, took_s = sum(len(line.found) for line in lines) + len(real), time.monotonic() - began_s
    print("\n".join(trouble))
    print(f"{given.out}: {cases} cases, {len(trouble)} not as they should be, {took_s:.0f} s")
    return 1 if trouble else 0


if __name__ == "__main__":
    sys.exit(main())
