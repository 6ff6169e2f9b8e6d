"""`make real-records`: what `rig identify` says of records of real motors, and of made ones, one line for each.

RIG_SHARED_DATA names the folder with `real`, `emps` and `cases`. Each record is identified in a process of its own, as
the command does it, and its CPU seconds are taken.

    PYTHONPATH=tools python -m real_records [cases|emps|real ...] [--only WORD] [--page]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.io import loadmat

from shared.page import today, write
from shared.table import markdown

DOCS = Path(__file__).resolve().parents[2] / "docs" / "evidence"
LOG = [
    "--time",
    "us",
    "--drive",
    "pwm",
    "--full",
    "255",
    "--supply-V",
    "12",
    "--position",
    "counts",
    "--counts-per-turn",
    "1440",
]
SPEED = ["--time", "us", "--drive", "pwm", "--full", "255", "--supply-V", "12", "--velocity"]
CASES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("dead_band_1p3V.csv", (*LOG,)),
    ("closedloop.csv", ()),
    ("one_way_levels.csv", ()),
    ("file_fwd.csv file_rev.csv", ()),
    ("steps.csv", ()),
    ("unbalance_2p5V.csv", (*LOG,)),
    ("unsigned_drive.csv", (*LOG,)),
    ("lost_counts_fwd2pct.csv", (*LOG,)),
    ("stamp_of_line_before.csv", ("--time", "us", "--drive", "volts:V", *LOG[-4:])),
    ("drift_each_1.csv drift_each_2.csv", ()),
    ("demo-refused", ()),
    ("vel_lpf5ms.csv", (*SPEED, "vel:rad/s")),
    ("velfilt.csv", ("--time", "time:s", "--drive", "voltage:V", "--velocity", "rpm:rpm")),
)
KNOWN = ("tau_s", "K_rad_s_V", "fc_V")


class Entry(NamedTuple):
    """A record: its name, and what `rig identify` is given."""

    name: str
    arguments: tuple[str, ...]


def entries(kind: str, data: Path, scratch: Path) -> Iterator[Entry]:
    """The records of a folder. EMPS is written as CSV first."""
    if kind == "cases":
        for names, options in CASES:
            files = tuple(str(data / kind / name) for name in names.split())
            if all(Path(file).exists() for file in files):
                yield Entry(names, (*files, *options))
    elif kind == "emps":
        for file in sorted((data / kind).glob("*.mat")):
            columns = loadmat(str(file))
            table = np.column_stack([np.asarray(columns[k], dtype=float).ravel() for k in ("t", "vir", "qm")])
            made = scratch / f"{file.stem}.csv"
            np.savetxt(made, table, delimiter=",", header="t_s,u_V,y_rad", comments="", fmt="%.12g")
            yield Entry(file.stem, (str(made),))
    else:
        sets: dict[str, list[str]] = {}
        for file in sorted((data / kind).glob("*.csv")):
            name = file.stem
            sets.setdefault("tu_A" if name.startswith("tu_A") else name, []).append(str(file))
        for name, each in sets.items():
            head = Path(each[0]).read_text().partition("\n")[0].split(",")
            what, _, unit = head[2].partition("_")
            flag = f"--{what}"
            unit = {"deg_s": "deg/s"}.get(unit, unit)
            yield Entry(name, (*each, "--time", "t_s:s", "--drive", "u_V:V", flag, f"{head[2]}:{unit}"))


def identified(entry: Entry) -> tuple[dict[str, Any] | None, str, float]:
    """The result as JSON, or None with what the command said; CPU seconds."""
    rig = Path(sys.executable).with_name("rig")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [str(rig), "identify", *entry.arguments, "--json"], capture_output=True, text=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    try:
        return json.loads(done.stdout), done.stderr, cpu_s
    except json.JSONDecodeError:
        return None, (done.stderr or done.stdout).strip(), cpu_s


def line(name: str, found: dict[str, Any] | None, said: str, cpu_s: float) -> list[str]:
    """One row of the table."""
    answer = None if found is None else found.get("answer")
    if answer is None:
        return [name, f"no answer: {said[:90]}", *[""] * (len(KNOWN) + 2), f"{cpu_s:.1f}"]
    grades = answer.get("grade") or {}
    cells = [_number(answer, key, grades.get(key)) for key in KNOWN]
    predicts = answer.get("predicts") or {}
    share = "-"
    if predicts:
        share = f"{predicts['error']:.3f}, {predicts['linear_error']:.3f}"
    laws = ", ".join(f"{law['name']} {law['value']:.3g}" for law in answer.get("law") or ())
    return [name, answer["verdict"], *cells, share, laws, f"{cpu_s:.1f}"]


def _number(answer: dict[str, Any], key: str, grade: dict[str, Any] | None) -> str:
    value = answer.get(key)
    if value is None:
        return "-"
    half = (answer.get("u95") or {}).get(key) if grade is None else grade.get("u95")
    if grade is not None and grade.get("value") is not None:
        value = grade["value"]
    width = "?" if half is None or not math.isfinite(half) or not value else f"{100.0 * half / abs(value):.2g} %"
    return f"{value:.4g} ± {width}" + ("" if grade is None else f" {grade['grade']}")


HEAD = ("record", "verdict", "tau, s", "K, (rad/s)/V", "f_c, V", "held-out error: rig, linear", "laws", "CPU, s")


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; with --page write it, too. Exit status 2 without the data."""
    parser = argparse.ArgumentParser(prog="make real-records", description=__doc__)
    parser.add_argument("kinds", nargs="*", default=["cases", "emps", "real"])
    parser.add_argument("--only", default="")
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--reasons", action="store_true")
    given = parser.parse_args(argv)
    data = Path(os.environ.get("RIG_SHARED_DATA", ""))
    if not os.environ.get("RIG_SHARED_DATA") or not data.is_dir():
        print("RIG_SHARED_DATA must name the folder with real, emps and cases", file=sys.stderr)
        return 2
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for kind in given.kinds:
            for entry in entries(kind, data, Path(scratch)):
                if given.only and given.only not in entry.name:
                    continue
                found, said, cpu_s = identified(entry)
                row = line(entry.name, found, said, cpu_s)
                rows.append(row)
                print(" | ".join(row), flush=True)
                answer = None if found is None else found.get("answer")
                if given.reasons and answer is not None:
                    for reason in answer["reasons"]:
                        print("     -", reason, flush=True)
    if given.page:
        text = f"# Records of real motors\n\nMade by `make real-records` on {today()}.\n\n{markdown(HEAD, rows)}\n"
        write(DOCS / "real-records.md", text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
