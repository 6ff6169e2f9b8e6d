"""The uncertainty budget of a run, with its sources in words."""

from __future__ import annotations

from dataclasses import replace

from rig.core.calibration import CALIBRATION_ERROR_RAD, SUPPLY_ERROR_PERCENT
from rig.identification.departures import BY_NAME
from rig.output.report.source import ReportedRun
from rig.run_folder.results.budget_lines import BudgetLine, budget_lines, that_matter

IN_WORDS = {
    "u95": "together, in the bench's volts and radians",
    "u95_absolute": "together, in true volts and radians",
    "scatter": "scatter of the fit",
    "supply": "motor supply, as stated",
    "calibration": "calibrated angles, as stated",
    "clock": "clock",
    **{name: law.title for name, law in BY_NAME.items()},
}
ASSUMED = {  # of a recording without a config
    "supply": f"motor supply: {SUPPLY_ERROR_PERCENT:g} % assumed",
    "calibration": f"angles: {1e3 * CALIBRATION_ERROR_RAD:g} mrad assumed",
}
SMALL = 0.1  # of the sum: smaller lines are left out


def budget_in_words(run: ReportedRun) -> list[BudgetLine]:
    """u95 and its lines that matter, then u95_absolute and what it adds, in % of tau, K and f_c; empty without one."""
    lines = that_matter(budget_lines(run.result), SMALL)
    words = IN_WORDS | (ASSUMED if run.meta.drive is None and run.meta.sensor is None else {})
    return [replace(line, source=words.get(line.source, line.source)) for line in sorted(lines, key=_group)]


def _group(line: BudgetLine) -> tuple[bool, bool]:
    return line.absolute, not line.is_sum
