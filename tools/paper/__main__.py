"""Writes the report: `make paper`, or `PYTHONPATH=tools python -m paper`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from paper.build import build

OUT = Path("build/paper/report.html")


def main() -> int:
    """Build it, show the way, print its path."""
    parser = argparse.ArgumentParser(prog="paper", description="Redo the paper's examples and write one HTML report.")
    parser.add_argument("--out", type=Path, default=OUT, help=f"where the report goes (default: {OUT})")
    parser.add_argument("--quick", action="store_true", help="fewer trials and coarser maps: for a look at the page")
    given = parser.parse_args()
    print(f"report: {build(given.out, quick=given.quick, say=lambda line: print(line, flush=True))}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
