"""The uncertainty budget of tau, K and friction (GUM; docs/theory.md 12.7).

Type A is the scatter of the fit. To it comes every law that the record neither shows nor excludes. Such a law is kept
as a nuisance: its size has the range that a bench may well have (``Departure.range_of``), taken as uniform, and the
record narrows that. What it moves tau, K and friction by is its entry. Two laws that hide each other have an entry
together, weighted by how rarely two come at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rig.identify.departures.choice import Columns, unit, with_own_noise
from rig.identify.departures.departure import Bench, Departure
from rig.identify.departures.fit import POSITIVE, Fit

Array = NDArray[np.float64]

OF = ("tau_s", "K_rad_s_V", "fc_V")
COVERAGE = 2.0  # of an expanded uncertainty: 95 %
UNIFORM = math.sqrt(3.0)  # half width of a uniform distribution over its standard deviation
TWO_AT_ONCE = 0.05  # weight of what two laws hide together
TYPE_A = "scatter"
TWO_LAWS = "two laws that hide each other"


@dataclass(frozen=True)
class Entry:
    """One line of the budget: what may be wrong, and by how much it moves tau_s, K_rad_s_V, fc_V: half widths at 95 %."""

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
    added, owners, spreads = [], [], []
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


MOST_TRIALS = 3
Owner = tuple[Departure, int, int]  # a law, its first column, and how many it has


def _entries(
    matrix: Array, gradient: Array, owners: Sequence[Owner], spread: Array, plain: tuple[int, Sequence[int], Array]
) -> tuple[Entry, ...]:
    core, of, size = plain

    def posterior(columns: Sequence[int]) -> tuple[Array, Array]:
        """Variances of tau, K and fc, and how far they move, with these nuisances."""
        at = [*range(core), *columns]
        own = matrix[np.ix_(at, at)].copy()
        for k, column in enumerate(columns):
            own[core + k, core + k] += 1.0 / spread[column - core] ** 2
        scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
        inverse = np.linalg.pinv(own / np.outer(scale, scale), rcond=1e-13, hermitian=True) / np.outer(scale, scale)
        return np.diag(inverse)[list(of)] * size**2, -(inverse @ gradient[at])[list(of)] * size

    alone, moved = posterior([])
    lines: dict[str, Array] = {TYPE_A: COVERAGE**2 * alone}
    extra: dict[int, Array] = {}
    for k, (law, first, count) in enumerate(owners):
        variance, shift = posterior(range(first, first + count))
        extra[k] = np.maximum(variance - alone, 0.0)
        line = COVERAGE**2 * extra[k] + (shift - moved) ** 2
        lines[law.name] = np.maximum(line, lines.get(law.name, np.zeros(3)))
    pairs = np.zeros(3)
    for a, b in combinations(range(len(owners)), 2):
        if owners[a][0] is owners[b][0]:
            continue
        both = [c for _, first, count in (owners[a], owners[b]) for c in range(first, first + count)]
        pairs += np.maximum(posterior(both)[0] - alone - extra[a] - extra[b], 0.0)
    lines[TWO_LAWS] = COVERAGE**2 * TWO_AT_ONCE * pairs
    found = [Entry(name, *np.sqrt(line).tolist()) for name, line in lines.items()]
    weight = np.maximum(size, 1e-12)
    return tuple(sorted(found, key=lambda e: -max(e.tau_s / weight[0], e.K_rad_s_V / weight[1], e.fc_V)))
