"""Whether a law predicts what was not fitted: other pieces of the tests, and a test of another amplitude.

The tests are split into shares. The numbers are fitted to all shares but one, and predict that one; only the starts of
its pieces are fitted to it. A law that is in the motor predicts better than no law. A law that merely stands in for
something else need not. All of it comes from the normal equations of one fit: they are sums over the pieces
(docs/theory.md 12.7).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.departures.departure import Bench, Departure
from rig.identification.departures.fit import DELAY, POSITIVE, Fit, sums_of_pieces, unit

Share = NDArray[np.int64]

SHARES = 4  # of the pieces: every fourth piece is predicted from the others
LONG_DELAY_S = 0.1  # what is known of a delay before the tests are seen
SMALLEST_SHAPE = 1e-3  # standard deviation of a shape near 0, in its unit


def rise_by_law(fit: Fit, laws: Sequence[Departure], bench: Bench) -> dict[Departure, float]:
    """For each law by how much it raises twice the log probability of what was not fitted; below 0 it predicts worse.

    fit   by least squares, on pieces of which some can be predicted from the others

    It is the smaller one of two rises: of every fourth piece from the others, and of each test from the other tests.
    The uncertainty of the numbers counts: a prediction that is vague, and says so, is not held against a law.
    """
    known = Evidence.of(fit, laws, bench)
    cut = fit.problem.cut
    pieces = np.arange(cut.begins.size)
    ends = np.cumsum([0, *(rows.size for rows in cut.rows)])
    splits = [
        [pieces[k::SHARES] for k in range(min(SHARES, pieces.size))],
        [pieces[first:end] for first, end in pairwise(ends.tolist())],
    ]
    return {law: min((known.rise(law, split) for split in splits if len(split) > 1), default=math.inf) for law in laws}


@dataclass(frozen=True, eq=False)
class Evidence:
    """What each piece says of the free numbers, and what is known of them before.

    free       names of the numbers
    sizes      what they are
    matrix     (p, m, m) normal equations of each piece, its start taken out, in units of the noise
    gradient   (p, m)
    mean       of each number before the tests are seen, less ``sizes``: laws are centred on 0
    precision  of each number before the tests are seen, in its unit to the power of -2
    """

    free: tuple[str, ...]
    sizes: Array
    matrix: Array
    gradient: Array
    mean: Array
    precision: Array

    @classmethod
    def of(cls, fit: Fit, laws: Sequence[Departure], bench: Bench) -> Evidence:
        """The plain numbers are hardly known before, those of laws by their range."""
        free = fit.problem.free
        sizes = np.array([getattr(fit.motor, name) for name in free])
        matrix, gradient = sums_of_pieces(fit.rows, fit.problem.cut.begins)
        wide = dict.fromkeys(POSITIVE, 1.0) | {"fc_V": bench.largest_V, "bias_V": bench.largest_V, DELAY: LONG_DELAY_S}
        for law in laws:
            wide |= {name: max(abs(getattr(fit.motor, name)), SMALLEST_SHAPE) for name in law.shape}
            wide |= dict.fromkeys(law.numbers, law.range_of(bench) / math.sqrt(3.0))
        numbers = {name for law in laws for name in law.numbers}
        mean = np.array([-size if name in numbers else 0.0 for name, size in zip(free, sizes, strict=True)])
        precision = np.array([wide[name] ** -2.0 for name in free])
        return cls(free, sizes, matrix / unit(fit), gradient / unit(fit), mean, precision)

    def rise(self, law: Departure, shares: Sequence[Share]) -> float:
        """By how much the law raises twice the log probability of each share, seen from the others, in sum."""
        own = [self.free.index(name) for name in (*law.numbers, *law.shape)]
        every = np.arange(len(self.free))
        rest = np.delete(every, own)
        none = np.zeros(len(self.free))
        none[own[: len(law.numbers)]] = -self.sizes[own[: len(law.numbers)]]
        rise = 0.0
        for free, start, sign in ((rest, none, 1.0), (every, np.zeros(len(self.free)), -1.0)):
            whole = self.surprise(np.arange(self.gradient.shape[0]), free, start)
            for share in shares:
                others = np.delete(np.arange(self.gradient.shape[0]), share)
                rise += sign * (whole - self.surprise(others, free, start))
        return rise

    def surprise(self, pieces: Share, free: Share, start: Array) -> float:
        """Twice the negative log probability of these pieces, but for a constant of the pieces.

        free    which numbers are free; the others stay at ``start``
        start   (m,) by how much each number differs from ``sizes``
        """
        matrix, gradient = self.matrix[pieces].sum(axis=0), self.gradient[pieces].sum(axis=0)
        known, off = self.precision[free], (start - self.mean)[free]
        bound = matrix[np.ix_(free, free)] + np.diag(known)
        slope = (gradient + matrix @ start)[free] + known * off
        scale = 1.0 / np.sqrt(np.diag(bound))
        scaled = bound * np.outer(scale, scale)
        squares = 2.0 * gradient @ start + start @ matrix @ start + known @ off**2
        squares -= slope * scale @ np.linalg.solve(scaled, slope * scale)
        volume = np.linalg.slogdet(scaled)[1] - 2.0 * np.sum(np.log(scale)) - np.sum(np.log(known))
        return float(squares + volume)
