"""The uncertainty budget of tau, K and friction (GUM; docs/theory.md 12.8).

Type A is the scatter of the fit. To it comes every law that the record neither shows nor excludes. Such a law is kept
as a nuisance: a bench has it with a probability of ``PRESENT``, in a size up to ``Departure.range_of``. The record
changes both, by Bayes' rule. What the law then moves tau, K and friction by, weighted by how probable it still is, is
its line. Two laws that hide each other have a line together: each alone may be excluded, while both are not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rig.identify.departures.choice import Columns, with_own_noise
from rig.identify.departures.departure import Bench, Departure
from rig.identify.departures.fit import POSITIVE, Fit, unit

Array = NDArray[np.float64]

OF = ("tau_s", "K_rad_s_V", "fc_V")
COVERAGE = 2.0  # of an expanded uncertainty: 95 %
UNIFORM = math.sqrt(3.0)  # half width of a uniform distribution over its standard deviation
PRESENT = 0.1  # probability of a law before the record is looked at
MOST_TRIALS = 3  # starts of a law: of cogging the three lowest orders; higher ones are not in the budget
LARGEST_GAIN = 60.0  # of twice the log likelihood: it keeps its exponential finite
TYPE_A = "scatter"
TWO_LAWS = "two laws that hide each other"


@dataclass(frozen=True)
class Entry:
    """One line of the budget: what may be wrong, and the half widths at 95 % that it gives tau_s, K_rad_s_V, fc_V."""

    source: str
    tau_s: float
    K_rad_s_V: float
    fc_V: float


@dataclass(frozen=True)
class Budget:
    """The lines, the largest first, and their root sums of squares by parameter."""

    entries: tuple[Entry, ...]

    @property
    def u95(self) -> dict[str, float]:
        """Expanded uncertainty of each parameter, in its unit, in the bench's own volts and radians."""
        return {name: math.hypot(*(getattr(entry, name) for entry in self.entries)) for name in OF}


def budget(fit: Fit, laws: Sequence[Departure], candidates: Sequence[Departure], bench: Bench) -> Budget:
    """The budget of a fit with its chosen ``laws``."""
    fit = with_own_noise(fit)
    rows = fit.problem.rows(fit.motor, fit.starts)
    columns = Columns(fit, rows)
    of = [fit.problem.free.index(name) for name in OF]
    size = np.array([getattr(fit.motor, name) if name in POSITIVE else 1.0 for name in OF])
    core = len(fit.problem.free)
    added: list[Array] = []
    owners: list[Owner] = []
    spreads: list[float] = []
    for law in candidates:
        if law in laws:
            continue
        for trial in law.trials(bench)[:MOST_TRIALS]:
            column, scale = columns.of(law, trial)
            owners.append((law, core + sum(a.shape[1] for a in added), column.shape[1]))
            added.append(column)
            spreads += [(law.range_of(bench) if scale else 1.0) / UNIFORM] * column.shape[1]
    normal = columns.normal(np.column_stack(added)) if added else columns.base
    variance = unit(fit)
    matrix, gradient = normal.matrix / variance, normal.gradient / variance
    return Budget(_entries(matrix, gradient, owners, np.array(spreads), (core, of, size)))


Owner = tuple[Departure, int, int]  # a law, its first column, and how many it has


def _entries(
    matrix: Array, gradient: Array, owners: Sequence[Owner], spread: Array, plain: tuple[int, Sequence[int], Array]
) -> tuple[Entry, ...]:
    """The lines, from the normal equations in units of the noise.

    matrix, gradient   of the fit's own numbers, then of all nuisances
    spread             standard deviation of each nuisance before the record is looked at
    plain              how many numbers are the fit's own, where tau, K and fc stand among them, and their units
    """
    core, of, size = plain
    own = matrix[:core, :core]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(own), 1e-300))
    inverse = np.linalg.pinv(own * np.outer(scale, scale), rcond=1e-13, hermitian=True) * np.outer(scale, scale)
    border = matrix[core:, :core]
    # each nuisance in its own spread: what the record says of it when the fit's numbers are free
    inside = (matrix[core:, core:] - border @ inverse @ border.T) * np.outer(spread, spread)
    pull = (gradient[core:] - border @ inverse @ gradient[:core]) * spread
    moves = -(inverse @ border.T)[list(of)] * size[:, None] * spread  # of tau, K, fc by each
    alone = np.diag(inverse)[list(of)] * size**2

    def hidden(at: list[int]) -> tuple[float, Array]:
        """Odds of these nuisances against none, but for those before the record, and the squares of what they move."""
        precision = np.eye(len(at)) + inside[np.ix_(at, at)]
        covariance = np.linalg.inv(precision)
        mean = -covariance @ pull[at]
        gain = min(float(-pull[at] @ mean), LARGEST_GAIN)
        odds = math.exp(0.5 * gain) / math.sqrt(max(float(np.linalg.det(precision)), 1e-300))
        by = moves[:, at]
        return odds, np.einsum("ij,jk,ik->i", by, covariance, by) + (by @ mean) ** 2

    before = PRESENT / (1.0 - PRESENT)
    lines: dict[str, Array] = {}
    total = 1.0
    trials = {law.name: sum(1 for other, _, _ in owners if other is law) for law, _, _ in owners}
    for law, first, count in owners:
        odds, squares = hidden([*range(first - core, first - core + count)])
        weight = before / trials[law.name] * odds
        total += weight
        lines[law.name] = lines.get(law.name, np.zeros(3)) + weight * squares
    pairs = np.zeros(3)
    for (a, first_a, count_a), (b, first_b, count_b) in combinations(owners, 2):
        if a is not b:
            at = [*range(first_a - core, first_a - core + count_a), *range(first_b - core, first_b - core + count_b)]
            odds, squares = hidden(at)
            weight = before**2 / (trials[a.name] * trials[b.name]) * odds
            total += weight
            pairs += weight * squares
    lines[TWO_LAWS] = pairs
    found = [Entry(TYPE_A, *(COVERAGE * np.sqrt(alone)).tolist())]
    found += [Entry(name, *(COVERAGE * np.sqrt(line / total)).tolist()) for name, line in lines.items()]
    weight_of = np.maximum(size, 1e-12)
    return tuple(sorted(found, key=lambda e: -max(e.tau_s / weight_of[0], e.K_rad_s_V / weight_of[1], e.fc_V)))
