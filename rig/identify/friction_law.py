"""The choice of a friction law: nested models, compared by Schwarz's criterion (BIC) and by prediction.

The candidates are the laws of `rig.identify.laws`. Each is a special case of the richer ones (docs/theory.md 8.1 and
8.4). Viscous friction is not a candidate: it only changes tau and K (docs/theory.md 8.1), so no motion can show it.

Each law is fitted to all tests but one. All laws get the noise of the richest law's residual. The fit gives Schwarz's
criterion. Then the law predicts the held-out test, which has another amplitude; only the initial state, and a delay
that is not recorded, are fitted there. A law replaces a simpler one only if criterion and prediction both gain clearly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from rig.identify import laws
from rig.identify.breakaway import Ramps, StaticFriction
from rig.identify.estimate import PARAMETERS, Estimate
from rig.identify.friction_fit import PLAIN, LawProblem, LawSolution
from rig.identify.laws.law import CLEAR, CandidateLaw, Doubt, LawComparison, LawNumber
from rig.identify.noise import noise_of
from rig.identify.output_error import OutputErrorProblem
from rig.identify.repetition import repeated_share, repetitions
from rig.recording.series import TimeSeries, joined_times_s
from rig.results import FrictionLawResult, LawFit, LawNumberResult

Standing = Literal["chosen", "too simple", "not needed", "open"]

BETTER = 1.1  # ratio of prediction errors of the held-out test that decides
MUCH_BETTER = 1.2  # ratio that keeps a law open although the criterion does not ask for it
OTHER_AMPLITUDE = 0.05  # relative difference of position or drive from which on two tests differ in amplitude
NORMAL_95 = 1.959964  # half of the 95 % interval over the standard error
ROUNDING = 1e-7  # residual over the spread of positions that is only rounding
SLOW = "record longer tests, and smaller and slower ones"


@dataclass(frozen=True)
class RankedLaw:
    """One law, fitted and compared.

    candidate           the law
    parameters, errors  tau_s, K_rad_s_V, fc_V, asym_V, delay_s and the law's own, and their standard errors; only
                        those that the law has and the tests show
    rms_rad             RMS residual of the fit, whitened, rad
    criterion           `schwarz` minus that of the chosen law: positive is worse
    held_out_rms_rad    RMS residual of the predicted held-out test, whitened, rad; None without such a test
    seen                whether the tests depend on the parameters that the law adds
    standing            "chosen"; "too simple"; "not needed": it gains too little; "open": the tests cannot tell it
                        from the chosen one
    """

    candidate: CandidateLaw
    parameters: Mapping[str, float]
    errors: Mapping[str, float]
    rms_rad: float
    criterion: float
    held_out_rms_rad: float | None
    seen: bool = True
    standing: Standing = "not needed"

    @property
    def law(self) -> str:
        """Its name."""
        return self.candidate.name

    def as_result(self) -> LawFit:
        """As an entry of ``rungs`` in result.json; a number that is not finite becomes None."""
        return LawFit(
            law=self.law,
            standing=self.standing,
            parameters=dict(self.parameters),
            standard_errors=dict(self.errors),
            own=tuple(self._own(number) for number in self.candidate.reports if number.name in self.parameters),
            rms_rad=self.rms_rad,
            criterion=self.criterion,
            held_out_rms_rad=self.held_out_rms_rad,
        )

    def _own(self, number: LawNumber) -> LawNumberResult:
        """A number that the law adds, with its interval."""
        value, half = self.parameters[number.name], NORMAL_95 * self.errors[number.name]
        ci95 = (value - half, value + half) if math.isfinite(half) else None
        return LawNumberResult(name=number.name, meaning=number.meaning, unit=number.unit, value=value, ci95=ci95)


@dataclass(frozen=True)
class FrictionLawChoice:
    """The compared laws, the chosen one, and why.

    ranked    the laws in the order of `LAWS`
    reason    why, as a sentence
    record    what to record to decide about the open laws; empty if none is open
    held_out  name of the held-out test; None if no test has another amplitude
    samples   effective number of independent samples in the fit
    """

    ranked: tuple[RankedLaw, ...]
    reason: str
    record: tuple[str, ...]
    held_out: str | None
    samples: float

    @property
    def chosen(self) -> RankedLaw:
        """The law that the data ask for."""
        return next(one for one in self.ranked if one.standing == "chosen")

    @property
    def open(self) -> tuple[str, ...]:
        """Laws that the tests cannot tell from the chosen one."""
        return tuple(one.law for one in self.ranked if one.standing == "open")

    @property
    def viscous(self) -> str:
        """Why viscous friction is not a candidate, as a sentence."""
        own = self.chosen.parameters
        return (
            "viscous friction is part of tau and K, and no motion can tell it from them; "
            f"tau / K = {own['tau_s'] / own['K_rad_s_V']:.4g} V s²/rad is the same with and without it"
        )

    def of(self, law: str) -> RankedLaw:
        """The law of this name. Raises KeyError if it is not a candidate."""
        return {one.law: one for one in self.ranked}[law]

    def better(self, law: str, than: str) -> float | None:
        """Error of law ``than`` over that of ``law`` in predicting the held-out test; None without one."""
        return _better(self.of(law), self.of(than))

    @property
    def beyond_coulomb(self) -> str | None:
        """Why an estimate with Coulomb friction and asymmetry is not enough, as a sentence; None if it is."""
        law = self.chosen.candidate
        better = self.better(law.name, PLAIN.name) if law.parameters else None
        if better is None or better <= BETTER:
            return None
        return (
            f"{law.title}: it predicts {self.held_out} {better:.1f} times better than asymmetric Coulomb friction; "
            "use tau, K and f_c only for motion like the recorded one"
        )

    def as_result(self) -> FrictionLawResult:
        """As result.json holds it; a number that is not finite becomes None."""
        return FrictionLawResult(
            chosen=self.chosen.law,
            open=self.open,
            reason=self.reason,
            record=self.record,
            viscous=self.viscous,
            held_out=self.held_out,
            effective_samples=self.samples,
            rungs=tuple(one.as_result() for one in self.ranked),
        )

    def notes(self) -> list[str]:
        """One or two lines for people."""
        lines = [f"friction law: {self.reason}"]
        return lines + ([f"friction law: to tell more, {'; '.join(self.record)}"] if self.record else [])


def schwarz(squares: float, rows: int, parameters: int, samples: float) -> float:
    """Schwarz's criterion (BIC, Annals of Statistics 6, 1978) of a fit, N ln(S / n) + k ln N, up to a constant.

    squares     S, sum of squared whitened residuals, > 0
    rows        n, number of residuals
    parameters  k, number of fitted parameters
    samples     N <= n, effective number of independent samples; likelihood and penalty both use it
    """
    return samples * math.log(squares / rows) + parameters * math.log(samples)


def effective_samples(rows: int, cycles: float, repeated: float) -> float:
    """Effective number of independent samples of a residual that partly repeats in each cycle.

    n / (1 + (m - 1) rho), the design effect of clusters (Kish, Survey Sampling, 1965), one for each phase of the cycle.

    rows      n, number of residuals
    cycles    m, number of cycles
    repeated  rho, share of the residual's power that repeats, 0 to 1
    """
    return rows / (1.0 + max(0.0, cycles - 1.0) * repeated)


def friction_law(
    tests: Sequence[TimeSeries],
    estimate: Estimate,
    periods_s: Sequence[float | None] | None = None,
    breakaway: StaticFriction | None = None,
) -> FrictionLawChoice:
    """Choose the friction law for all tests.

    estimate   the sampled-data estimate of these tests: the fits start from it
    periods_s  for each test the period of its limit cycle, s, or None; default: no test has a cycle
    breakaway  static levels from slow ramps; None without ramps
    The held-out test is the last one whose position or drive swings 5 % more or less than in the first test.
    Raises IdentifyError if a test is too short for a fit.
    """
    periods = list(periods_s or [None] * len(tests))
    held = _second_amplitude(tests)
    fitted = [k for k in range(len(tests)) if k != held]
    unknown = any(test.t_u_s is None for test in tests)
    reach = (0.0, max(test.longest_delay_s for test in tests)) if unknown else (0.0, 0.0)
    windows = [test.predictable(reach[1]) for test in tests]
    problem = OutputErrorProblem(tuple(windows[k] for k in fitted), reach, (True, True, True, True, unknown))
    first = LawProblem(problem, Ramps.of(breakaway, estimate))
    fits = first.fit(first.start(estimate))
    floor = ROUNDING * first.spread_rad
    times = joined_times_s(first.windows)
    richest = max(laws.LAWS, key=lambda law: law.size).name
    if fits[richest].rms_rad > floor:
        noise = noise_of(fits[richest].residual, times, problem.lengths())
        if not noise.white:
            first = replace(first, problem=replace(problem, noise=noise))
            fits = first.fit(fits[PLAIN.name].x)
    own = [periods[k] for k in fitted]
    share = repeated_share(fits[richest].residual, repetitions(first.windows, own))
    pairs = zip(first.windows, own, strict=True)
    cycles = max((window.duration_s / period for window, period in pairs if period), default=1.0)
    samples = effective_samples(times.size, cycles, share)
    second = None if held is None else replace(first, problem=replace(first.problem, windows=(windows[held],)))
    ranked = [_ranked(fit, second, samples, floor, first.ramps) for fit in fits.values()]
    return _choice(ranked, None if held is None else tests[held].name, samples, first.ramps)


def _second_amplitude(tests: Sequence[TimeSeries]) -> int | None:
    """Index of the last test whose position or drive swings clearly more or less than in the first; else None."""
    swings = []
    for test in tests:
        line = np.polynomial.Polynomial.fit(test.t_s, test.y_rad, 1)
        swings.append((float(np.std(test.y_rad - line(test.t_s))), float(np.std(test.u_V))))
    first = swings[0]
    for k in range(len(tests) - 1, 0, -1):
        if any(abs(own - other) > OTHER_AMPLITUDE * other for own, other in zip(swings[k], first, strict=True)):
            return k
    return None


def _ranked(
    fit: LawSolution, second: LawProblem | None, samples: float, floor_rad: float, ramps: Ramps | None
) -> RankedLaw:
    """A fitted law with its criterion and its prediction of the held-out test, not compared yet."""
    names = [name for name in PARAMETERS if name in fit.fitted]
    own = fit.law.report(fit, ramps)
    parameters = {name: fit.value(name) for name in names} | own.parameters
    errors = {name: error for name in names if (error := fit.error(name)) is not None} | own.errors
    ramps_squared = 0.0  # part of the breakaway ramps in twice the negative log likelihood
    if ramps is not None and all(ramps.significant) and not fit.law.has_static_level:
        ramps_squared = max(0.0, ramps.fs_V - fit.value("fc_V")) ** 2 / (ramps.error_V**2 + errors["fc_V"] ** 2)
    rows = fit.residual.size
    squares = max(fit.squares, rows * floor_rad**2)  # below rounding there is nothing to explain
    count = fit.law.size + ("delay_s" in fit.fitted)
    return RankedLaw(
        fit.law,
        parameters,
        errors,
        fit.rms_rad,
        schwarz(squares, rows, count, samples) + ramps_squared,
        None if second is None else max(second.predict(fit).rms_rad, floor_rad),
        fit.seen,
    )


def _better(own: RankedLaw, other: RankedLaw) -> float | None:
    """Error of ``other`` over that of ``own`` in predicting the held-out test; None without one."""
    if own.held_out_rms_rad is None or other.held_out_rms_rad is None:
        return None
    return other.held_out_rms_rad / own.held_out_rms_rad


def _choice(
    ranked: Sequence[RankedLaw], held_out: str | None, samples: float, ramps: Ramps | None
) -> FrictionLawChoice:
    """The simplest law that neither criterion nor prediction rejects, and the laws that stay open."""
    chosen = ranked[0]
    reason = f"{chosen.candidate.title} is enough"
    simpler: list[str] = []
    doubts: dict[str, tuple[CandidateLaw, Doubt]] = {}
    for k, one in enumerate(ranked[1:], 1):
        judged = _judge(one, chosen, held_out, ramps)
        if isinstance(judged, str):
            chosen, reason, doubts = one, judged, {}
            simpler = [other.law for other in ranked[:k]]
        elif judged is not None:
            doubts[one.law] = one.candidate, judged
    reason = "; ".join([reason, *(f"{law.title} stays open: {doubt.reason}" for law, doubt in doubts.values())])
    record = tuple(dict.fromkeys(doubt.record for _, doubt in doubts.values()))

    def standing(law: str) -> Standing:
        if law == chosen.law:
            return "chosen"
        if law in doubts:
            return "open"
        return "too simple" if law in simpler else "not needed"

    settled = (replace(one, standing=standing(one.law), criterion=one.criterion - chosen.criterion) for one in ranked)
    return FrictionLawChoice(tuple(settled), reason, record, held_out, samples)


def _judge(one: RankedLaw, chosen: RankedLaw, held_out: str | None, ramps: Ramps | None) -> str | Doubt | None:
    """Why a law replaces the simpler ``chosen`` one, as a sentence; a doubt if it may; None if it is not needed."""
    gain = chosen.criterion - one.criterion
    better = _better(one, chosen)
    title, simpler = one.candidate.title, chosen.candidate.title
    gained = f"its BIC is {gain:.0f} lower than that of {simpler}"
    against = LawComparison(title, gained, gain, one.seen, ramps)
    first = one.candidate.needs(against)
    if first is not None:
        return first
    if better is None:
        return one.candidate.from_one_amplitude(against)
    predicted = f"it predicts {held_out} {better:.2g} times better"
    if gain > CLEAR and better > BETTER:
        return f"{title}: {gained}, and {predicted}"
    if gain > CLEAR:
        return Doubt(f"{gained}, but it predicts {held_out} no better ({better:.2g} times)", SLOW)
    if gain > 0.0:
        return Doubt(f"{gained}, too little to decide", SLOW)
    if better > MUCH_BETTER:
        return Doubt(f"{predicted}, but its BIC is no lower than that of {simpler}", SLOW)
    return None
