"""Measures every promise and writes the page: `make safety`, or `PYTHONPATH=tools python -m safety`."""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import time
from pathlib import Path

from emulated_chips.build import build_chip
from rig.backends.serial.emulated.firmware_build import build_pico, source_folder
from safety import garbage
from safety.driven_chip import PICO
from safety.page import Found, is_kept, render, render_pico, replaced, row
from safety.promises import PICO_PROMISES, PROMISES, Measured, measure
from shared import page
from shared.cases import in_order

OUT = {"uno": Path("docs/evidence/safety-table.md"), "pico": Path("docs/evidence/safety-table-pico.md")}
PHASES = {"uno": 200, "pico": 20}  # the Pico's emulator takes longer
BAUDS = (115200, 1_000_000)
_PROMISES = {"uno": PROMISES, "pico": PICO_PROMISES}


def chip_load(baud: int) -> tuple[bool, str]:
    """What `make size` says, and whether it found all within its bounds."""
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    command = ["make", "-s", "-C", str(source_folder()), "size", f"BAUD={baud}"]
    made = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return made.returncode == 0, made.stdout + made.stderr


def main() -> int:
    """Measure, write the page; 1 if a bound is broken."""
    parser = argparse.ArgumentParser(prog="safety", description="Measure every safety promise of a board's firmware.")
    parser.add_argument("--board", choices=list(OUT), default="uno", help="which board (default: uno)")
    parser.add_argument(
        "--phases", type=int, help="random phases of each row (default: 200 of the Uno, 20 of the Pico)"
    )
    parser.add_argument("--only", default="", help="rows whose name contains this; they take their place in the page")
    parser.add_argument(
        "--out", type=Path, help="where the page goes (default: docs/evidence/safety-table.md or its like)"
    )
    given = parser.parse_args()
    began_s = time.monotonic()
    out, phases = given.out or OUT[given.board], given.phases or PHASES[given.board]
    if given.only:
        if not out.exists():
            parser.error(
                f"--only replaces rows of a page, and {out} does not exist: copy {OUT[given.board]} there first"
            )
        text, kept = _part(given.board, phases, given.only, out.read_text(encoding="utf-8"))
    else:
        text, kept = _uno(phases) if given.board == "uno" else _pico(phases)
    page.write(out, text)
    print(f"{out}: {'all bounds hold' if kept else 'A BOUND IS BROKEN'}, {time.monotonic() - began_s:.0f} s")
    return 0 if kept else 1


def _made(path: Path) -> str:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    return f"{page.today()}, `{path.name}` with SHA-256 {digest}..."


def _measured(board: str, phases: int, only: str = "") -> list[Measured]:
    """Every promise of a board whose name contains that, spread over the cores."""
    numbers = [k for k, promise in enumerate(_PROMISES[board]) if only in promise.what]
    return in_order(_one, [(board, k, phases) for k in numbers])


def _part(board: str, phases: int, only: str, text: str) -> tuple[str, bool]:
    """The page with some rows measured anew, and whether their bounds hold. Raises ValueError where there is none."""
    rows = _measured(board, phases, only)
    if not rows:
        raise ValueError(f"no row's name contains {only!r}")
    made = _made(build_chip().hex if board == "uno" else build_pico())
    return replaced(text, [row(one) for one in rows], made), all(one.late == 0 for one in rows)


def _one(board: str, k: int, phases: int) -> Measured:
    found = measure(_PROMISES[board][k], phases)
    print(*row(found), sep=" | ", flush=True)
    return found


def _uno(phases: int) -> tuple[str, bool]:
    """The page, and whether no bound is broken."""
    rows = _measured("uno", phases)
    thrown = [garbage.throw(baud, 100 * phases) for baud in BAUDS]
    errors, guesses = garbage.errors(10 * phases), garbage.guesses(1311 * phases)
    loads = {baud: chip_load(baud) for baud in BAUDS}
    chip = {baud: text for baud, (_, text) in loads.items()}
    found = Found(_made(build_chip().hex), rows, thrown, errors, guesses, chip)
    return render(found), is_kept(found) and all(is_well for is_well, _ in loads.values())


def _pico(phases: int) -> tuple[str, bool]:
    """As ``_uno``."""
    rows = _measured("pico", phases)
    thrown = [garbage.throw(baud, 100 * phases, stand=PICO) for baud in BAUDS]
    kept = all(one.late == 0 for one in rows) and all(one.moves == 0 for one in thrown)
    return render_pico(_made(build_pico()), rows, thrown), kept


if __name__ == "__main__":
    sys.exit(main())
