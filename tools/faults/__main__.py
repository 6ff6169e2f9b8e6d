"""Runs the whole matrix and writes its two pages: `make faults`, or `PYTHONPATH=tools python -m faults`.

A part of it, in virtual time: `python -m faults --only "cable out" --device board --stage pause`: each case is a line.
With --keep these lines take the place of those before, and the pages are written from all lines that are kept.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

from faults import kept, worst
from faults.backends import BACKENDS
from faults.kept import Key, Line, Lines
from faults.matrix import PHASES, in_real_time, in_virtual_time, stages_of
from faults.page import real_rows, render_rows, render_summary
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
    parser.add_argument(
        "--device", choices=[b.key for b in BACKENDS], action="append", help="this device alone; may be given again"
    )
    parser.add_argument("--stage", choices=list(BY_KEY), help="one stage, in virtual time")
    parser.add_argument("--missing", action="store_true", help="only lines that are not kept yet")
    parser.add_argument("--stale", action="store_true", help="only these, and lines that were measured with other code")
    parser.add_argument(
        "--keep", action="store_true", help="of a part: put it into the pages, and keep the other lines"
    )
    parser.add_argument("--accept", action="store_true", help="record what is longer than the recorded worst, too")
    given = parser.parse_args()
    began_s = time.monotonic()
    rows = [row for row in ROWS if given.only in row.name]
    backends = [backend for backend in BACKENDS if given.device is None or backend.key in given.device]
    stages = None if given.stage is None else (BY_KEY[given.stage],)
    is_part = given.only != "" or given.device is not None or stages is not None or given.missing or given.stale
    before, code = kept.read(), kept.code_of()
    here = {key for key, line in before.lines.items() if given.missing or (given.stale and line.code == code)}
    measured: list[Line] = []
    trouble: list[str] = []
    for backend in backends:  # one after another: what is done is kept, should the command be broken off
        lines = in_virtual_time(rows, [backend], given.phases, stages, here)
        measured += lines
        trouble += [words for line in lines for words in line.trouble]
        if given.keep and lines:
            before = before.with_measured(lines, page.today(), code)
            kept.write(before.only(places()))
    if not measured:
        parser.error("no such row on that device in that stage, or none that is missing")
    found = [one for line in measured for one in line.found]
    real = [] if is_part else in_real_time(REAL_PHASES)
    trouble += [
        f"{one.row}, {one.device}, real time, phase {one.phase:.2f}: {words}" for one in real for words in one.trouble
    ]
    before_s = worst.recorded()
    longer = worst.longer(found, before_s)
    print("\n".join(trouble + [f"warning: {words}" for words in longer]), flush=True)
    if not is_part:
        before = replace(kept.NONE, real=real_rows(real)).with_measured(measured, page.today(), code)
    if given.keep or not is_part:
        write_all(before.only(places()))
        worst.write(found, {} if given.accept else before_s, others=is_part)
    if is_part:
        print("\n".join(one.in_words() for one in found))
    cases, took_s = len(found) + len(real), time.monotonic() - began_s
    print(f"{cases} cases, {len(trouble)} not as they should be, {took_s:.0f} s")
    return 1 if trouble else 0


def places() -> set[Key]:
    """Every line of the matrix: row, device, stage."""
    return {
        (row.name, backend.key, stage.key) for backend in BACKENDS for row in ROWS for stage in stages_of(row, backend)
    }


def write_all(lines: Lines) -> None:
    """Keep the lines, and write both pages."""
    kept.write(lines)
    page.write(OUT, render_summary(lines, ROWS, BACKENDS))
    page.write(OUT.with_name(ROWS_NAME), render_rows(lines, ROWS, BACKENDS))


if __name__ == "__main__":
    sys.exit(main())
