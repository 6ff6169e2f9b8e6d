"""Runs the whole matrix and writes the page: `make faults`, or `PYTHONPATH=tools python -m faults`."""

from __future__ import annotations

import argparse
import datetime
import gc
import os
import sys
import time
from functools import lru_cache
from pathlib import Path

from joblib import Parallel, delayed

from faults import realtime
from faults.backends import BACKENDS, Backend
from faults.case import Found, measure, undisturbed
from faults.page import Line, render
from faults.realtime import REAL_ROWS, RealFound
from faults.rows import ROWS, Row

OUT = Path("docs/fault-table.md")
REAL_PHASES = 2
_BY_KEY = {backend.key: backend for backend in BACKENDS}
_BY_NAME = {row.name: row for row in ROWS}


def one(name: str, key: str, phases: int, number: int) -> Found:
    """One case; the first phase also tries the next run."""
    _warm(key)
    return measure(_BY_NAME[name], _BY_KEY[key], (number + 0.5) / phases, restarts=number == 0)


@lru_cache
def _warm(key: str) -> None:
    """What is loaded by now stays: collecting it before each arming takes 0.15 s for nothing."""
    undisturbed(_BY_KEY[key])
    gc.freeze()


def in_real_time(phases: int) -> list[RealFound]:
    """Every case of the host's process: a few at a time, they mostly sleep; those that load the machine alone."""
    cases = [(number, k) for number in range(len(REAL_ROWS)) for k in range(phases)]
    together = [case for case in cases if not REAL_ROWS[case[0]].alone]
    found: list[RealFound] = Parallel(n_jobs=3)(delayed(_real)(*case, phases) for case in together)
    return found + [_real(*case, phases) for case in cases if case not in together]


def _real(number: int, k: int, phases: int) -> RealFound:
    return realtime.measure(REAL_ROWS[number], (k + 0.5) / phases, restarts=k == 0)


def main() -> int:
    """Measure, write the page; 1 if anything is not as it should be."""
    parser = argparse.ArgumentParser(prog="faults", description="Run every fault on every emulated device.")
    parser.add_argument("--phases", type=int, default=5, help="of the limit cycle (default: 5)")
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--device", choices=list(_BY_KEY), help="one device alone")
    parser.add_argument("--out", type=Path, default=OUT, help=f"where the page goes (default: {OUT})")
    given = parser.parse_args()
    began_s = time.monotonic()
    rows = [row for row in ROWS if given.only in row.name]
    backends = [backend for backend in BACKENDS if given.device in (None, backend.key)]
    pairs = [(row, backend) for backend in backends for row in rows if backend.key not in row.absent]
    cases = [(row.name, backend.key, given.phases, k) for row, backend in pairs for k in range(given.phases)]
    found = Parallel(n_jobs=os.cpu_count() or 1, batch_size=4)(delayed(one)(*case) for case in cases)
    real = in_real_time(REAL_PHASES) if given.only == "" and given.device is None else []
    lines = [_line(row, backend, found) for row, backend in pairs]
    made = str(datetime.datetime.now(datetime.UTC).date())
    given.out.write_text(render(made, given.phases, lines, rows, backends, real), encoding="utf-8")
    trouble = [words for line in lines for words in line.trouble]
    trouble += [f"{one.row}, real time, phase {one.phase:.2f}: {words}" for one in real for words in one.trouble]
    print("\n".join(trouble))
    took_s = time.monotonic() - began_s
    print(f"{given.out}: {len(cases) + len(real)} cases, {len(trouble)} not as they should be, {took_s:.0f} s")
    return 1 if trouble else 0


def _line(row: Row, backend: Backend, found: list[Found]) -> Line:
    own = tuple(f for f in found if f.row == row.name and f.backend == backend.key)
    return Line(row.on(backend.key), backend, undisturbed(backend).times, own)


if __name__ == "__main__":
    sys.exit(main())
