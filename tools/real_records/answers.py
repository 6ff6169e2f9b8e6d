"""Whether a faster rig still says the same: answers of one code kept, and those of another held against them.

Records of real motors, EMPS, golden runs and motors of the campaign with departures. Two answers are alike if each of
tau, K and friction is within a tenth of its interval, the interval is as wide within a tenth, and verdict and laws are
the same.

    PYTHONPATH=tools python -m real_records.answers keep old.json [real emps golden campaign ...] [--motors N]
    PYTHONPATH=tools python -m real_records.answers compare old.json new.json
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from campaign_real.kinds import case
from campaign_real.rows import kinds_of
from real_records.__main__ import entries
from rig.config.load import load_campaign
from rig.identification import IdentifyError, identify
from rig.identification.verdict import largest_drive_V, sizes_of
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.reader import read_all
from rig.run_folder.recording.recording import Recording
from shared.table import markdown

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden"
CONFIG = ROOT / "config" / "campaign-real.yaml"
SEEDS = (16, 21)
SHARE = 0.1  # of an interval: what a number may move by
Kept = dict[str, Any]


def records(kinds: Sequence[str], motors: int, scratch: Path) -> Iterator[tuple[str, Callable[[], list[Recording]]]]:
    """Name and reader of each record of these kinds; ``motors``: how many of the campaign for each seed."""
    data = Path(os.environ.get("RIG_SHARED_DATA", ""))
    for kind in kinds:
        if kind == "golden":
            for folder in sorted(path for path in GOLDEN.iterdir() if path.is_dir()):
                yield f"golden {folder.name}", lambda folder=folder: read_all(folder, None)  # type: ignore[misc]
        elif kind == "campaign":
            for seed in SEEDS:
                campaign = load_campaign(CONFIG).model_copy(update={"seed": seed})
                for number in range(motors):
                    one = case(campaign, number, kinds_of(number, False, seed))
                    yield f"campaign {seed} {number}", one.recordings
        else:
            for entry in entries(kind, data, scratch):
                yield (
                    f"{kind} {entry.name}",
                    lambda entry=entry: [r for path in entry.paths for r in read_all(path, entry.log)],  # type: ignore[misc]
                )


def answered(read: Callable[[], list[Recording]]) -> Kept:
    """What rig says of a record, as it is kept, and CPU seconds."""
    before = time.process_time()
    try:
        found = identify(read())
    except (RecordingError, IdentifyError) as error:
        return {"verdict": "none", "said": str(error), "cpu_s": time.process_time() - before}
    cpu_s = time.process_time() - before
    answer, leading = found.answer, found.leading
    if answer is None or leading is None:
        return {"verdict": "none", "said": "no answer", "cpu_s": cpu_s}
    sizes = sizes_of(leading, largest_drive_V(found.tests)) if leading.is_motor else {}
    grade = answer.grade or {}
    return {
        "verdict": answer.verdict,
        "values": {name: getattr(leading, name) for name in sizes},
        "u95": {name: None if name not in grade else grade[name].u95 for name in sizes},
        "size": sizes,
        "laws": sorted(law.name for law in answer.law or ()),
        "predicts": None if answer.predicts is None else answer.predicts.error,
        "reasons": list(answer.reasons),
        "cpu_s": cpu_s,
    }


def keep(file: Path, kinds: Sequence[str], motors: int) -> None:
    """Write the answers, one after the other, so that an end in between loses none."""
    found: dict[str, Kept] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for name, read in records(kinds, motors, Path(scratch)):
            found[name] = answered(read)
            print(f"{name}: {found[name]['verdict']}, {found[name]['cpu_s']:.2f} s", flush=True)
            file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def moved(old: Kept, new: Kept) -> dict[str, float]:
    """By how much of its interval each number moved, and by what share the interval changed; the larger one of both."""
    found = {}
    for name, value in old.get("values", {}).items():
        half, other = old["u95"].get(name), new.get("u95", {}).get(name)
        if half is None or other is None or not (math.isfinite(half) and math.isfinite(other)):
            found[name] = 0.0 if half == other else math.inf
            continue
        found[name] = max(abs(new["values"][name] - value) / half, abs(math.log(other / half)))
    return found


def compared(old: Mapping[str, Kept], new: Mapping[str, Kept]) -> tuple[list[list[str]], int]:
    """A row for each record of both, and how many are not alike."""
    rows, differing = [], 0
    for name in [one for one in old if one in new]:
        a, b = old[name], new[name]
        shares = moved(a, b)
        words = [f"{key}: {a.get(key)} -> {b.get(key)}" for key in ("verdict", "laws") if a.get(key) != b.get(key)]
        words += [f"{key} by {share:.2g}" for key, share in shares.items() if not share <= SHARE]
        differing += bool(words)
        most = max(shares.values(), default=0.0)
        rows.append([name, f"{a['cpu_s']:.2f}", f"{b['cpu_s']:.2f}", f"{most:.2g}", "; ".join(words)])
    return rows, differing


def main(argv: Sequence[str] | None = None) -> int:
    """Keep, or compare: exit status 1 if answers differ."""
    parser = argparse.ArgumentParser(prog="python -m real_records.answers", description=__doc__)
    parser.add_argument("what", choices=("keep", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("more", nargs="*", help="kinds to keep, or the other file")
    parser.add_argument("--motors", type=int, default=20)
    given = parser.parse_args(argv)
    if given.what == "keep":
        keep(given.file, given.more or ["real", "emps", "golden", "campaign"], given.motors)
        return 0
    old, new = (json.loads(Path(file).read_text(encoding="utf-8")) for file in (given.file, *given.more))
    rows, differing = compared(old, new)
    head = ("record", "CPU before, s", "after, s", "moved, of its interval", "what differs")
    print(f"{markdown(head, rows)}\n\n{differing} of {len(rows)} differ")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
