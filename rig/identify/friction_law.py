"""Which friction law the data ask for: a ladder of four laws, each a case of the next (docs/theory.md 8.1 and 8.4).

    coulomb     fc sgn(v)
    asymmetric  + a: the two directions differ, or there is a bias
    static      + fs > fc, at rest alone: seen only where the motor stands still under a drive (breakaway, slow drives)
    stribeck    + vs: fs falls to fc over the speed vs, fc + (fs - fc) exp(-|v| / vs)

Viscous friction is no rung: with it tau and K are those of docs/theory.md 8.1, and no motion tells it from them.

Each law is fitted to all tests but one by the same least squares with the same noise, that of the richest law's
residual, and gets Schwarz's criterion. Then it predicts the test that was held out, of another amplitude, where its
initial state alone (and a delay that is not recorded) is fitted. A law replaces a simpler one only if both gain
clearly. From one amplitude Stribeck friction is never chosen: there it looks much like another tau, K and fc.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.identify.breakaway import Breakaway
from rig.identify.estimate import PARAMETERS, Estimate
from rig.identify.friction_fit import LAWS, ROUNDING, Fit, Law, Tests
from rig.identify.noise import noise_of
from rig.identify.sampled_data import Piece, Problem, repeated_share, repetitions
from rig.recording.series import Record
from rig.results import FrictionLawResult, LawFit

Array = NDArray[np.float64]
Standing = Literal["chosen", "too simple", "not needed", "open"]

TITLES: dict[Law, str] = {
    "coulomb": "Coulomb friction",
    "asymmetric": "asymmetric Coulomb friction",
    "static": "Coulomb friction with a static level",
    "stribeck": "Stribeck friction",
}
CLEAR = 10.0  # difference of criterion that decides ("very strong", Kass & Raftery, J. Am. Stat. Assoc. 90, 1995)
BETTER = 1.1  # ratio of prediction errors of the held-out test that decides
MUCH_BETTER = 1.2  # the same, that keeps a law open which the criterion does not ask for
OTHER_AMPLITUDE = 0.05  # relative difference of position or drive that makes a test one of another amplitude

SECOND_AMPLITUDE = "record a second relay test of another amplitude"
RAMPS = "record breakaway ramps both ways"
SLOW_RAMPS = "record breakaway ramps again, slower"
SLOW = "record longer tests, and smaller and slower ones"


@dataclass(frozen=True)
class Rung:
    """One law of the ladder, fitted.

    parameters, errors  tau_s, K_rad_s_V, fc_V, asym_V, delay_s, fs_V, stribeck_rad_s as far as the law has them and the
                        tests tell them; and their standard errors
    rms_rad             of the fit, whitened
    criterion           `schwarz`, less that of the chosen law: positive is worse
    held_out_rms_rad    of the prediction of the test that was held out, whitened; None without one
    seen                whether the tests depend on what the law adds
    standing            "chosen"; "too simple"; "not needed": what it adds does not pay; "open": the tests cannot tell
                        it from the chosen one
    """

    law: Law
    parameters: Mapping[str, float]
    errors: Mapping[str, float]
    rms_rad: float
    criterion: float
    held_out_rms_rad: float | None
    seen: bool = True
    standing: Standing = "not needed"


@dataclass(frozen=True)
class Ladder:
    """The laws, which is chosen, and why.

    rungs     in the order of `LAWS`
    reason    in words
    record    what to record to tell the open ones from the chosen one; empty if none is open
    held_out  name of the test that was held out; None if there is none of another amplitude
    samples   how many independent samples the fitted ones are worth
    """

    rungs: tuple[Rung, ...]
    reason: str
    record: tuple[str, ...]
    held_out: str | None
    samples: float

    @property
    def chosen(self) -> Rung:
        """The law that the data ask for."""
        return next(rung for rung in self.rungs if rung.standing == "chosen")

    @property
    def open(self) -> tuple[Law, ...]:
        """Laws that the tests cannot tell from the chosen one."""
        return tuple(rung.law for rung in self.rungs if rung.standing == "open")

    @property
    def viscous(self) -> str:
        """What became of viscous friction, in words."""
        own = self.chosen.parameters
        return (
            "viscous friction is within tau and K, no motion tells it from them; "
            f"tau / K = {own['tau_s'] / own['K_rad_s_V']:.4g} V s^2/rad is the same with and without it"
        )

    def better(self, law: Law, than: Law) -> float | None:
        """How many times smaller the error is with which ``law`` predicts the held-out test; None without one."""
        own, other = self.rungs[LAWS.index(law)], self.rungs[LAWS.index(than)]
        return _better(own, other)

    @property
    def beyond_coulomb(self) -> str | None:
        """Why an estimate with Coulomb friction and asymmetry is not enough, as a sentence; None if it is."""
        law = self.chosen.law
        better = self.better(law, "asymmetric") if law in ("static", "stribeck") else None
        if better is None or better <= BETTER:
            return None
        return (
            f"{TITLES[law]}: {self.held_out} is predicted {better:.1f} times better than without; "
            "tau, K and fc are good for motion like the recorded one only"
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
            rungs=tuple(
                LawFit(
                    law=rung.law,
                    standing=rung.standing,
                    parameters=dict(rung.parameters),
                    standard_errors=dict(rung.errors),
                    rms_rad=rung.rms_rad,
                    criterion=rung.criterion,
                    held_out_rms_rad=rung.held_out_rms_rad,
                )
                for rung in self.rungs
            ),
        )

    def notes(self) -> list[str]:
        """One or two lines for people."""
        lines = [f"friction law: {self.reason}"]
        return lines + ([f"friction law: to tell more, {'; '.join(self.record)}"] if self.record else [])


def schwarz(squares: float, rows: int, parameters: int, samples: float) -> float:
    """Schwarz's criterion (BIC, Annals of Statistics 6, 1978) of a fit, N ln(S / n) + k ln N, up to a constant.

    squares     S, sum of squared whitened residuals, > 0
    rows        n, their number
    parameters  k, fitted
    samples     N <= n, how many independent samples they are worth: likelihood and penalty both count these
    """
    return samples * math.log(squares / rows) + parameters * math.log(samples)


def effective_samples(rows: int, cycles: float, repeated: float) -> float:
    """How many independent samples ``rows`` are worth if a share ``repeated`` of their power comes again each cycle.

    n / (1 + (m - 1) rho), the design effect of clusters (Kish, Survey Sampling, 1965), one for each phase of the cycle.
    """
    return rows / (1.0 + max(0.0, cycles - 1.0) * repeated)


def friction_law(
    records: Sequence[Record],
    estimate: Estimate,
    periods_s: Sequence[float | None] | None = None,
    breakaway: Breakaway | None = None,
) -> Ladder:
    """The ladder on all records.

    estimate   the sampled-data estimate of these records: where the fits start
    periods_s  for each record the period of its limit cycle, s, or None; default: none have
    breakaway  static levels from slow ramps, where there are any
    The test held out is the last record in which position or drive swings 5 % more or less than in the first.
    Raises IdentifyError if a record is too short to be fitted.
    """
    periods = list(periods_s or [None] * len(records))
    held = _second_amplitude(records)
    fitted = [k for k in range(len(records)) if k != held]
    unknown = any(record.t_u_s is None for record in records)
    reach = (0.0, max(record.longest_delay_s for record in records)) if unknown else (0.0, 0.0)
    pieces = [Piece.of(record, reach[1]) for record in records]
    problem = Problem(tuple(pieces[k] for k in fitted), reach, (True, True, True, True, unknown))
    ramps = _Ramps.of(breakaway, estimate)
    tests = Tests(problem, None if ramps is None else ramps.fs_V)
    fits = tests.fit(tests.start(estimate))
    floor = ROUNDING * tests.spread_rad
    times = np.concatenate([piece.t_s for piece in tests.pieces])
    if fits["stribeck"].rms_rad > floor:
        noise = noise_of(fits["stribeck"].residual, times, problem.lengths())
        if not noise.white:
            tests = replace(tests, problem=replace(problem, noise=noise))
            fits = tests.fit(fits["asymmetric"].x)
    own = [periods[k] for k in fitted]
    share = repeated_share(fits["stribeck"].residual, repetitions(tests.pieces, own))
    lengths_s = [float(piece.t_s[-1] - piece.t_s[0]) for piece in tests.pieces]
    cycles = max((length / period for length, period in zip(lengths_s, own, strict=True) if period), default=1.0)
    samples = effective_samples(times.size, cycles, share)
    second = None if held is None else replace(tests, problem=replace(tests.problem, pieces=(pieces[held],)))
    rungs = [_rung(fits[law], second, samples, floor, ramps) for law in LAWS]
    return _ladder(rungs, None if held is None else records[held].name, samples, ramps)


class _Ramps(NamedTuple):
    """Static level from ramps both ways, V; its standard error, V; and whether each way alone shows one (95 %).

    They take friction for fc as soon as the motor moves: with Stribeck friction it seems to break away later.
    """

    fs_V: float
    error_V: float
    shown: tuple[bool, bool]

    @classmethod
    def of(cls, breakaway: Breakaway | None, estimate: Estimate) -> _Ramps | None:
        if breakaway is None or breakaway.plus is None or breakaway.minus is None:
            return None
        plus, minus = breakaway.plus, breakaway.minus
        moving = estimate.fc_V - estimate.asym_V, estimate.fc_V + estimate.asym_V
        return cls(
            0.5 * (plus.static_V + minus.static_V),
            0.5 * math.hypot(plus.error_V, minus.error_V),
            (plus.low_V > moving[0], minus.low_V > moving[1]),
        )


def _second_amplitude(records: Sequence[Record]) -> int | None:
    """The last record whose position or drive swings clearly more or less than the first's."""
    swings = []
    for record in records:
        line = np.polynomial.Polynomial.fit(record.t_s, record.y_rad, 1)
        swings.append((float(np.std(record.y_rad - line(record.t_s))), float(np.std(record.u_V))))
    first = swings[0]
    for k in range(len(records) - 1, 0, -1):
        if any(abs(own - other) > OTHER_AMPLITUDE * other for own, other in zip(swings[k], first, strict=True)):
            return k
    return None


def _rung(fit: Fit, second: Tests | None, samples: float, floor_rad: float, ramps: _Ramps | None) -> Rung:
    names = [name for name in PARAMETERS if name in fit.fitted]
    parameters = {name: fit.value(name) for name in names}
    errors = {name: fit.errors[name] for name in names}
    fs_V = fit.value("fc_V") + fit.value("excess_V")
    if "excess_V" in fit.fitted:
        parameters |= {"fs_V": fs_V, "stribeck_rad_s": fit.value("stribeck_rad_s")}
        errors |= {"fs_V": fit.errors["fs_V"], "stribeck_rad_s": fit.errors["stribeck_rad_s"]}
    elif fit.law == "static" and (ramps is not None or fit.value("excess_V") > 0.0):
        parameters["fs_V"] = fs_V
        errors["fs_V"] = math.nan if ramps is None else ramps.error_V
    ramps_squared = 0.0  # what the breakaway record adds to twice the negative log likelihood
    if ramps is not None and all(ramps.shown) and fit.law in ("coulomb", "asymmetric"):
        ramps_squared = max(0.0, ramps.fs_V - fs_V) ** 2 / (ramps.error_V**2 + errors["fc_V"] ** 2)
    rows = fit.residual.size
    squares = max(fit.squares, rows * floor_rad**2)  # below rounding there is nothing to explain
    count = 3 + LAWS.index(fit.law) + ("delay_s" in fit.fitted)
    return Rung(
        fit.law,
        parameters,
        errors,
        fit.rms_rad,
        schwarz(squares, rows, count, samples) + ramps_squared,
        None if second is None else max(second.predict(fit).rms_rad, floor_rad),
        fit.seen,
    )


def _better(own: Rung, other: Rung) -> float | None:
    """How many times smaller the error is with which ``own`` predicts the held-out test; None without one."""
    if own.held_out_rms_rad is None or other.held_out_rms_rad is None:
        return None
    return other.held_out_rms_rad / own.held_out_rms_rad


def _ladder(rungs: Sequence[Rung], held_out: str | None, samples: float, ramps: _Ramps | None) -> Ladder:
    """Climb: the simplest law that neither the criterion nor the prediction rejects, and what stays open above it."""
    chosen = rungs[0]
    reason = f"{TITLES[chosen.law]} is enough"
    doubts: dict[Law, _Doubt] = {}
    for rung in rungs[1:]:
        judged = _judge(rung, chosen, held_out, ramps)
        if isinstance(judged, str):
            chosen, reason, doubts = rung, judged, {}
        elif judged is not None:
            doubts[rung.law] = judged
    reason = "; ".join([reason, *(f"{TITLES[law]} stays open: {doubt.reason}" for law, doubt in doubts.items())])
    record = tuple(dict.fromkeys(doubt.record for doubt in doubts.values()))

    def standing(law: Law) -> Standing:
        if law == chosen.law:
            return "chosen"
        if law in doubts:
            return "open"
        return "too simple" if LAWS.index(law) < LAWS.index(chosen.law) else "not needed"

    settled = (
        replace(rung, standing=standing(rung.law), criterion=rung.criterion - chosen.criterion) for rung in rungs
    )
    return Ladder(tuple(settled), reason, record, held_out, samples)


class _Doubt(NamedTuple):
    """Why a law cannot be told from the chosen one, and what to record instead."""

    reason: str
    record: str


def _judge(rung: Rung, chosen: Rung, held_out: str | None, ramps: _Ramps | None) -> str | _Doubt | None:
    """Why ``rung`` replaces the simpler ``chosen``, as a sentence; or the doubt that it might; None if not needed."""
    gain = chosen.criterion - rung.criterion
    better = _better(rung, chosen)
    title, simpler = TITLES[rung.law], TITLES[chosen.law]
    gained = f"the criterion gains {gain:.0f} over {simpler}"
    if rung.law == "static":
        if ramps is not None and any(ramps.shown):
            if all(ramps.shown) and gain > CLEAR:
                return f"{title}: both breakaway ramps show it, and {gained}"
            return _Doubt("the breakaway ramps do not show it clearly both ways", SLOW_RAMPS)
        if ramps is None and not rung.seen:
            return _Doubt("the motor never stands still under a drive that could hold it", RAMPS)
    if better is None:
        if rung.law == "asymmetric":  # within each cycle the two directions are told apart
            return f"{title}: {gained}" if gain > CLEAR else None
        if rung.law == "stribeck":
            wants = f"{gained}, but " if gain > CLEAR else ""
            return _Doubt(f"{wants}at one amplitude it looks like another tau, K and fc", SECOND_AMPLITUDE)
        return _Doubt(f"{gained}, without a second amplitude", SECOND_AMPLITUDE) if gain > CLEAR else None
    predicted = f"{held_out} is predicted {better:.2g} times better"
    if gain > CLEAR and better > BETTER:
        return f"{title}: {gained}, and {predicted}"
    if gain > CLEAR:
        return _Doubt(f"{gained}, but {held_out} is predicted no better ({better:.2g} times)", SLOW)
    if gain > 0.0:
        return _Doubt(f"{gained}, too little to decide", SLOW)
    if better > MUCH_BETTER:
        return _Doubt(f"{predicted}, but the criterion gains nothing over {simpler}", SLOW)
    return None
