"""Runs every mutant and writes the page: `make mutants`, or `PYTHONPATH=tools python -m mutants`."""

from __future__ import annotations

import argparse
import fcntl
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from mutants.mutant import Mutant
from mutants.named import rooms as named_rooms
from mutants.page import render
from mutants.rooms import EQUIVALENT, SEED
from mutants.rooms import ROOMS as DRAWN_ROOMS
from mutants.sampled import draw
from mutants.session import CAUGHT, SURVIVED, Result, Session, State
from mutants.workshop import Workshop
from shared import page

OUT = Path("docs/evidence/mutant-table.md")
FOLDER = Path("build/mutants")


def main() -> int:
    """Run what is not known yet, write the page; 1 if anything is not as it should be."""
    parser = argparse.ArgumentParser(
        prog="mutants", description="Put defects in, one at a time; each must fail a test."
    )
    parser.add_argument("--only", default="", help="mutants whose name, file or function contains this")
    rooms = [room.folder for room in DRAWN_ROOMS]
    parser.add_argument(
        "--part", choices=("named", "random", *rooms), help="one part of the table; of the random a room"
    )
    parser.add_argument(
        "--no-suite", action="store_true", help="a named mutant that its tests let pass survives at once"
    )
    parser.add_argument("--out", type=Path, default=OUT, help=f"where the page goes (default: {OUT})")
    given = parser.parse_args()
    is_part = given.only != "" or given.part is not None
    for number in (signal.SIGTERM, signal.SIGINT):  # what runs ends with it, also in the background
        signal.signal(number, signal.default_int_handler)
    FOLDER.mkdir(parents=True, exist_ok=True)
    with (FOLDER / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            parser.error(f"another run works in {FOLDER}")
        began_s = time.monotonic()
        root = Path.cwd()
        named = _chosen(named_rooms() if given.part in (None, "named") else {}, given.only)
        drawn = _chosen(
            {
                room.folder: draw(root, room, SEED)
                for room in DRAWN_ROOMS
                if given.part in (None, "random", room.folder)
            },
            given.only,
        )
        workshop = Workshop(root, FOLDER)
        workshop.prepare()
        state = State(FOLDER / "state.jsonl")
        results = Session(workshop, state, with_suite=not given.no_suite).run(_flat(named))
        results |= Session(workshop, state, with_suite=False).run(_flat(drawn))
    trouble = wrong(_flat(named), _flat(drawn), results, EQUIVALENT, complete=not is_part)
    if not is_part or given.out != OUT:
        page.write(given.out, render(page.today(), named, drawn, results, EQUIVALENT))
    print("\n".join(trouble))
    print(f"{len(results)} mutants, {len(trouble)} not as they should be, {time.monotonic() - began_s:.0f} s")
    return 1 if trouble else 0


def wrong(
    named: Sequence[Mutant],
    drawn: Sequence[Mutant],
    results: Mapping[str, Result],
    equivalent: Mapping[str, str],
    *,
    complete: bool,
) -> list[str]:
    """What is not as it should be, a line each; ``complete``: these are all mutants."""
    lines = []
    for mutant in (*named, *drawn):
        result = results[mutant.name]
        is_same = mutant.name in equivalent and mutant in drawn
        if result.outcome in CAUGHT:
            if is_same:
                lines.append(f"{mutant.name}: called equivalent, but caught by {', '.join(result.by)}")
        elif not (is_same and result.outcome == SURVIVED):
            lines.append(f"{mutant.name}: {result.outcome} {', '.join(result.by)}".rstrip())
    if complete:
        names = {mutant.name for mutant in drawn}
        lines += [f"{name}: called equivalent, but not drawn" for name in equivalent if name not in names]
    return lines


def _chosen(rooms: Mapping[str, Sequence[Mutant]], only: str) -> dict[str, list[Mutant]]:
    return {
        room: [mutant for mutant in mutants if only in f"{mutant.name} {mutant.path} {mutant.function}"]
        for room, mutants in rooms.items()
    }


def _flat(rooms: Mapping[str, Sequence[Mutant]]) -> list[Mutant]:
    return [mutant for mutants in rooms.values() for mutant in mutants]


if __name__ == "__main__":
    sys.exit(main())
