"""Runs the whole matrix and writes its two pages: `make faults`, or `PYTHONPATH=tools python -m faults`.

A part of it, in virtual time: `python -m faults --only "cable out" --device board --stage pause`: each case is a line.
With --keep these lines take the place of those before, and the pages are written from all lines that are kept.
With --real it is the rows in real time instead: `python -m faults --real --missing --keep`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from faults import kept, worst
from faults.backends import BACKENDS
from faults.kept import Key, Line, Lines
from faults.matrix import PHASES, Unmeasured, in_real_time, in_virtual_time, real_places, stages_of
from faults.page import real_rows, render_rows, render_summary
from faults.realtime import DEVICES, RealDevice, RealFound, RealRow
from faults.rows import ROWS
from faults.stages import BY_KEY
from shared import page

OUT = Path("docs/evidence/fault-table.md")
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
    keys = dict.fromkeys([*(backend.key for backend in BACKENDS), *(device.key for device in DEVICES)])
    parser.add_argument("--device", choices=keys, action="append", help="this device alone; may be given again")
    parser.add_argument("--stage", choices=list(BY_KEY), help="one stage, in virtual time")
    parser.add_argument("--missing", action="store_true", help="only lines that are not kept yet")
    parser.add_argument("--stale", action="store_true", help="only these, and lines that were measured with other code")
    parser.add_argument(
        "--keep", action="store_true", help="of a part: put it into the pages, and keep the other lines"
    )
    parser.add_argument("--real", action="store_true", help="rows in real time, not those in virtual time")
    parser.add_argument("--accept", action="store_true", help="record what is longer than the recorded worst, too")
    given = parser.parse_args()
    if given.real:
        return _in_real_time(given, parser)
    began_s = time.monotonic()
    rows = [row for row in ROWS if given.only in row.name]
    backends = [backend for backend in BACKENDS if given.device is None or backend.key in given.device]
    stages = None if given.stage is None else (BY_KEY[given.stage],)
    is_part = given.only != "" or given.device is not None or stages is not None or given.missing or given.stale
    before, before_s, code = kept.read(), worst.recorded(), kept.code_of()
    may_be_s = {} if given.accept else before_s
    here = {key for key, line in before.lines.items() if given.missing or (given.stale and line.code == code)}
    measured: list[Line] = []
    trouble: list[str] = []
    for backend in backends:  # one after another: what is done is kept, should the command be broken off
        lines = in_virtual_time(rows, [backend], given.phases, stages, here)
        measured += lines
        trouble += [words for line in lines for words in line.trouble]
        if given.keep and lines:
            now = kept.read().with_measured(
                lines, page.today(), code
            )  # and what another command has measured meanwhile
            write_all(now.only(places()))
            worst.write([one for line in lines for one in line.found], may_be_s, others=True)
    if not measured:
        parser.error("no such row on that device in that stage, or none that is missing")
    found = [one for line in measured for one in line.found]
    tried = [] if is_part else list(in_real_time(real_places(), REAL_PHASES))
    real = [one for one in tried if isinstance(one, RealFound)]
    trouble += _real_trouble(tried)
    longer = worst.longer(found, before_s)
    print("\n".join(trouble + [f"warning: {words}" for words in longer]), flush=True)
    if is_part:
        print("\n".join(one.in_words() for one in found))
    else:
        now = kept.NONE.with_real(real_rows(real), _names(real_places())).with_measured(measured, page.today(), code)
        write_all(now.only(places()))
        worst.write(found, may_be_s)
    cases, took_s = len(found) + len(real), time.monotonic() - began_s
    print(f"{cases} cases, {len(trouble)} not as they should be, {took_s:.0f} s")
    return 1 if trouble else 0


def _in_real_time(given: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    """A part of the rows in real time; with --keep each is kept as soon as it was measured. 1 if anything is wrong."""
    if given.stage or given.stale:
        parser.error("rows in real time have no stages, and are not known to be stale")
    here = {tuple(cells[:2]) for cells in kept.read().real if given.missing}
    wanted = [
        (row, device)
        for row, device in real_places()
        if given.only in row.name
        and (given.device is None or device.key in given.device)
        and (row.name, device.key) not in here
    ]
    if not wanted:
        parser.error("no such row in real time on that device, or none that is missing")
    trouble = 0
    for found in in_real_time(wanted, REAL_PHASES):
        words = _real_trouble([found])
        trouble += len(words)
        if isinstance(found, RealFound):
            words = [*map(str, real_rows([found])), *words]
            if given.keep:
                write_all(kept.read().with_real(real_rows([found]), _names(real_places())).only(places()))
        print("\n".join(words), flush=True)
    print(f"{len(wanted)} cases, {trouble} not as they should be")
    return 1 if trouble else 0


def _names(found: Iterable[tuple[RealRow, RealDevice]]) -> list[tuple[str, str]]:
    return [(row.name, device.key) for row, device in found]


def _real_trouble(found: Iterable[RealFound | Unmeasured]) -> list[str]:
    return [
        f"{one.row}, {one.device}, real time: {words}"
        for one in found
        for words in (one.trouble if isinstance(one, RealFound) else [one.why])
    ]


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
