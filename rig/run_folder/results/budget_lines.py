"""The uncertainty budget of a result as lines of a table, in % of the answer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rig.run_folder.results.estimates import known
from rig.run_folder.results.identification import IdentificationResult
from rig.run_folder.results.result import RunResult

OF = ("tau_s", "K_rad_s_V", "fc_V")


@dataclass(frozen=True)
class BudgetLine:
    """One line of the table.

    source    what may be wrong, as in the budget; `u95` and `u95_absolute`: the sums
    percent   what it adds to tau, K and friction, % of each; nan where it is not known, or for a friction of 0
    is_sum    whether it is a sum
    absolute  whether it counts in u95_absolute alone
    """

    source: str
    percent: tuple[float, float, float]
    is_sum: bool = False
    absolute: bool = False


def budget_lines(result: RunResult | IdentificationResult) -> list[BudgetLine]:
    """The sums, then the lines of the budget, the largest first; empty without a budget of the answer."""
    answer = result.answer
    if answer is None or not answer.u95:
        return []
    sizes = [known(answer.value(name)) for name in OF]

    def percent(tau: float | None, gain: float | None, friction: float | None) -> tuple[float, float, float]:
        of_tau, of_gain, of_friction = (
            100.0 * known(part) / size if size > 0.0 else math.nan
            for part, size in zip((tau, gain, friction), sizes, strict=True)
        )
        return of_tau, of_gain, of_friction

    lines = [BudgetLine("u95", percent(*(answer.u95.get(name) for name in OF)), is_sum=True)]
    whole = answer.u95_absolute
    if whole:
        lines.append(BudgetLine("u95_absolute", percent(*(whole.get(name) for name in OF)), True, True))
    return lines + [
        BudgetLine(entry.source, percent(entry.tau_s, entry.K_rad_s_V, entry.fc_V), absolute=entry.absolute)
        for entry in result.budget or ()
    ]


def that_matter(lines: list[BudgetLine], share: float) -> list[BudgetLine]:
    """The sums, and those lines that are more than ``share``, 0 to 1, of the sum that they count in."""
    sums = {line.absolute: line.percent for line in lines if line.is_sum}
    return [
        line
        for line in lines
        if line.is_sum
        or any(part > share * whole for part, whole in zip(line.percent, sums[line.absolute], strict=True))
    ]
