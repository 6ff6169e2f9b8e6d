"""The laws that a fit has not, as nuisances beside it: the normal equations of all of them (docs/theory.md 12.8)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.departures.choice import Columns
from rig.identification.departures.departure import NOTHING, UNIFORM, Bench, Departure
from rig.identification.departures.fit import POSITIVE, Fit, Rows, to_diagonal_1, unit

Begins = NDArray[np.int64]

OF = ("tau_s", "K_rad_s_V", "fc_V")
FEWEST_PIECES = 6  # that say by how much a law's evidence differs between them
SHOWN = 1e-9  # of the squares of a law's columns: what is left beside the fit's own numbers, if it is no rounding
LARGEST = 1e100  # of a column, in units of the noise: its squares are finite
SINGULAR, UNTOLD = 1e-13, 1e-3  # of the largest eigenvalue: none; a number's share of what a record does not tell


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
    mean       its mean then, in these
    as_one     how many rows say as much as one of each nuisance, >= 1, beyond what they do of all: where noise is not
               white, by how much more than noise its evidence differs between pieces
    """

    fit: Fit
    each: tuple[Nuisance, ...]
    matrix: Array
    gradient: Array
    spread: Array
    mean: Array
    as_one: Array

    @classmethod
    def of(
        cls,
        fit: Fit,
        laws: Sequence[Departure],
        candidates: Sequence[Departure],
        bench: Bench,
        outside: Sequence[tuple[Departure, Array, int, tuple[float, float] | None]] = (),
        longest_s: float = math.inf,
    ) -> Nuisances:
        """Of all ``candidates`` that are not among the ``laws`` of the fit.

        outside   laws that the motor's model has not, each start with the change of the readings, (n, k), for 1 of its
                  sizes, how many starts the law has, and what is known of its size, and how well
        longest_s   of a piece between which evidence may differ, s: longer ones of the fit are cut
        """
        fit = fit.with_own_noise
        absent = [law for law in candidates if law not in laws]
        smooth = [law for law in absent if law.trials(bench) == (NOTHING,)]
        rows = fit.rows
        columns = Columns(fit, smooth)
        added: list[Array] = []
        each: list[Nuisance] = []
        spreads: list[float] = []
        for law in absent:
            trials = law.trials(bench)
            for column, scale in columns.of_all(law, trials):
                if not np.abs(column).max(initial=0.0) < LARGEST:
                    continue  # so far from any motor the motion grows without end, and linear algebra with it
                each.append(Nuisance(law, len(spreads), column.shape[1], len(trials)))
                added.append(column)
                spreads += [(law.range_of(bench) if scale else 1.0) / UNIFORM] * column.shape[1]
        means = [0.0] * len(spreads)
        for law, change, starts, known in outside:
            each.append(Nuisance(law, len(spreads), change.shape[1], starts))
            added.append(columns.of_change(change))
            size, error = known or (0.0, law.range_of(bench) / UNIFORM)
            spreads += [error] * change.shape[1]
            means += [size / error] * change.shape[1]
        normal = columns.normal(np.column_stack(added)) if added else columns.base
        variance = unit(fit)
        as_one = np.ones(len(spreads))
        if added and not fit.problem.noise.white:
            cut = fit.problem.cut
            ends = cut.every(longest_s).begins if cut.longest_s > 1.01 * longest_s else cut.begins
            apart = pulls_apart(rows, np.column_stack(added), cut.begins, ends, variance)
            for one in each:  # whichever way a wave is turned
                as_one[one.columns] = max(float(np.mean(apart[one.columns])), 1.0)
        spread, mean = np.array(spreads), np.array(means)
        return cls(fit, tuple(each), normal.matrix / variance, normal.gradient / variance, spread, mean, as_one)

    def tempered(self, effect: float) -> Nuisances:
        """The same where only one of ``effect`` (>= 1) rows says something: pieces differ by more than noise.

        Of a nuisance whose own evidence differs by more, still fewer rows do.
        """
        as_one = np.maximum(self.as_one / effect, 1.0)
        return replace(self, matrix=self.matrix / effect, gradient=self.gradient / effect, as_one=as_one)

    @property
    def core(self) -> int:
        """How many numbers are the fit's own; the nuisances follow."""
        return len(self.fit.problem.free)

    @cached_property
    def _own(self) -> tuple[Array, Array]:
        """The normal equations of the fit's own numbers, scaled to a diagonal of 1, and by what: their product."""
        own = self.matrix[: self.core, : self.core]
        scale = to_diagonal_1(own)
        both = np.outer(scale, scale)
        return own * both, both

    @cached_property
    def covariance(self) -> Array:
        """Of the fit's own numbers, by the noise alone."""
        own, both = self._own
        return np.asarray(np.linalg.pinv(own, rcond=SINGULAR, hermitian=True) * both)

    @property
    def scatter(self) -> Array:
        """(3,) variances of tau, K and friction by the noise alone; inf where the record does not tell it at all."""
        sizes, ways = np.linalg.eigh(self._own[0])
        untold = np.any(np.abs(ways[self.at][:, sizes < SINGULAR * sizes[-1]]) > UNTOLD, axis=1)
        return np.where(untold, np.inf, np.diag(self.covariance)[self.at] * self.size**2)

    @property
    def at(self) -> list[int]:
        """Where tau, K and friction are among the fit's own numbers."""
        return [self.fit.problem.free.index(name) for name in OF]

    @property
    def size(self) -> Array:
        """(3,) tau, K and friction in their units for one of the fit's numbers."""
        return np.array([getattr(self.fit.motor, name) if name in POSITIVE else 1.0 for name in OF])


def pulls_apart(rows: Rows, added: Array, begins: Begins, ends: Begins, variance: float) -> Array:
    """(k,) by how much more than noise what each column of ``added`` pulls differs between parts of the rows, 1.

    begins     first row of each piece: its start is taken out of the columns, and then the fit's own numbers are
    ends       first row of each part
    variance   of the whitened residual
    What a law pulls over all rows is a sum over the parts, and of parts that differ by noise it is known by their
    number. A law that stands in for something else pulls some parts one way and some the other.
    """
    if ends.size < FEWEST_PIECES:
        return np.ones(added.shape[1])
    both = np.column_stack((rows.by_number, added))
    squares = np.sum(both**2, axis=0)
    for first, stop in pairwise([*begins.tolist(), rows.residual.size]):
        start = np.linalg.qr(rows.by_start[first:stop])[0]
        both[first:stop] -= start @ (start.T @ both[first:stop])
    m = rows.by_number.shape[1]
    own = np.linalg.qr(both[:, :m] / np.sqrt(np.maximum(squares[:m], 1e-300)))[0]
    left = both[:, m:]
    left = left - own @ (own.T @ left)
    shown = np.sum(left**2, axis=0)
    pulls = np.add.reduceat(left * rows.residual[:, None], ends)
    pulls -= pulls.mean(axis=0)
    differ = np.sum(pulls**2, axis=0) * ends.size / max(ends.size - m / 2.0, 1.0)
    is_shown = shown > SHOWN * squares[m:]
    return np.where(is_shown, differ / np.maximum(shown * variance, 1e-300), 1.0)
