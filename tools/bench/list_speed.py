"""`rig list` of a thousand runs, with and without its index, beside reading all of them plainly.

Plainly: `json.loads` of each meta.json and result.json, and nothing else. All three read the same folder in one run.

    PYTHONPATH=tools python -m bench.list_speed [--runs 1000] [--json]
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.benchmark import options, tell
from rig.run_folder.catalogue import INDEX, catalogue
from rig.run_folder.recording.folder import META, RESULT, json_text, write_whole
from rig.run_folder.results import (
    BudgetEntry,
    EstimateResult,
    FoundLawResult,
    RunMeta,
    RunResult,
    ScriptCall,
    TrackingResult,
    answer_of,
)
from shared.table import markdown

PLAINLY = "json.loads of all"
VALUES: dict[str, Any] = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48}
MATRIX = ((1e-6,) * 5,) * 5


def make(folder: Path, runs: int) -> None:
    """So many run folders, as long as a run's files are."""
    estimate = EstimateResult(**VALUES, covariance=MATRIX, correlation=MATRIX, verdict="ok", rows=(0, 2000))
    estimates = dict.fromkeys(("sampled-data", "triple-relay", "describing-function"), estimate)
    result = RunResult(
        backend="simulated",
        answer=answer_of(
            estimates, estimate, (FoundLawResult(name="dead_band", value=0.05, unit="V", ci95=(0.04, 0.06)),)
        ),
        estimates=estimates,
        tracking={"sampled-data": TrackingResult(rms_rad=0.004, max_rad=0.01)},
        budget=tuple(BudgetEntry(source=f"law {k}", **VALUES) for k in range(20)),
        notes=("a note as long as such notes are, with a row and a number or two in it",) * 20,
    )
    for number in range(runs):
        run = folder / f"20261123T{number:06d}Z-run-bench"
        run.mkdir()
        meta = RunMeta(name="bench", started_utc="2026-11-23T12:00:00+00:00", script=ScriptCall(name="run"))
        write_whole(run / META, json_text(meta))
        write_whole(run / RESULT, json_text(result))


def measure(runs: int) -> dict[str, float]:
    """Seconds that each way takes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make(folder, runs)

        def plainly() -> None:
            for run in folder.iterdir():
                for file in (META, RESULT):
                    json.loads((run / file).read_text(encoding="utf-8"))

        catalogue(folder)  # what is loaded at first is no part of any way
        (folder / INDEX).unlink()
        ways: dict[str, Callable[[], object]] = {
            PLAINLY: plainly,
            "rig list, no index": lambda: catalogue(folder),
            "rig list, with its index": lambda: catalogue(folder),
        }
        found = {}
        for way, read in ways.items():
            began = time.process_time()
            read()
            found[way] = time.process_time() - began
        return found


def main() -> int:
    """Measure, and tell it."""
    parser = options(__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    given = parser.parse_args()
    found = measure(given.runs)
    rows = [(way, f"{s:.2f}", f"{s / found[PLAINLY]:.2f}") for way, s in found.items()]
    text = markdown((f"{given.runs} runs", "s of processor time", "of reading plainly"), rows)
    told = {"runs": given.runs, **{way: {"s": s, "ratio": s / found[PLAINLY]} for way, s in found.items()}}
    tell(told, as_json=given.json, text=text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
