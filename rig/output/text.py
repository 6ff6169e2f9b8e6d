"""Results as lines and plain tables, for a terminal and a notebook."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rig.core.estimators import MAIN
from rig.run_folder.results import IdentificationResult, known, whole
from rig.run_folder.results.budget_lines import budget_lines, that_matter
from rig.run_folder.results.comparison import ComparisonResult

MOTOR_LAW_HEADINGS = ("law", "size", "unit", "or, as likely")
BUDGET_HEADINGS = ("from", "tau, %", "K, %", "f_c, %", "only in")
_SHORT = ("tau", "K", "f_c")
_SMALL_SHARE = 0.2  # of the whole uncertainty: smaller lines are left out


def plain_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table that a program can read, too: columns two blanks or more apart, a dash for an empty cell."""
    cells = [[cell or "-" for cell in row] for row in [headings, *rows]]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells]


def comparison_words(found: ComparisonResult) -> list[str]:
    """Both answers, the scatter, the trends and the notes of a comparison, a line each."""
    scatter = ", ".join(f"{name} {found.scatter.percent[key]:.2g} %" for key, name in zip(MAIN, _SHORT, strict=True))
    lines = [
        f"differs measurably: {found.measurably.words}",
        f"differs beyond the scatter from run to run: {found.beyond_scatter.words}",
        f"scatter: {scatter} ({found.scatter.source}): {found.scatter.why}",
    ]
    for trend in found.trends:
        half = 0.5 * (known(trend.ci95[1]) - known(trend.ci95[0]))
        name = _SHORT[MAIN.index(trend.parameter)]
        sure = "" if trend.shows else " (none shows)"
        places = max(0, 1 - math.floor(math.log10(half))) if 0.0 < half < math.inf else 3  # two digits of its interval
        slope = f"{round(trend.slope, places) + 0.0:+.{places}f} ±{half:.{places}f} {trend.unit}{sure}"
        unsure = f"not known to 100 {trend.unit}: give runs farther apart"
        lines.append(f"trend over {trend.over}: {name} {slope if trend.is_known else unsure}")
    lines += [f"left out: {one.folder}: {one.reason}" for one in found.left_out]
    return lines + [f"note: {note}" for note in found.notes]


def law_causes() -> dict[str, tuple[str, str]]:
    """For each law of a motor by its name: its title, and what it may come from."""
    from rig.identification.departures import BY_NAME

    return {law.name: (law.title, law.cause) for law in BY_NAME.values()}


def motor_law_rows(result: IdentificationResult) -> list[list[str]]:
    """The laws of the answer beyond the plain motor, a row of ``MOTOR_LAW_HEADINGS`` each."""
    rows = []
    for law in (result.answer.law if result.answer is not None else None) or ():
        text = "-" if law.value is None else f"{law.value:.3g}"
        if (interval := whole(law.ci95)) is not None:
            text += f" ±{0.5 * (interval[1] - interval[0]):.2g}"
        alike = next((group[1:] for group in result.not_told_apart or () if group and group[0] == law.name), ())
        or_else = ", ".join(name.replace("_", " ") for name in alike)
        rows.append([law.name.replace("_", " "), text, "" if law.unit == "1" else law.unit, or_else])
    return rows


def budget_rows(result: IdentificationResult) -> list[list[str]]:
    """The lines of the budget that matter, a row of ``BUDGET_HEADINGS`` each; the sums first; empty without one."""
    rows = []
    for line in that_matter(budget_lines(result), _SMALL_SHARE):
        name = line.source if line.is_sum else line.source.replace("_", " ")
        cells = ["-" if math.isnan(share) else "> 100" if share > 100.0 else f"{share:.2f}" for share in line.percent]
        rows.append([name, *cells, "u95_absolute" if line.absolute and not line.is_sum else ""])
    return rows
