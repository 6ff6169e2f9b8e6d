"""The laws that a fit has not, as nuisances beside it: the normal equations of all of them (docs/theory.md 12.8)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.identification.departures.choice import Columns, with_own_noise
from rig.identification.departures.departure import NOTHING, Bench, Departure
from rig.identification.departures.fit import POSITIVE, Fit, unit

Array = NDArray[np.float64]

OF = ("tau_s", "K_rad_s_V", "fc_V")
UNIFORM = math.sqrt(3.0)  # half width of a uniform distribution over its standard deviation


@dataclass(frozen=True)
class Nuisance:
    """One start of a law: its first column among those of all nuisances, how many it has; and how many starts."""

    law: Departure
    first: int
    count: int
    starts: int

    @property
    def columns(self) -> range:
        """Where its columns are."""
        return range(self.first, self.first + self.count)


@dataclass(frozen=True, eq=False)
class Nuisances:
    """All of them beside a fit.

    fit        with the noise of its own residual
    each       the starts of the laws that it has not
    matrix, gradient   normal equations in units of the noise: of the fit's own numbers, then of the nuisances
    spread     standard deviation of each nuisance before the record is looked at
    """

    fit: Fit
    each: tuple[Nuisance, ...]
    matrix: Array
    gradient: Array
    spread: Array

    @classmethod
    def of(
        cls,
        fit: Fit,
        laws: Sequence[Departure],
        candidates: Sequence[Departure],
        bench: Bench,
        outside: Sequence[tuple[Departure, Array, int]] = (),
    ) -> Nuisances:
        """Of all ``candidates`` that are not among the ``laws`` of the fit.

        outside   laws that the motor's model has not, each start with the change of the readings, (n, k), for 1 of its
                  sizes, and how many starts the law has
        """
        fit = with_own_noise(fit)
        absent = [law for law in candidates if law not in laws]
        smooth = [law for law in absent if law.trials(bench) == (NOTHING,)]
        columns = Columns(fit, fit.problem.rows(fit.motor, fit.starts), smooth)
        added: list[Array] = []
        each: list[Nuisance] = []
        spreads: list[float] = []
        for law in absent:
            trials = law.trials(bench)
            for column, scale in columns.of_all(law, trials):
                each.append(Nuisance(law, len(spreads), column.shape[1], len(trials)))
                added.append(column)
                spreads += [(law.range_of(bench) if scale else 1.0) / UNIFORM] * column.shape[1]
        for law, change, starts in outside:
            each.append(Nuisance(law, len(spreads), change.shape[1], starts))
            added.append(columns.of_change(change))
            spreads += [law.range_of(bench) / UNIFORM] * change.shape[1]
        normal = columns.normal(np.column_stack(added)) if added else columns.base
        variance = unit(fit)
        return cls(fit, tuple(each), normal.matrix / variance, normal.gradient / variance, np.array(spreads))

    def tempered(self, effect: float) -> Nuisances:
        """The same where only one of ``effect`` (>= 1) rows says something: pieces differ by more than noise."""
        return replace(self, matrix=self.matrix / effect, gradient=self.gradient / effect)

    @property
    def core(self) -> int:
        """How many numbers are the fit's own; the nuisances follow."""
        return len(self.fit.problem.free)

    @property
    def at(self) -> list[int]:
        """Where tau, K and friction are among the fit's own numbers."""
        return [self.fit.problem.free.index(name) for name in OF]

    @property
    def size(self) -> Array:
        """(3,) tau, K and friction in their units for one of the fit's numbers."""
        return np.array([getattr(self.fit.motor, name) if name in POSITIVE else 1.0 for name in OF])
