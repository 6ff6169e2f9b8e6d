"""The uncertainty budget of a result as lines of a table, in % of the answer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from rig.core.estimators import MAIN
from rig.run_folder.results.estimates import known
from rig.run_folder.results.identification import IdentificationResult
from rig.run_folder.results.result import RunResult


@dataclass(frozen=True)
class BudgetLine:
    """One line of the table.

    source    what may be wrong, as in the budget; `u95` and `u95_absolute`: the sums
    percent   what it adds to tau, K and friction, % of each; nan where it is not known, or for a friction of 0
    is_sum    whether it is a sum
    absolute  whether it counts in u95_absolute alone
    """

    source: str
    percent: tuple[float, ...]
    is_sum: bool = False
    absolute: bool = False


def budget_lines(result: RunResult | IdentificationResult) -> list[BudgetLine]:
    """The sums, then the lines of the budget, the largest first; empty without a budget of the answer."""
    answer = result.answer
    if answer is None or not answer.u95:
        return []
    sizes = [known(answer.value(name)) for name in MAIN]

    def percent(parts: Mapping[str, float | None]) -> tuple[float, ...]:
        return tuple(
            100.0 * known(parts.get(name)) / size if size > 0.0 else math.nan
            for name, size in zip(MAIN, sizes, strict=True)
        )

    lines = [BudgetLine("u95", percent(answer.u95), is_sum=True)]
    if answer.u95_absolute:
        lines.append(BudgetLine("u95_absolute", percent(answer.u95_absolute), True, True))
    return lines + [BudgetLine(one.source, percent(dict(one)), absolute=one.absolute) for one in result.budget or ()]


def that_matter(lines: list[BudgetLine], share: float) -> list[BudgetLine]:
    """The sums, and those lines that are more than ``share``, 0 to 1, of the sum that they count in."""
    sums = {line.absolute: line.percent for line in lines if line.is_sum}
    return [
        line
        for line in lines
        if line.is_sum
        or any(part > share * whole for part, whole in zip(line.percent, sums[line.absolute], strict=True))
    ]
