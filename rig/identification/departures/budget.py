"""The uncertainty budget of tau, K and friction (GUM; docs/theory.md 12.8).

Type A is the scatter of the fit. To it comes every law that the record neither shows nor excludes. Such a law is kept
as a nuisance: a bench has it with a probability of ``PRESENT``, or of ``UNTOLD``, in a size up to
``Departure.range_of``. The record changes both, by Bayes' rule. What the law then moves tau, K and friction by,
weighted by how probable it still is, is its line. Two or three laws that hide each other have a line together: each
alone may be excluded, while all are not. Where another law would explain the record nearly as well as one that was
found, that has a line as well.

No record shows how large the bench's volt, radian and second are. What their errors move is in the absolute lines.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, combinations

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.chance import log_normal_below, normal_below
from rig.identification.departures.in_place import InPlace
from rig.identification.departures.nuisances import OF, Nuisance, Nuisances
from rig.identification.departures.profile import Profile
from rig.identification.stated_errors import ScaleErrors
from rig.model.real_motor import RealMotor

COVERAGE = 2.0  # of an expanded uncertainty: 95 %
PRESENT = 0.05  # probability of a law before the record is looked at; at 0.1 more than 98 % of u95 held the truth
UNTOLD = 0.1  # the same where the fit leaves more than white noise: something is there that no law tells
MOST_TOGETHER = 3  # laws that are looked at together,
MOST_SETS = 2000  # but where they have more starts than that together
BY_ROUNDING = 1e-3  # of 1, which each nuisance has beforehand
LARGEST_GAIN = 60.0  # of twice the log likelihood: it keeps its exponential finite
TYPE_A = "scatter"
TOGETHER = "laws that hide each other"
OTHER = "another law instead of "


@dataclass(frozen=True)
class Entry:
    """One line of the budget: what may be wrong, and the half widths at 95 % that it gives tau_s, K_rad_s_V, fc_V.

    absolute   whether it is in no record: an error of the volt, the radian or the second
    laws       names of the laws that most of the line comes from, where it is about laws
    """

    source: str
    tau_s: float
    K_rad_s_V: float
    fc_V: float
    absolute: bool = False
    laws: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Budget:
    """The lines, the largest first, and their root sums of squares by parameter.

    hidden   the laws that the tests neither show nor exclude; ``entries`` has them as lines
    """

    entries: tuple[Entry, ...]
    hidden: Hidden = field(default_factory=lambda: Hidden())

    @property
    def u95(self) -> dict[str, float]:
        """Expanded uncertainty of each parameter, in its unit, in the bench's own volts, radians and seconds."""
        return {name: math.hypot(*(getattr(e, name) for e in self.entries if not e.absolute)) for name in OF}

    @property
    def u95_absolute(self) -> dict[str, float]:
        """The same in true volts, radians and seconds."""
        return {name: math.hypot(*(getattr(entry, name) for entry in self.entries)) for name in OF}


def budget(
    nuisances: Nuisances,
    by_size: Sequence[Profile],
    instead: Sequence[InPlace],
    scales: ScaleErrors,
    scatter: Array,
    of_model: Sequence[Entry] = (),
) -> Budget:
    """The budget of a fit with its chosen laws.

    nuisances   the laws that it has not
    by_size     laws in which the motion is not linear, size by size
    instead     those that could stand in place of a chosen one
    scales      how well the bench's volt, radian and second are known
    scatter     (3,) variances of tau, K and friction by the scatter of the fit
    of_model    lines for errors of the model itself
    """
    present = PRESENT if nuisances.fit.problem.noise.white else UNTOLD
    hidden = Hidden.of(Shifts.of(nuisances), nuisances.each, by_size, present)
    motor = nuisances.fit.motor
    entries = [
        Entry(TYPE_A, *(COVERAGE * np.sqrt(scatter)).tolist()),
        *hidden.lines(),
        *instead_of(instead),
        *of_model,
        *absolute(motor, scales),
    ]
    sizes = {name: max(abs(getattr(motor, name)), 1e-12) for name in OF}
    return Budget(tuple(sorted(entries, key=lambda e: -max(getattr(e, name) / sizes[name] for name in OF))), hidden)


def absolute(motor: RealMotor, scales: ScaleErrors) -> tuple[Entry, ...]:
    """The lines of supply, calibration and clock.

    A volt that is larger by a share makes K smaller by it, and friction larger. A larger radian makes K larger alone; a
    longer second makes tau longer and K smaller.
    """
    tau, gain, friction = (COVERAGE * abs(getattr(motor, name)) for name in OF)
    return (
        Entry("supply", 0.0, gain * scales.volt, friction * scales.volt, absolute=True),
        Entry("calibration", 0.0, gain * scales.radian, 0.0, absolute=True),
        Entry("clock", tau * scales.second, gain * scales.second, 0.0, absolute=True),
    )


@dataclass(frozen=True, eq=False)
class Shifts:
    """What nuisances do to tau, K and friction, each nuisance in its own spread.

    scatter    (3,) variances of tau, K and friction by the noise alone; inf where the record does not tell it at all
    moves      (3, n) of tau, K and friction by each
    inside     (n, n) what the record says of them when the fit's own numbers are free
    pull       (n,) and its gradient
    centre     (n,) mean of each before the record is looked at
    one_sided  (n,) whether it is never below 0
    """

    scatter: Array
    moves: Array
    inside: Array
    pull: Array
    centre: Array
    one_sided: NDArray[np.bool_]

    @classmethod
    def of(cls, nuisances: Nuisances) -> Shifts:
        """From the normal equations."""
        matrix, gradient, spread, core = nuisances.matrix, nuisances.gradient, nuisances.spread, nuisances.core
        inverse, border = nuisances.covariance, matrix[core:, :core]
        inside = _no_less_than_nothing((matrix[core:, core:] - border @ inverse @ border.T) * np.outer(spread, spread))
        fewer = np.sqrt(nuisances.as_one)
        return cls(
            nuisances.scatter,
            -(inverse @ border.T)[nuisances.at] * nuisances.size[:, None] * spread,
            inside / np.outer(fewer, fewer),
            (gradient[core:] - border @ inverse @ gradient[:core]) * spread / nuisances.as_one,
            nuisances.mean,
            (nuisances.mean == 0.0)
            & np.array([one.law.one_sided for one in nuisances.each for _ in one.columns], dtype=bool),
        )

    def by(self, at: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Of m sets of nuisances, ``at`` (m, d): odds against none, but for those before the record; what they move.

        The second and third are (m, 3): mean and variance of what each set moves tau, K and friction by.
        """
        precision = np.eye(at.shape[1]) + self.inside[at[:, :, None], at[:, None, :]]
        covariance = np.asarray(np.linalg.inv(precision), dtype=np.float64)
        pull, centre = self.centre[at] - self.pull[at], self.centre[at]
        mean = np.einsum("mij,mj->mi", covariance, pull)
        gain = np.einsum("mi,mi->m", pull, mean) - np.einsum("mi,mi->m", centre, centre)
        gain = np.minimum(gain, LARGEST_GAIN)
        odds = np.exp(0.5 * (gain - np.linalg.slogdet(precision)[1]))
        order = np.argsort(mean / np.sqrt(np.einsum("mii->mi", covariance)), axis=1)  # the farthest below 0 first
        for k in order.T:
            odds = _cut_off(odds, mean, covariance, k, self.one_sided[np.take_along_axis(at, k[:, None], 1)[:, 0]])
        by = self.moves[:, at]
        return odds, np.einsum("imd,md->mi", by, mean), np.einsum("imd,mde,ime->mi", by, covariance, by)


def _no_less_than_nothing(inside: Array) -> Array:
    """What the record says of nuisances, without what rounding took from it where two of them are nearly alike."""
    try:
        np.linalg.cholesky(inside + BY_ROUNDING * np.eye(len(inside)))
    except np.linalg.LinAlgError:
        sizes, ways = np.linalg.eigh(inside)
        return np.asarray((ways * np.maximum(sizes, 0.0)) @ ways.T)
    return inside


def _cut_off(odds: Array, mean: Array, covariance: Array, k: NDArray[np.int64], here: NDArray[np.bool_]) -> Array:
    """Cut normal distributions off where one nuisance is below 0, in place, and make them twice as high; their odds.

    mean, covariance   (m, d) and (m, d, d): of what is left
    k, here            (m,) which nuisance of each, and whether it is cut off
    Exact for one nuisance; of several each is cut off in turn, and what is left counts as normal (Mendell and Elston,
    Biometrics 30, 1974).
    """
    row = np.flatnonzero(here)
    k = k[row]
    spread = np.sqrt(np.maximum(covariance[row, k, k], 1e-300))
    above = mean[row, k] / spread
    log_below = log_normal_below(above)
    hazard = np.exp(-0.5 * (above**2 + math.log(2.0 * math.pi)) - log_below)
    along = covariance[row, :, k] / spread[:, None]
    mean[row] += along * hazard[:, None]
    # between 0 and 1, however far below 0 it is cut off: there the difference is all rounding
    less = np.clip(hazard * (hazard + above), 0.0, 1.0)
    covariance[row] -= along[:, :, None] * along[:, None, :] * less[:, None, None]
    cut = odds.copy()
    cut[row] *= 2.0 * np.exp(log_below)
    return cut


@dataclass(frozen=True, eq=False)
class Hidden:
    """Sets of laws that a bench may have beside those of a fit, each with what it would move tau, K and friction by.

    laws           (k) names of each set's laws
    probability    (k,) of each set
    mean, variance (k, 3)
    """

    laws: tuple[tuple[str, ...], ...] = ()
    probability: Array = field(default_factory=lambda: np.zeros(0))
    mean: Array = field(default_factory=lambda: np.zeros((0, 3)))
    variance: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def of(
        cls,
        shifts: Shifts,
        nuisances: Sequence[Nuisance],
        by_size: Sequence[Profile] = (),
        present: float = PRESENT,
    ) -> Hidden:
        """All sets of one, two and three of the laws. A law that is known size by size is that where it is alone.

        present   probability of each law before the record is looked at
        """
        weights: list[Array] = []
        means: list[Array] = []
        variances: list[Array] = []
        names: list[tuple[str, ...]] = []
        known, before = {profile.law.name for profile in by_size}, present / (1.0 - present)
        for profile in by_size:
            weights.append(profile.odds if profile.found else before * profile.odds)
            means.append(profile.moves)
            variances.append(profile.spread**2)
            names += [(profile.law.name,)] * profile.odds.size
        for at, prior, laws in _sets(nuisances, known, before):
            odds, mean, variance = shifts.by(at)
            weights.append(odds * prior)
            means.append(mean)
            variances.append(variance)
            names += laws
        if not names:
            return cls()
        weight = np.concatenate(weights)
        return cls(tuple(names), weight / (1.0 + weight.sum()), np.concatenate(means), np.concatenate(variances))

    def lines(self) -> Iterator[Entry]:
        """A line of the budget for each law, and one for all sets of more."""
        share = self.probability[:, None] * (self.variance + self.mean**2)
        rows_of: dict[str, list[int]] = defaultdict(list)
        for k, chosen in enumerate(self.laws):
            rows_of[chosen[0] if len(chosen) == 1 else TOGETHER].append(k)
        for source, rows in rows_of.items():
            line = share[rows]
            most = self.laws[rows[int(np.argmax((line / np.maximum(line.sum(axis=0), 1e-300)).sum(axis=1)))]]
            tau, gain, friction = (COVERAGE * np.sqrt(line.sum(axis=0))).tolist()
            yield Entry(source, tau, gain, friction, laws=most)

    def beyond(self, name: str, size: float) -> tuple[float, tuple[str, ...]]:
        """Probability that a set moves a number, one of ``OF``, by more than ``size``; and the set most likely to."""
        if not self.laws:
            return 0.0, ()
        k = OF.index(name)
        spread = np.maximum(np.sqrt(self.variance[:, k]), 1e-300)
        outside = normal_below((self.mean[:, k] - size) / spread) + normal_below((-size - self.mean[:, k]) / spread)
        each = self.probability * outside
        return float(each.sum()), self.laws[int(np.argmax(each))]


def instead_of(instead: Sequence[InPlace]) -> Iterator[Entry]:
    """A line for each chosen law that another may stand in for: each as likely as Schwarz's criterion says."""
    by_law: dict[str, list[InPlace]] = defaultdict(list)
    for one in instead:
        by_law[one.law.name].append(one)
    for others in by_law.values():
        odds = np.exp(-0.5 * np.maximum([one.rise for one in others], 0.0))
        squares = (odds / (1.0 + odds.sum()))[:, None] * np.array([one.moves**2 for one in others])
        most = others[int(np.argmax(odds))]
        tau, gain, friction = (COVERAGE * np.sqrt(squares.sum(axis=0))).tolist()
        yield Entry(f"{OTHER}{most.law.name}", tau, gain, friction, laws=(most.law.name, most.other.name))


def _sets(
    nuisances: Sequence[Nuisance], known: Collection[str], before: float
) -> Iterator[tuple[NDArray[np.int64], Array, list[tuple[str, ...]]]]:
    """All sets of one, two and three laws, those with as many columns together; none of one law that is ``known``.

    Each set's columns (m, d), its odds beforehand (m,), ``before`` for each law that is no oftener, and its laws.
    """
    starts: dict[tuple[str, int], list[Nuisance]] = defaultdict(list)
    for one in nuisances:
        starts[one.law.name, one.count].append(one)
    alike: dict[int, list[tuple[NDArray[np.int64], Array, list[tuple[str, ...]]]]] = defaultdict(list)
    for count in range(1, MOST_TOGETHER + 1):
        for keys in combinations(starts, count):
            laws, each = tuple(name for name, _ in keys), [starts[key] for key in keys]
            many = math.prod(map(len, each))
            if len(set(laws)) < count or (laws[0] in known if count == 1 else many > MOST_SETS):
                continue
            which = np.indices([len(one) for one in each]).reshape(count, many)
            columns = [np.array([[*one.columns] for one in of])[k] for of, k in zip(each, which, strict=True)]
            odds = math.prod(before * of[0].law.often / of[0].starts for of in each)
            alike[sum(size for _, size in keys)].append((np.hstack(columns), np.full(many, odds), [laws] * many))
    for every in alike.values():
        at, prior, laws_of = zip(*every, strict=True)
        yield np.concatenate(at), np.concatenate(prior), [*chain.from_iterable(laws_of)]
