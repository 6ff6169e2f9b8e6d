"""`make real-records`: what `rig identify` says of records of real motors, and of made ones, one line for each.

After them: each known number beside rig's, what the records can say at most, siblings, the next record, and each figure
that is asked for, over all motors and with each left out.

RIG_SHARED_DATA names the folder with `real`, `emps` and `cases`. CPU seconds are those of reading and identifying.

    PYTHONPATH=tools python -m real_records [cases|emps|real ...] [--only WORD] [--reasons] [--page]
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.io import loadmat

from real_records.bounds import bounded, tellable
from real_records.known import Known, known_of
from real_records.scores import HEAD as COMPARED
from real_records.scores import Seen, by_published, by_table, left_out, left_out_head, percent
from real_records.siblings import Next, next_record, pairs_that_agree
from rig.identification import IdentifyError, identify
from rig.identification.identification import Identification
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_format import LogColumn, LogFormat
from rig.run_folder.recording.reader import read_all
from rig.run_folder.results import Answer
from shared.page import render, today, write
from shared.table import markdown

DOCS = Path(__file__).resolve().parents[2] / "docs" / "evidence"


def log_of(time: str, drive: str, what: str, column: str, counts: float | None = None) -> LogFormat:
    """A log of PWM of 255 at 12 V, or of volts; ``what`` is position or velocity."""
    pwm = {"full": 255.0, "supply_V": 12.0} if drive == "pwm" else {"full": None, "supply_V": None}
    seen = LogColumn.parse(what, column)
    return LogFormat(
        LogColumn.parse("time", time),
        LogColumn.parse("drive", drive),
        position=seen if what == "position" else None,
        velocity=seen if what == "velocity" else None,
        counts_per_turn=counts,
        full=pwm["full"],
        supply_V=pwm["supply_V"],
    )


BOARD = log_of("us", "pwm", "position", "counts", 1440.0)
CASES: tuple[tuple[str, LogFormat | None], ...] = (
    ("dead_band_1p3V.csv", BOARD),
    ("closedloop.csv", None),
    ("one_way_levels.csv", None),
    ("file_fwd.csv file_rev.csv", None),
    ("steps.csv", None),
    ("unbalance_2p5V.csv", BOARD),
    ("unsigned_drive.csv", BOARD),
    ("lost_counts_fwd2pct.csv", BOARD),
    ("stamp_of_line_before.csv", log_of("us", "volts:V", "position", "counts", 1440.0)),
    ("drift_each_1.csv drift_each_2.csv", None),
    ("demo-refused", None),
    ("vel_lpf5ms.csv", log_of("us", "pwm", "velocity", "vel:rad/s")),
    ("vel_int16.csv", log_of("us", "pwm", "velocity", "vel:counts/s", 8192.0)),
    ("velfilt.csv", log_of("time:s", "voltage:V", "velocity", "rpm:rpm")),
)
KNOWN = ("tau_s", "K_rad_s_V", "fc_V")


class Entry(NamedTuple):
    """A record: its name, its motor, its files, and how they are read."""

    name: str
    motor: str
    paths: tuple[Path, ...]
    log: LogFormat | None


def entries(kind: str, data: Path, scratch: Path) -> Iterator[Entry]:
    """The records of a folder. EMPS is written as CSV first."""
    if kind == "cases":
        for names, log in CASES:
            paths = tuple(data / kind / name for name in names.split())
            if all(path.exists() for path in paths):
                yield Entry(names, names, paths, log)
    elif kind == "emps":
        for file in sorted((data / kind).glob("*.mat")):
            columns = loadmat(str(file))
            table = np.column_stack([np.asarray(columns[k], dtype=float).ravel() for k in ("t", "vir", "qm")])
            made = scratch / f"{file.stem}.csv"
            np.savetxt(made, table, delimiter=",", header="t_s,u_V,y_rad", comments="", fmt="%.12g")
            yield Entry(file.stem, kind, (made,), None)
    else:
        sets: dict[str, list[Path]] = {}
        for path in sorted((data / kind).glob("*.csv")):
            sets.setdefault("tu_A" if path.stem.startswith("tu_A") else path.stem, []).append(path)
        for name, files in sets.items():
            column = files[0].read_text().partition("\n")[0].split(",")[2]
            what, _, unit = column.partition("_")
            unit = {"deg_s": "deg/s", "rad_s": "rad/s"}.get(unit, unit)
            log = log_of("t_s:s", "u_V:V", what, f"{column}:{unit}")
            yield Entry(name, name.partition("_")[0], tuple(files), log)


def identified(entry: Entry) -> tuple[Identification | None, str, float]:
    """What rig identifies, or None with what it says; CPU seconds."""
    before = time.process_time()
    try:
        found = identify([recording for path in entry.paths for recording in read_all(path, entry.log)])
    except (RecordingError, IdentifyError) as error:
        return None, str(error), time.process_time() - before
    return found, "", time.process_time() - before


def line(name: str, found: Identification | None, said: str, cpu_s: float) -> list[str]:
    """One row of the table."""
    answer = None if found is None else found.answer
    if answer is None:
        return [name, f"no answer: {said[:90]}", *[""] * (len(KNOWN) + 2), f"{cpu_s:.1f}"]
    cells = [_number(answer, key) for key in KNOWN]
    share = "-" if answer.predicts is None else f"{answer.predicts.error:.3f}, {answer.predicts.linear_error:.3f}"
    laws = ", ".join(f"{law.name} {law.value:.3g}" for law in answer.law or ())
    return [name, answer.verdict, *cells, share, laws, f"{cpu_s:.1f}"]


def _number(answer: Answer, key: str) -> str:
    grade, value = (answer.grade or {}).get(key), answer.value(key)
    if value is None:
        return "-"
    if grade is None:
        return f"{value:.4g}"
    half = grade.u95
    width = "?" if half is None or not math.isfinite(half) or not value else f"{100.0 * half / abs(value):.2g} %"
    return f"{value:.4g} ± {width} {grade.grade}"


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
    rows: list[list[str]] = []
    records: list[Seen] = []
    with tempfile.TemporaryDirectory() as scratch:
        for kind in given.kinds:
            for entry in entries(kind, data, Path(scratch)):
                if given.only and given.only not in entry.name:
                    continue
                found, said, cpu_s = identified(entry)
                row = line(entry.name, found, said, cpu_s)
                rows.append(row)
                print(" | ".join(row), flush=True)
                if kind != "cases":
                    records.append(Seen(entry.name, entry.motor, found, cpu_s))
                answer = None if found is None else found.answer
                for reason in answer.reasons if given.reasons and answer is not None else ():
                    print("     -", reason, flush=True)
    readme = data / "real" / "README.md"
    tables = tables_of(records, known_of(readme) if readme.exists() else {}) if records else {}
    for what, (head, cells) in tables.items():
        print(f"\n{TITLES[what]}\n\n{markdown(head, cells)}", flush=True)
    if given.page:
        cpu = sorted(float(row[-1]) for row in rows)
        text = render(
            Path(__file__).with_name("real-records.md.j2"),
            made=today(),
            head=HEAD,
            rows=rows,
            tables=tables,
            tellable=tellable(records),
            cpu_90=f"{cpu[min(len(cpu) - 1, int(0.9 * len(cpu)))]:.0f}" if cpu else "-",
        )
        write(DOCS / "real-records.md", text)
    return 0


TITLES = {
    "table": "What the README of the records gives as known",
    "published": "What others published",
    "bounds": "What a record can say at most: half widths at 95 % at the published numbers, relative to them",
    "agreed": "Records of one motor: how many usable numbers of two of them agree",
    "following": "The next record",
    "figures": "The figures that are asked for",
}
Table = tuple[Sequence[str], list[list[str]]]


def tables_of(records: Sequence[Seen], known: Mapping[str, Known]) -> dict[str, Table]:
    """Head and rows of each table of ``TITLES``."""
    by_motor: dict[str, dict[str, Identification]] = {}
    for seen in records:
        if seen.found is not None and seen.answer is not None:
            by_motor.setdefault(seen.motor, {})[seen.name] = seen.found
    following = [one for siblings in by_motor.values() for one in next_records(siblings)]
    at_most = [
        [seen.name, *(f"{percent(own)}, {percent(left)}" for own, left in pairs.values())]
        for seen, pairs in bounded(records)
    ]
    return {
        "table": (COMPARED, [one.cells() for one in by_table(records, known)]),
        "published": (COMPARED, [one.cells() for one in by_published(records)]),
        "bounds": (("record", "tau: by the sensor, by what is left", "K", "f_c"), at_most),
        "agreed": (
            ("motor", "records", "agree", "numbers"),
            [agreement(motor, siblings) for motor, siblings in by_motor.items() if len(siblings) > 1],
        ),
        "following": (("models of", "predict", "rig", "linear", "ARX"), [next_cells(one) for one in following]),
        "figures": (left_out_head(records), left_out(records, known, following)),
    }


def agreement(motor: str, records: Mapping[str, Identification]) -> list[str]:
    """A row: the motor, how many records it has, how many usable numbers of two of them agree, of how many."""
    answers = {name: found.answer for name, found in records.items() if found.answer is not None}
    agree, count = pairs_that_agree(answers)
    return [motor, str(len(records)), str(agree), str(count)]


def next_records(records: Mapping[str, Identification]) -> Iterator[Next]:
    """Each record of a motor predicted by the one before."""
    names = list(records)
    for one, other in pairwise(names):
        found = next_record(records[one], records[other], (one, other))
        if found is not None:
            yield found


def next_cells(one: Next) -> list[str]:
    """A row: both records, and the errors of rig's motor, the linear and the ARX model."""
    errors = (f"{error:.3f}" if error < 1.0 else "> 1" for error in (one.rig, one.linear, one.arx))
    return [one.first, one.second, *errors]


if __name__ == "__main__":
    sys.exit(main())
