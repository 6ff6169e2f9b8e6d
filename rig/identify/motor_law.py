"""The law of the motor: which departures from the plain one its tests show, and what tau, K and friction are with them.

The plain estimate is the start. ``rig.identify.departures`` chooses the laws on pieces of the tests. This module turns
the choice into an estimate with its intervals, names laws that look alike, and draws up the uncertainty budget.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from rig.identify.departures import DEPARTURES
from rig.identify.departures.budget import Budget, budget
from rig.identify.departures.choice import Choice, Chooser, Columns, loss, unit, with_own_noise
from rig.identify.departures.departure import Departure
from rig.identify.departures.fit import CORE, DELAY, POSITIVE, Fit, Normal
from rig.identify.departures.pieces import Cut
from rig.identify.estimate import PARAMETERS, Estimate
from rig.identify.repetition import repeated_share, repetitions
from rig.identify.verdict import PROMISE, SURE
from rig.model.real_motor import RealMotor
from rig.recording.series import TimeSeries
from rig.results import BudgetEntry, EstimateResult, FoundLawResult, PieceResult

Array = NDArray[np.float64]

LINEARITY_SHARE = 0.005  # largest error of a sensor's linearity, relative to its travel, where no data sheet is given
ALIKE = 6.0  # difference in BIC within which two laws are not told apart
NO_CYCLE = 12.0  # parts of a record without a cycle that count as one
SMALL_FRICTION = 0.03  # of the largest drive: the size that smaller friction counts as
MOST_ROWS = 8000  # of all tests
ROWS_OF_TAU = 20  # at least so many of the rows taken as one have room in tau
CORE_OF = dict(zip((*CORE, DELAY), PARAMETERS, strict=True))


class LawKeys(TypedDict):
    """The keys of result.json that say what the motor is beyond the plain law."""

    law: tuple[FoundLawResult, ...] | None
    not_told_apart: tuple[tuple[str, ...], ...] | None
    u95: dict[str, float | None] | None
    budget: tuple[BudgetEntry, ...] | None
    with_law: EstimateResult | None
    pieces: tuple[PieceResult, ...] | None


NO_LAW: LawKeys = {"law": None, "not_told_apart": None, "u95": None, "budget": None, "with_law": None, "pieces": None}


@dataclass(frozen=True)
class FoundLaw:
    """A law that the tests show.

    law       the departure
    size      root sum of squares of its numbers; the number itself where it has one
    ci95      its interval
    bic       by how much BIC would rise without it
    numbers   all its numbers and its shape, by field of ``RealMotor``
    """

    law: Departure
    size: float
    ci95: tuple[float, float]
    bic: float
    numbers: dict[str, float]

    def in_words(self) -> str:
        """E.g. ``force over position 0.052 +- 0.004 V: an unbalanced load, or a cable?``"""
        half = 0.5 * (self.ci95[1] - self.ci95[0])
        unit = "" if self.law.unit == "1" else f" {self.law.unit}"
        return f"{self.law.title} {self.size:.3g} ± {half:.2g}{unit}: {self.law.cause}"


@dataclass(frozen=True)
class MotorLaw:
    """The law of a motor.

    found           the departures that the tests show
    not_told_apart  groups of names; each has one found law and those that explain the tests nearly as well
    estimate        tau, K, friction, asymmetry and delay with these laws; None without any: the plain one holds
    budget          what may be wrong in them
    growth          length of the pieces that were fitted, s, and their RMS residual, rad
    """

    found: tuple[FoundLaw, ...]
    not_told_apart: tuple[tuple[str, ...], ...]
    estimate: Estimate | None
    budget: Budget
    growth: tuple[tuple[float, float], ...]

    def notes(self) -> list[str]:
        """What the tests show, as sentences."""
        lines = [f"law: {law.in_words()}" for law in self.found]
        for group in self.not_told_apart:
            told_by = next(d.told_by for d in DEPARTURES if d.name == group[0])
            lines.append(f"law: {' and '.join(group)} are not told apart; record {told_by}")
        return lines

    def without_laws(self) -> MotorLaw:
        """The same, but for the laws and their estimate: the plain one holds."""
        return replace(self, found=(), not_told_apart=(), estimate=None)

    def reservation(self, estimate: Estimate, largest_V: float) -> str | None:
        """What makes ``estimate`` less certain than 2.5 %, as a sentence; None if nothing does.

        largest_V   largest drive of the tests, V: friction near zero has no useful relative uncertainty
        """
        sizes = {"tau_s": estimate.tau_s, "K_rad_s_V": estimate.K_rad_s_V}
        sizes["fc_V"] = max(abs(estimate.fc_V), SMALL_FRICTION * largest_V)
        shares = {name: self.budget.u95[name] / abs(size) for name, size in sizes.items()}
        name = max(shares, key=lambda key: shares[key])
        if SURE * shares[name] <= PROMISE:
            return None
        largest = max(self.budget.entries, key=lambda entry: float(getattr(entry, name)))
        law = next((one for one in DEPARTURES if one.name == largest.source), None)
        what = largest.source if law is None else law.title
        cure = "more cycles, and another amplitude" if law is None else law.told_by
        return (
            f"{name} is only certain to {100.0 * shares[name]:.2g} % (u95): most of it is {what}, which these tests do "
            f"not exclude. To know more, record {cure}"
        )

    def as_keys(self) -> LawKeys:
        """As in result.json."""
        return LawKeys(
            law=tuple(
                FoundLawResult(
                    name=one.law.name,
                    value=one.size,
                    unit=one.law.unit,
                    ci95=one.ci95,
                    bic=one.bic,
                    numbers=dict(one.numbers),
                )
                for one in self.found
            ),
            not_told_apart=self.not_told_apart,
            u95=dict(self.budget.u95),
            budget=tuple(
                BudgetEntry(source=e.source, tau_s=e.tau_s, K_rad_s_V=e.K_rad_s_V, fc_V=e.fc_V)
                for e in self.budget.entries
            ),
            with_law=None if self.estimate is None else self.estimate.as_result(),
            pieces=tuple(PieceResult(length_s=length, rms_rad=rms) for length, rms in self.growth),
        )


def motor_law(tests: Sequence[TimeSeries], plain: Estimate, periods_s: Sequence[float | None]) -> MotorLaw:
    """The law that the tests show, from the plain estimate on.

    periods_s  for each test the period of its cycle, s, or None
    Of more than 8,000 rows several at a time are taken as one. Raises IdentifyError if a test is too short.
    """
    rows = sum(len(test) for test in tests)
    tests = [
        thinned(test, min(math.ceil(rows / MOST_ROWS), int(plain.tau_s / test.period_s / ROWS_OF_TAU)))
        for test in tests
    ]
    free_delay = any(test.t_u_s is None for test in tests)
    delay_s = (
        (min(test.earliest_delay_s for test in tests), max(test.longest_delay_s for test in tests))
        if free_delay
        else (0.0, 0.0)
    )
    whole = Cut.whole(tests, delay_s[1])
    start = RealMotor(
        plain.tau_s, plain.K_rad_s_V, max(plain.fc_V, 0.0), plain.asym_V, plain.delay_s if free_delay else 0.0
    )
    durations = [window.duration_s for window in whole.windows]
    cycle_s = min((p for p in periods_s if p is not None), default=max(durations) / NO_CYCLE)
    linearity_rad = 2.0 * LINEARITY_SHARE * whole.frames[0].half_travel_rad
    bench = whole.every(0.5 * cycle_s).bench(start, linearity_rad)
    core = (*CORE, DELAY) if free_delay else CORE
    sigma = float(np.sqrt(np.mean([test.noise_rad() ** 2 for test in tests])))
    candidates = [law for law in DEPARTURES if law.fits(bench)]
    chooser = Chooser(candidates, bench, core, delay_s, max(sigma, SMALLEST_NOISE * whole.frames[0].half_travel_rad))
    choice = chooser.choose(whole, start, cycle_s)
    fit = with_own_noise(choice.fit)
    normal = Normal.of(fit.problem.rows(fit.motor, fit.starts), fit.problem.cut)
    lines = budget(fit, choice.laws, candidates, bench)
    if not choice.laws:
        return MotorLaw((), (), None, lines, choice.growth)
    covariance = np.asarray(np.linalg.pinv(normal.matrix, rcond=1e-14, hermitian=True) * unit(fit), dtype=np.float64)
    found = tuple(_found(law, fit, normal, covariance) for law in choice.laws)
    return MotorLaw(
        found,
        tuple(group for law in choice.laws if len(group := _alike(law, choice, fit, chooser)) > 1),
        _estimate(fit, covariance, tests, plain, periods_s),
        lines,
        choice.growth,
    )


SMALLEST_NOISE = 1e-6  # of the sensor, relative to half the travel: of a record without noise


def thinned(test: TimeSeries, rows: int) -> TimeSeries:
    """The test with so many rows at a time as one: their first position, and their mean drive.

    A motor takes the mean of a drive that changes within a small part of its tau.
    """
    if rows < 2:
        return test
    first = np.arange(0, len(test) - rows + 1, rows)
    spans = np.diff(np.append(test.edge_s, test.edge_s[-1] + test.period_s))
    whole = np.add.reduceat(spans, first)
    mean_V = np.add.reduceat(test.u_V * spans, first) / np.where(whole > 0.0, whole, 1.0)
    return replace(
        test,
        t_s=test.t_s[first],
        y_rad=test.y_rad[first],
        t_u_s=None if test.t_u_s is None else test.t_u_s[first],
        even_s=None if test.even_s is None else test.even_s[first],
        u_V=mean_V,
    )


def _freedom(fit: Fit) -> int:
    return max(1, int(fit.residual_rad.size) - 2 * int(fit.starts.shape[0]) - len(fit.problem.free))


def _found(law: Departure, fit: Fit, normal: Normal, covariance: Array) -> FoundLaw:
    free = fit.problem.free
    at = [free.index(name) for name in law.numbers]
    values = np.array([getattr(fit.motor, name) for name in law.numbers])
    size = float(values[0]) if values.size == 1 else float(np.sqrt(values @ values))
    slope = values / size if values.size > 1 and size > 0.0 else np.ones(values.size)
    error = math.sqrt(max(0.0, float(slope @ covariance[np.ix_(at, at)] @ slope)))
    half = float(stdtrit(_freedom(fit), 0.975)) * error
    price = len(law.numbers + law.shape) * math.log(_freedom(fit))
    numbers = {name: float(getattr(fit.motor, name)) for name in (*law.numbers, *law.shape)}
    return FoundLaw(law, size, (size - half, size + half), loss(normal, fit, law) / unit(fit) - price, numbers)


def _alike(law: Departure, choice: Choice, fit: Fit, chooser: Chooser) -> tuple[str, ...]:
    """The law, and those that would explain the tests nearly as well in its place (by the linear model)."""
    rows = fit.problem.rows(fit.motor, fit.starts)
    columns = Columns(fit, rows)
    group = [law.name]
    free = fit.problem.free
    own = [free.index(name) for name in law.numbers]
    shape = [free.index(name) for name in law.shape]
    size = np.array([getattr(fit.motor, name) for name in law.numbers])
    count = math.log(_freedom(fit))
    for other in chooser.candidates:
        if other in choice.laws:
            continue
        excess = math.inf
        for trial in other.trials(chooser.bench):
            added, _ = columns.of(other, trial)
            normal = columns.normal(added)
            rest = [k for k in range(normal.matrix.shape[0]) if k not in own and k not in shape]
            pull = normal.gradient[rest] - normal.matrix[np.ix_(rest, own)] @ size
            matrix = normal.matrix[np.ix_(rest, rest)]
            scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
            answer = np.linalg.lstsq(matrix / np.outer(scale, scale), pull / scale, rcond=1e-11)[0]
            rise = float(-2.0 * normal.gradient[own] @ size + size @ normal.matrix[np.ix_(own, own)] @ size)
            rise -= float(pull / scale @ answer)
            if other.one_sided and -(answer / scale)[-1] <= 0.0:
                continue
            excess = min(excess, rise)
        extra = len(other.numbers + other.shape) - len(law.numbers + law.shape)
        if excess / unit(fit) + extra * count < ALIKE:
            group.append(other.name)
    return tuple(group)


def _estimate(
    fit: Fit, covariance: Array, tests: Sequence[TimeSeries], plain: Estimate, periods_s: Sequence[float | None]
) -> Estimate:
    free, motor = fit.problem.free, fit.motor
    full = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    core = [name for name in CORE_OF if name in free]
    at = [free.index(name) for name in core]
    to = [PARAMETERS.index(CORE_OF[name]) for name in core]
    size = np.array([getattr(motor, name) if name in POSITIVE else 1.0 for name in core])
    full[np.ix_(to, to)] = covariance[np.ix_(at, at)] * np.outer(size, size)
    delay, delay_error = motor.delay_s, math.sqrt(full[4, 4])
    if DELAY not in free:
        delay, delay_error = plain.delay_s, 0.5 * (plain.ci95["delay_s"][1] - plain.ci95["delay_s"][0]) / 1.96
    values = (motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V, delay)
    errors = [*np.sqrt(np.diag(full))[:4].tolist(), delay_error]
    quantile = float(stdtrit(_freedom(fit), 0.975))
    noise = fit.problem.noise
    cut = fit.problem.cut
    white = fit.problem.whitened(fit.residual_rad)
    return Estimate(
        plain.method,
        *values,
        ci95={
            name: (value - quantile * error, value + quantile * error)
            for name, value, error in zip(PARAMETERS, values, errors, strict=True)
        },
        covariance=full,
        rms_rad=fit.rms_rad,
        iterations=len(fit.iterates),
        rows=plain.rows,
        iterates=fit.iterates,
        residual_rad=-fit.residual_rad,
        residual_t_s=cut.t_s,
        repeated=repeated_share(white, repetitions(cut.windows, periods_s)),
        coloured=None if noise.white else (noise.memory_s, math.sqrt(noise.ratio)),
    )
