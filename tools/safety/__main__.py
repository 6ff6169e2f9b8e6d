"""Measures every promise and writes the page: `make safety`, or `PYTHONPATH=tools python -m safety`."""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import time
from pathlib import Path

from rig.backends.serial.emulated.firmware_build import build_chip, source_folder
from safety import garbage
from safety.page import Found, is_kept, render, row
from safety.promises import PROMISES, measure
from shared import page

OUT = Path("docs/safety-table.md")
BAUDS = (115200, 1_000_000)


def chip_load(baud: int) -> tuple[bool, str]:
    """What `make size` says, and whether it found all within its bounds."""
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    command = ["make", "-s", "-C", str(source_folder()), "size", f"BAUD={baud}"]
    made = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return made.returncode == 0, made.stdout + made.stderr


def main() -> int:
    """Measure, write the page; 1 if a bound is broken."""
    parser = argparse.ArgumentParser(prog="safety", description="Measure every safety promise of the Uno's firmware.")
    parser.add_argument("--phases", type=int, default=200, help="random phases of each row (default: 200)")
    parser.add_argument("--out", type=Path, default=OUT, help=f"where the page goes (default: {OUT})")
    given = parser.parse_args()
    began_s = time.monotonic()
    digest = hashlib.sha256(build_chip().hex.read_bytes()).hexdigest()[:12]
    made = f"{page.today()}, `rig_uno.hex` with SHA-256 {digest}..."
    rows = []
    for promise in PROMISES:
        rows.append(measure(promise, given.phases))
        print(*row(rows[-1]), sep=" | ", flush=True)
    thrown = [garbage.throw(baud, 100 * given.phases) for baud in BAUDS]
    errors, guesses = garbage.errors(10 * given.phases), garbage.guesses(1311 * given.phases)
    loads = {baud: chip_load(baud) for baud in BAUDS}
    chip = {baud: text for baud, (_, text) in loads.items()}
    found = Found(made, rows, thrown, errors, guesses, chip)
    page.write(given.out, render(found))
    kept = is_kept(found) and all(is_well for is_well, _ in loads.values())
    print(f"{given.out}: {'all bounds hold' if kept else 'A BOUND IS BROKEN'}, {time.monotonic() - began_s:.0f} s")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
