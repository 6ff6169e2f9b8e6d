"""Runs the whole matrix and writes its two pages: `make faults`, or `PYTHONPATH=tools python -m faults`.

A part of it, in virtual time: `python -m faults --only "cable out" --device board --stage pause`; pages are then
written only where --out says so, and each case is a line.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from faults import worst
from faults.backends import BACKENDS
from faults.matrix import PHASES, in_real_time, in_virtual_time
from faults.page import render_rows, render_summary
from faults.rows import ROWS
from faults.stages import BY_KEY
from shared import page

OUT = Path("docs/fault-table.md")
ROWS_NAME = "fault-rows.md"  # beside it
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
    parser.add_argument("--stage", choices=list(BY_KEY), help="one stage, in virtual time")
    parser.add_argument("--out", type=Path, help=f"where the page goes (default: {OUT}, of a part nowhere)")
    parser.add_argument("--accept", action="store_true", help="record what is longer than the recorded worst, too")
    given = parser.parse_args()
    began_s = time.monotonic()
    rows = [row for row in ROWS if given.only in row.name]
    backends = [backend for backend in BACKENDS if given.device in (None, backend.key)]
    stages = None if given.stage is None else (BY_KEY[given.stage],)
    is_part = given.only != "" or given.device is not None or stages is not None
    if is_part and given.out == OUT:
        parser.error(f"a part of the table would replace {OUT}: name another file with --out")
    lines = in_virtual_time(rows, backends, given.phases, stages)
    if not lines:
        parser.error("no such row on that device in that stage")
    found = [one for line in lines for one in line.found]
    real = [] if is_part else in_real_time(REAL_PHASES)
    trouble = [words for line in lines for words in line.trouble]
    trouble += [
        f"{one.row}, {one.device}, real time, phase {one.phase:.2f}: {words}" for one in real for words in one.trouble
    ]
    before_s = worst.recorded()
    longer = worst.longer(found, before_s)
    print("\n".join(trouble + [f"warning: {words}" for words in longer]), flush=True)
    out = given.out or (None if is_part else OUT)
    if out is not None:
        made = page.today()
        page.write(out, render_summary(made, lines, backends))
        page.write(out.with_name(ROWS_NAME), render_rows(made, lines, rows, backends, real))
    if is_part:
        print("\n".join(one.in_words() for one in found))
    else:
        worst.write(found, {} if given.accept else before_s)
    cases, took_s = len(found) + len(real), time.monotonic() - began_s
    print(f"{out or 'no page'}: {cases} cases, {len(trouble)} not as they should be, {took_s:.0f} s")
    return 1 if trouble else 0


if __name__ == "__main__":
    sys.exit(main())
