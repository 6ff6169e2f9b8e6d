"""The page of an identification of any recordings: the answer, its picture, and what it is made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rig.identification.identification import Identification
from rig.output.report import fitted, tables
from rig.output.report.page import drawn
from rig.output.report.simulated import picture_of
from rig.output.report.source import ReportedRun
from rig.output.report.style import rendered, style
from rig.output.report.words import headline
from rig.run_folder.recording.folder import write_whole
from rig.run_folder.results import RunMeta, RunResult


def write_identified(found: Identification, records: Sequence[str], path: Path) -> None:
    """Write the page into a file. Raises CannotWriteError.

    records  what was read, in words; the first names the page
    """
    result = RunResult(answer=found.answer, estimates=found.as_result().estimates, **found.evidence)
    about = RunMeta(backend=", ".join(records), rehearsal=found.rehearsal or None)
    run = ReportedRun(Path(records[0]), None, about, result, of_recordings=True)
    spread_rad = float(np.std(np.concatenate([test.y_rad for test in found.tests]))) if found.tests else math.nan
    with style():
        figures = {
            "simulated": drawn(picture_of, found, run.foot),
            "residual": drawn(fitted.residuals, run, found.curves, spread_rad),
        }
    page = rendered(
        "rig.output.report",
        "identified.html.j2",
        name=Path(records[0]).name,
        rehearsal=run.rehearsal,
        records=records,
        headline=headline(run),
        figures=figures,
        estimates=tables.estimates(run),
        motor_law=tables.motor_law(run),
        budget=tables.budget(run),
        notes=found.notes,
    )
    write_whole(path, page.encode("utf-8"))
