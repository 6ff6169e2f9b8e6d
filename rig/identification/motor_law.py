"""The law of the motor: which departures from the plain one its tests show, and what tau, K and friction are with them.

The plain estimate is the start. ``rig.identification.departures`` chooses the laws on pieces of the tests. This module
turns the choice into an estimate with its intervals, names laws that look alike, and draws up the uncertainty budget.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.core.arrays import Array
from rig.core.motor_numbers import AT_REST_V
from rig.identification.chance import student_975
from rig.identification.departures import BY_NAME, DEPARTURES
from rig.identification.departures.blocks import Blocks, HeldOut, held_out
from rig.identification.departures.budget import COVERAGE, OTHER, Budget, Entry, budget
from rig.identification.departures.choice import AT_NOISE, Choice, Chooser, as_likely, levels
from rig.identification.departures.coupled import coupling_of, damped_at_bound, lag_line, takes_enough
from rig.identification.departures.departure import Departure
from rig.identification.departures.fit import CORE, DELAY, POSITIVE, Fit, Known, solve, sums_of_pieces, unit
from rig.identification.departures.fit import start as begin
from rig.identification.departures.in_place import bare_fits, gained, in_place, nearly_as_good
from rig.identification.departures.laws import DRIFT_EACH, LEVEL_EACH, SOFT_COUPLING, level_each
from rig.identification.departures.nuisances import OF, Nuisances
from rig.identification.departures.outside import INSTEAD_OF, instead_of_sag, outside
from rig.identification.departures.pieces import Coupling, Cut
from rig.identification.departures.profile import profiles, untold
from rig.identification.departures.rounding import by_neighbours, by_rounding
from rig.identification.driven import bears
from rig.identification.estimate import PARAMETERS, Estimate, intervals
from rig.identification.further import Further, agreeing
from rig.identification.hanging_load import behind_a_gear
from rig.identification.model_error import (
    MANY_LAWS,
    NOT_SHOWN,
    TIMES,
    UNTOLD,
    WAITED,
    any_bend,
    model_error,
    of_long_lag,
    of_one_size,
    of_shift,
    only_like,
)
from rig.identification.noise import WHITE
from rig.identification.opinion import RecordingEstimate
from rig.identification.plausibility import IS_CURRENT, LONG_TAU_S, one_way
from rig.identification.repetition import repeated_share, repetitions
from rig.identification.stated_errors import ScaleErrors, StatedErrors
from rig.identification.thinning import showing_the_angle, thinned
from rig.identification.verdict import (
    ASKED,
    MORE_CYCLES,
    PROMISE,
    RISK,
    TITLES,
    beside,
    in_percent,
    known_to,
    reserved,
    sizes_of,
)
from rig.model.real_motor import FramedMotor, RealMotor
from rig.run_folder.recording.series import TimeSeries, Window, delays_of_all_s, noise_of_all_rad
from rig.run_folder.recording.stage import StageKind
from rig.run_folder.results import (
    Answer,
    BudgetEntry,
    EstimateResult,
    FittedRecord,
    FoundLawResult,
    GradedNumber,
    HoldsResult,
    LawFrameResult,
    MotorLawResult,
    PieceResult,
    PredictsResult,
)
from rig.run_folder.results.answer import answer_of
from rig.run_folder.results.answer_words import NOT_KNOWN

GRADES = {"exact": ASKED, "good": 0.10, "rough": 0.25}  # half width of u95, relative to the number: at most
WITH_DEAD_BAND = (
    "f_c has in it what a dead band of the drive would take: the drive never rests, nor pushes against the motion"
)
ALIKE = 6.0  # difference in BIC within which two laws are not told apart
TURNS_BACK = 0.2  # of the whole motion: a way back shorter than that is no turn
# of a record without a cycle: so many time constants count as one, at least, at most, and at most a part of all, s
NO_CYCLE_TAUS, SHORTEST_S, LONGEST_S, NO_CYCLE = 3.3, 0.17, 2.2, 12.0
MOST_ROWS, FEWER_ROWS = 8000, 2000  # of all tests; where a fit leaves more than noise, rows are not what bounds it
LEAVES, LONG_LEAVES = 8.0, 2.0  # residual over the sensor's noise of such a fit; of tests of more than ``MOST_ROWS``
LATE_ROWS = 2.0  # delay of a bench that is late
ROUNDS = 3  # in which records that disagree with the tests are cut, before none of them is used
EXPLAINED = 1.5  # residual over the sensor's noise, at most, of laws that leave little else: then rows bound the answer
MOST_SURVEY_ROWS = 4000
AT_REST = 0.02  # of the largest speed: below it the shaft counts as at rest
SPEED_OVER_S = 0.1
FURTHER_CYCLES = 0.9  # longest pieces of records beside the tests, in cycles
ROWS_OF_TAU, FEWER_OF_TAU = 20, 5  # at least so many of the rows taken as one have room in tau
SMALLEST_NOISE = 1e-6  # of the sensor, relative to half the travel: of a record without noise
CORE_OF = dict(zip((*CORE, DELAY), PARAMETERS, strict=True))


def graded(value: float, half: float | None, size: float) -> GradedNumber:
    """How good a number is.

    value  in any unit
    half   its half width at 95 %, in the same unit; None: not known
    size   what that is relative to, in the same unit; >= 0
    """
    share = half / size if half is not None and size > 0.0 and math.isfinite(half) else math.inf
    grade = next((grade for grade, most in GRADES.items() if share <= most), NOT_KNOWN)
    return GradedNumber(value=None if grade == NOT_KNOWN else value, u95=half, grade=grade)


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
    estimate        tau, K, friction, asymmetry and delay with these laws, from all records; None if that is the plain
                    estimate: no laws, and no records beside the tests
    budget          what may be wrong in them
    motor           with these laws: numbers of ``estimate`` and of ``found``; None without any
    growth          length of the pieces that were fitted, s, and their RMS residual, rad; the last one is the free run,
                    in which the tests are predicted whole, and only their starts are fitted
    records         what was fitted
    remarks         a sentence for each record that was left out, or not whole; and on what f_c holds
    alone           tau, K and friction of each recording alone, with the laws as they are for all
    bounded         a sentence for each number at a bound of the fit
    predicts        how well this motor predicts blocks that it was not fitted to; None: not looked at
    holds           the drives, speeds and travel of the tests
    explains        whether laws were found, and nothing but u95 is left against the estimate with them: what else is
                    wrong with a plain estimate comes from the laws
    """

    found: tuple[FoundLaw, ...]
    not_told_apart: tuple[tuple[str, ...], ...]
    estimate: Estimate | None
    budget: Budget
    growth: tuple[tuple[float, float], ...]
    records: tuple[FittedRecord, ...] = ()
    remarks: tuple[str, ...] = ()
    alone: tuple[RecordingEstimate, ...] = ()
    motor: FramedMotor | None = None
    explains: bool = False
    bounded: tuple[str, ...] = ()
    predicts: HeldOut | None = None
    holds: HoldsResult | None = None

    def notes(self) -> list[str]:
        """What the tests show, as sentences."""
        lines = [*self.remarks, *(f"law: {law.in_words()}" for law in self.found)]
        for group in self.not_told_apart:
            titles = " and ".join(BY_NAME[name].title for name in group)
            lines.append(f"law: {titles} are not told apart; record {BY_NAME[group[0]].told_by}")
        return lines

    def judged(self, largest_V: float, estimate: Estimate) -> MotorLaw:
        """The same with the verdict of ``estimate``, which is its own, and its reservations."""
        law = replace(self, estimate=estimate, explains=bool(self.found) and estimate.verdict == "ok")
        reservations = law.reservations(estimate, largest_V)
        return replace(law, estimate=reserved(estimate, reservations))

    def without_laws(self) -> MotorLaw:
        """The same, but for the laws and their estimate: the plain one holds."""
        return replace(self, found=(), not_told_apart=(), estimate=None, motor=None)

    def reservations(self, estimate: Estimate, largest_V: float) -> list[str]:
        """Why an estimate of these tests cannot be ok, as sentences: the laws that it has not, else too large a u95.

        largest_V   largest drive of the tests, V
        Where an estimate lacks laws, u95 is a matter of the estimate that has them.
        """
        instead = self.instead_of(estimate, largest_V)
        return list(self._too_uncertain(estimate, sizes_of(estimate, largest_V))) if instead is None else [instead]

    def instead_of(self, estimate: Estimate, largest_V: float) -> str | None:
        """Why to take ``self.estimate`` in place of this one, as a sentence; None if it is as good.

        largest_V   largest drive of the tests, V
        """
        if self.estimate is None or estimate is self.estimate:
            return None
        sizes = sizes_of(estimate, largest_V)
        off = {name: abs(getattr(estimate, name) - getattr(self.estimate, name)) / sizes[name] for name in sizes}
        name = max(off, key=lambda key: off[key])
        is_off = off[name] > ASKED
        share = f"{TITLES[name]} is {in_percent(off[name])} off"
        if not self.found:
            which = "and that fit is refused" if self.estimate.verdict == "refused" else "the answer is from these"
            return f"{share}, by all records in pieces: {which}" if is_off else None
        if not is_off and not (self.explains and estimate.verdict != "ok"):
            return None
        laws, them = _listed(one.law.title for one in self.found), "them" if len(self.found) > 1 else "it"
        cause = f"{share}, for the motor has {laws}" if is_off else f"the motor has {laws}"
        if self.estimate.verdict == "refused":
            return f"{cause}; the estimate with {them} is refused, too"
        return f"{cause}: the answer has {them}"

    def _too_uncertain(self, estimate: Estimate, sizes: Mapping[str, float]) -> Iterator[str]:
        shares = {name: self.budget.u95[name] / size for name, size in sizes.items()}
        name = max(shares, key=lambda key: shares[key])
        if shares[name] <= ASKED:
            yield from self._may_be_off(sizes)
            return
        own = (entry for entry in self.budget.entries if not entry.absolute)
        largest = max(own, key=lambda entry: float(getattr(entry, name)))
        known = known_to(name, shares[name])
        laws = [law for key, law in BY_NAME.items() if key in largest.laws]
        cures = _listed(dict.fromkeys(law.told_by for law in laws))
        if unshown := [NOT_SHOWN[entry.source] for entry in self.budget.entries if entry.source in NOT_SHOWN]:
            yield f"{known}: {'; '.join(unshown)}"
        elif largest.source == TIMES:
            yield f"{known}: {WAITED}"
        elif largest.source.startswith(OTHER):
            what = " or ".join(law.title for law in laws)
            yield f"{known}: most of it is that these tests do not tell {what}; record {cures}"
        elif laws:
            yield f"{known}: most of it is {self._unknown(largest.laws)}; record {cures}"
        elif name == "tau_s" and sizes[name] > LONG_TAU_S:
            yield f"{known}, and may have no end: record longer strokes; or {IS_CURRENT}"
        else:
            yield f"{known}: {MORE_CYCLES}"

    def _may_be_off(self, sizes: Mapping[str, float]) -> Iterator[str]:
        """u95 is small also where a law is improbable and large: then the promise can be broken all the same."""
        likely = {name: self.budget.hidden.beyond(name, PROMISE * size) for name, size in sizes.items()}
        name = max(likely, key=lambda key: likely[key][0])
        probability, hidden = likely[name]
        if probability <= RISK:
            return
        cures = _listed(dict.fromkeys(law.told_by for key, law in BY_NAME.items() if key in hidden))
        risk, allowed = beside(100.0 * probability, 100.0 * RISK), f"{100.0 * RISK:.2g}"
        yield (
            f"{TITLES[name]} is more than {100.0 * PROMISE:.2g} % off with a probability of {risk} %; "
            f"ok bears {allowed} %: most of it is {self._unknown(hidden)}; record {cures}"
        )

    def _unknown(self, names: Sequence[str]) -> str:
        """What these tests do not say of laws."""
        what = _listed(law.title for key, law in BY_NAME.items() if key in names)
        if {one.law.name for one in self.found}.issuperset(names):
            return f"the size of {what}, which these tests do not tell"
        return f"{what}, which these tests do not exclude"

    def as_result(self) -> MotorLawResult:
        """What the answer was fitted to, as in result.json."""
        return MotorLawResult(
            not_told_apart=self.not_told_apart,
            ok_asks_u95_percent=100.0 * ASKED,
            budget=tuple(map(BudgetEntry.of, self.budget.entries)),
            pieces=tuple(PieceResult(length_s=length, rms_rad=rms) for length, rms in self.growth),
            law_records=self.records,
        )

    def graded(self, estimate: Estimate, largest_V: float) -> dict[str, GradedNumber]:
        """How good each number of an estimate of these tests is, by u95."""
        sizes, turns_both = sizes_of(estimate, largest_V), self.holds is None or self.holds.ways == "both"
        found = {}
        for name, size in sizes.items():
            found[name] = graded(getattr(estimate, name), self.budget.u95[name], size)
        if not turns_both:
            found["fc_less_bias_V"], found["fc_V"] = found["fc_V"], GradedNumber(grade=NOT_KNOWN)
        return found

    def answer(
        self, estimates: Mapping[str, EstimateResult], estimate: Estimate | None, largest_V: float
    ) -> Answer | None:
        """The answer with these laws; None without an estimate.

        estimates   by method, of the plain motor
        estimate    that of the answer
        largest_V   largest drive of the tests, V
        """
        predicts = self.predicts
        return answer_of(
            estimates,
            grade=None if estimate is None or not estimate.is_motor else self.graded(estimate, largest_V),
            predicts=None if predicts is None else PredictsResult(**predicts._asdict()),
            holds=self.holds,
            with_laws=None if self.estimate is None else self.estimate.as_result(),
            law=tuple(
                FoundLawResult.of(one, name=one.law.name, value=one.size, unit=one.law.unit) for one in self.found
            ),
            law_frame=None if self.motor is None else LawFrameResult(**self.motor.frame._asdict()),
            u95={**self.budget.u95},
            u95_absolute={**self.budget.u95_absolute},
        )


@dataclass(frozen=True, eq=False)
class Beginning:
    """What the choice of laws begins with.

    whole       the tests, each as one piece
    motor       the plain motor, with the force over position that it was fitted beside
    cycle_s     period of the fastest cycle, s
    travel_rad  lowest and highest position, rad
    chooser     the choice
    """

    whole: Cut
    motor: RealMotor
    cycle_s: float
    travel_rad: tuple[float, float]
    chooser: Chooser

    @classmethod
    def of(
        cls,
        tests: Sequence[TimeSeries],
        plain: Estimate,
        periods_s: Sequence[float | None],
        stated: Sequence[StatedErrors] = (StatedErrors(),),
        level_V: tuple[float, float] | None = None,
        of: Sequence[str] = (),
    ) -> Beginning:
        """From the tests and their plain estimate, as ``motor_law``. Raises IdentifyError if a test is too short."""
        free_delay = any(test.t_u_s is None for test in tests)
        longest = delays_of_all_s(tests)
        delay_s = longest if free_delay else (0.0, 0.0)
        whole = Cut.whole(tests, delay_s[1], of)
        motor = RealMotor(
            plain.tau_s, plain.K_rad_s_V, max(plain.fc_V, 0.0), plain.asym_V, plain.delay_s if free_delay else 0.0
        )._replace(force_sin_V=plain.force_V[0], force_cos_V=plain.force_V[1])
        durations = [window.duration_s for window in whole.windows]
        known_s = [p if p is not None else _swings_s(test) for p, test in zip(periods_s, tests, strict=True)]
        of_pieces_s = min(max(NO_CYCLE_TAUS * plain.tau_s, SHORTEST_S), LONGEST_S, max(durations) / NO_CYCLE)
        cycle_s = min((p for p in known_s if p is not None), default=of_pieces_s)
        frame = whole.frames[0]
        travel_rad = (frame.centre_rad - frame.half_travel_rad, frame.centre_rad + frame.half_travel_rad)
        linearity_rad = max(one.linearity_rad(travel_rad[1] - travel_rad[0]) for one in stated)
        bench = whole.every(0.5 * cycle_s).bench(motor, linearity_rad)
        sigma = noise_of_all_rad(tests)
        if plain.rms_rad <= AT_NOISE * sigma:
            whole = whole.rests_once()
        turns_one_way = one_way(tests)
        core = tuple(name for name in CORE if name != "bias_V") if turns_one_way else CORE
        chooser = Chooser(
            [law for law in DEPARTURES if law.fits(bench) and not (law.both_ways and turns_one_way)],
            bench,
            (*core, DELAY) if free_delay else core,
            delay_s,
            max(sigma, SMALLEST_NOISE * frame.half_travel_rad),
            min(test.resolution_rad() for test in tests),
            known=None if level_V is None else Known.of_sum(AT_REST_V, *level_V),
        )
        return cls(whole, motor, cycle_s, travel_rad, chooser)


def _listed(words: Iterable[str]) -> str:
    """In one sentence, such as ``a, b and c``."""
    said = list(words)
    return " and ".join(filter(None, (", ".join(said[:-1]), *said[-1:])))


def _swings_s(test: TimeSeries) -> float | None:
    """Mean length of a swing to and fro in a test of a run that has no cycle, s; None of any other record, and of rest.

    Strokes turn at varied places, and a test may end before its cycle settles.
    """
    if test.stage is None or test.stage.kind not in (StageKind.STROKES, StageKind.RELAY, StageKind.SEARCH):
        return None
    y, least_rad = test.y_rad, TURNS_BACK * float(np.ptp(test.y_rad))
    turns, way, low, high = 0, 0, float(y[0]), float(y[0])
    for y_rad in y.tolist():
        low, high = min(low, y_rad), max(high, y_rad)
        if (way >= 0 and high - y_rad > least_rad) or (way <= 0 and y_rad - low > least_rad):
            turns += way != 0
            way = -1 if high - y_rad > least_rad else 1
            low = high = y_rad
    return 2.0 * float(test.t_s[-1] - test.t_s[0]) / (turns + 1) if way else None


def motor_law(
    tests: Sequence[TimeSeries],
    plain: Estimate,
    periods_s: Sequence[float | None],
    stated: Sequence[StatedErrors] = (StatedErrors(),),
    further: Sequence[Further] = (),
    recording_of: Sequence[str] | None = None,
    *,
    level_V: tuple[float, float] | None = None,
    was_known: bool = False,
    all_rows: bool = False,
) -> MotorLaw:
    """The law that the tests show, from the plain estimate on.

    periods_s     for each test the period of its cycle, s, or None
    stated        what is known of the benches that recorded them; at least one
    further       records beside the tests, each with the number of a test of the same run
    recording_of  for each test the name of its recording; None: they are of one
    level_V       friction at rest by breakaway ramps, and its standard error; None without ramps
    was_known     whether a live fit of all this ended the tests: then stages that follow each other are one motion
    all_rows      whether the plain motor leaves so much only for its want of laws
    Of more than 8,000 rows several at a time are taken as one; or of 2,000, where the plain motor leaves far more than
    noise, in a long record twice as much, and so do its laws. Raises IdentifyError if a test is too short.
    """
    names = recording_of or [""] * len(tests)
    rows = sum(len(test) for test in tests)
    further = [(_slow(series, plain.tau_s), number) for series, number in further]
    noise_rad = noise_of_all_rad(tests)
    leaves = LEAVES if rows <= MOST_ROWS else LONG_LEAVES
    most = FEWER_ROWS if plain.rms_rad > leaves * noise_rad and not all_rows else MOST_ROWS
    folded = [_folded(test, rows, most, plain.tau_s) for test in tests]
    begun = Beginning.of(folded, plain, periods_s, stated, level_V, names)
    tested = sum(window.t_s.size for window in begun.whole.windows)
    remarks = [WITH_DEAD_BAND] if begun.chooser.bench.goes_along else []
    stiff: Choice | None = None
    level: dict[str, float] = {}
    left_out: list[str] = []
    own: Choice | None = None
    for left in reversed(range(ROUNDS + 1)):
        of_rows = rows + sum(len(series) for series, _ in further)
        beside = [(_folded(series, of_rows, most, plain.tau_s), number) for series, number in further]
        whole = begun.whole.beside(beside, begun.chooser.delay_s[1], FURTHER_CYCLES * begun.cycle_s)
        choice = own if own and not further else begun.chooser.choose(whole, begun.motor, begun.cycle_s)
        choice = behind_a_gear(choice, begun.chooser, whole, begun.cycle_s)
        says_more = most == FEWER_ROWS < of_rows and not begun.chooser.within_steps
        if says_more and choice.fit.rms_rad <= EXPLAINED * begun.chooser.sigma_rad:
            law = motor_law(
                tests, plain, periods_s, stated, further, recording_of,
                level_V=level_V, was_known=was_known, all_rows=True,
            )  # fmt: skip
            return replace(law, remarks=(*left_out, *law.remarks))
        if not further and len(set(names)) > 1:
            level = levels(choice.fit.with_own_noise, names)
            for each, drift in (
                (begun.whole.each(names), DRIFT_EACH),
                (begun.whole.with_levels(level, names), level_each(len(level))),
            ):
                if begun.chooser.better_each(choice, each, drift):
                    begun = replace(begun, whole=each, chooser=begun.chooser.with_drift(drift))
                    choice = begun.chooser.choose(each, begun.motor, begun.cycle_s)
                    break
        coupling = None if further else coupling_of(choice, begun.whole, begun.chooser)
        if coupling is not None:
            soft = replace(begun, whole=replace(begun.whole, coupling=coupling))
            stiff, choice = choice, soft.chooser.choose(soft.whole, begun.motor, begun.cycle_s)
            if takes_enough(stiff, choice, begun.whole, begun.chooser):
                begun = soft
            else:
                choice = stiff
        if further and own is None and not begun.chooser.tells(choice.fit, len(tests), tested):
            own = begun.chooser.choose(begun.whole, begun.motor, begun.cycle_s)
        alone = None if own is None else own.fit
        kept, disagree = agreeing(choice.fit, tested, alone, further) if further else ([], ())
        left_out += disagree
        if not disagree:
            break
        further = kept if left > 1 else ()
    remarks += left_out
    records = tuple(_record(series) for series in [*tests, *(series for series, _ in further)])
    of_windows = [*names, *(names[number] for _, number in further)]
    parts = choice.fit.with_own_noise
    fit = joined(parts, of_windows) if was_known else parts
    covariance = fit.covariance
    whole = replace(begun.whole, frames=parts.problem.cut.frames[: len(tests)])
    blocks = Blocks.of(whole, fit.motor.tau_s)
    predicts = held_out(blocks, begun.chooser.problem(blocks.cut, choice.laws, math.inf), fit.motor)
    grown = np.maximum(by_rounding(fit, begun.chooser.step_rad), by_neighbours(fit))
    of_model = model_error(parts, blocks.cut, predicts.error, len(choice.laws)).with_rounding(
        grown[[fit.problem.free.index(name) for name in OF]]
    )
    of_levels = levels_line(parts, level) if any(law.name == LEVEL_EACH for law in choice.laws) else ()
    bench = begun.chooser.bench
    hidden = [law for law in begun.chooser.candidates if law.may_hide]
    seen = outside(parts, choice.laws, bench)
    nuisances = Nuisances.of(parts, choice.laws, hidden, bench, seen, blocks.cut.longest_s)
    bare = bare_fits(parts, choice.laws, begun.chooser)
    coupled = fit.problem.cut.coupling
    of_lag = () if coupled is None else (lag_line(coupled),)
    others = [*bare.values(), stiff.fit] if stiff is not None and coupled else bare.values()
    like: tuple[Entry, ...] = ()
    if len(choice.laws) >= MANY_LAWS or not begun.chooser.is_rounding(parts):
        near = nearly_as_good(parts, choice.laws, begun.chooser, bare)
        like = only_like(parts, others, near, len(choice.laws))
    instead = in_place(nuisances, choice.laws, begun.chooser, bare)
    for sag in (one for one in choice.laws if one.name in INSTEAD_OF):
        instead += instead_of_sag(parts, sag, choice.laws, begun.chooser)
    by_size = profiles(parts, choice.laws, begun.chooser, of_model.effect)
    scatter = nuisances.scatter if fit is parts else np.diag(covariance)[nuisances.at] * nuisances.size**2
    scales = ScaleErrors.of(stated, *begun.travel_rad)
    bears_all = parts.problem.cut.begins.size == len(parts.problem.cut.windows)
    is_plain = bears_all and not choice.laws and not further and not coupled  # then its fit of the whole is the answer
    bends = any_bend(parts, bare, goes_along=bench.goes_along)
    one_size = of_one_size(parts)  # of which that is a part
    hides = [] if one_size else untold(parts, choice.laws, begun.chooser)
    of_late = of_long_lag(parts, bare, LATE_ROWS * max(test.period_s for test in tests))
    of_times = of_shift(parts, max(test.times_shift_s for test in tests))
    of_untold = (Entry(UNTOLD, *np.abs(moves).tolist()) for moves in hides)
    lines = budget(
        nuisances.tempered(of_model.effect),
        by_size,
        instead,
        scales,
        scatter * of_model.of_each,
        (*of_model.lines, *like, *bends, *one_size, *of_untold, *of_late, *of_levels, *of_lag, *of_times),
    )
    holds = _holds(whole, turns_both="bias_V" in begun.chooser.core)
    bounded = (*_at_bounds(fit, choice.laws), *(() if coupled is None else damped_at_bound(coupled)))
    free_run = _free_run(fit, whole)
    length_s = whole.longest_s
    growth = (*(one for one in choice.growth if one[0] < length_s), (length_s, free_run.rms_rad))
    if is_plain:
        return MotorLaw(
            (), (), None, lines, growth, records, tuple(remarks), bounded=bounded, predicts=predicts, holds=holds
        )
    # a frame of levels goes by no time
    frame = begun.whole.each(names).frames[0] if of_levels else whole.frames[0]
    groups = (
        (law.name, *(one.other.name for one in instead if one.law is law and one.rise < ALIKE)) for law in choice.laws
    )
    return MotorLaw(
        (
            *(_found(law, fit, covariance, gained(parts, bare[law.name])) for law in choice.laws),
            *([_coupling(fit, coupled)] if coupled else []),
        ),
        tuple(group for group in groups if len(group) > 1),
        _estimate(fit, covariance, fit if fit is parts else free_run, tested, plain, periods_s),
        lines,
        growth,
        records,
        tuple(remarks),
        _alone(parts, of_windows),
        FramedMotor(fit.motor._replace(drift=0.0) if of_levels else fit.motor, frame) if choice.laws else None,
        bounded=bounded,
        predicts=predicts,
        holds=holds,
    )


def levels_line(fit: Fit, level: Mapping[str, float]) -> tuple[Entry, ...]:
    """The line for levels of friction that differ between recordings: f_c is that of none of them."""
    shares = np.array(list(level.values())) * fit.motor.drift / max(map(abs, level.values()))
    half = COVERAGE * float(np.std(shares, ddof=1)) / math.sqrt(shares.size) * fit.motor.fc_V
    return (Entry("friction of each recording", 0.0, 0.0, half),)


def joined(parts: Fit, of: Sequence[str]) -> Fit:
    """The fit of the same records with no more starts than the motion had, if the motor bears it; else ``parts``.

    of   for each window the name of its recording
    Laws are chosen on pieces, and so are records that do not belong. But each piece's start takes two rows' worth of
    what the record says: the live fit has no such pieces, and would know the motor better than this one.
    """
    whole = parts.problem.cut.joined(of)
    if whole.begins.size == parts.problem.cut.begins.size:
        return parts
    fit = solve(begin(replace(parts.problem, cut=whole), parts.motor))
    return fit if fit.arrived and bears(fit, parts) else parts


def _free_run(fit: Fit, whole: Cut) -> Fit:
    """The tests, each predicted whole: only its start is fitted."""
    return solve(begin(replace(fit.problem, cut=whole, free=(), robust_rad=math.inf, noise=WHITE), fit.motor))


def _at_bounds(fit: Fit, laws: Sequence[Departure]) -> Iterator[str]:
    """A sentence for each number that the fit would take beyond its bound: what it says is the bound."""
    titles = {name: (law.title, law.unit) for law in laws for name in law.numbers}
    titles |= {"tau_s": ("tau", "s"), "fc_V": ("f_c", "V"), "bias_V": ("the asymmetry", "V")}
    for name in fit.problem.free:
        low, high = fit.problem.limits.get(name, (-math.inf, math.inf))
        value = getattr(fit.motor, name)
        if name in titles and value != 0.0 and not low < value < high:
            title, unit_of = titles[name]
            yield f"{title} is at its bound, {value:.3g} {unit_of}: the record asks for more than any bench has"


def _holds(whole: Cut, *, turns_both: bool) -> HoldsResult:
    """What the tests hold."""
    y_rad = np.concatenate([window.y_rad for window in whole.windows])
    u_V = np.abs(np.concatenate([window.steps.u_V for window in whole.windows]))
    speeds = np.concatenate([_speeds(window) for window in whole.windows])
    size = np.abs(speeds)
    moving = size[size > AT_REST * float(size.max(initial=0.0))]
    way = "forward" if float(np.mean(speeds)) > 0.0 else "backward"
    return HoldsResult(
        drive_V=(float(u_V[u_V > 0.0].min(initial=math.inf)), float(u_V.max())) if u_V.any() else (0.0, 0.0),
        speed_rad_s=(float(np.quantile(moving, 0.02)), float(np.quantile(moving, 0.98))) if moving.size else None,
        travel_rad=(float(y_rad.min()), float(y_rad.max())),
        ways="both" if turns_both else way,
    )


def _speeds(window: Window) -> Array:
    """Mean speeds over a tenth of a second, or over some rows, rad/s."""
    rows = min(max(4, round(SPEED_OVER_S / window.period_s)), window.t_s.size - 1)
    return np.asarray((window.y_rad[rows:] - window.y_rad[:-rows]) / (window.t_s[rows:] - window.t_s[:-rows]))


def _record(series: TimeSeries) -> FittedRecord:
    rows = (series.first_row, series.first_row + len(series) - 1)
    return FittedRecord(name=series.name, rows=rows, duration_s=float(series.t_s[-1] - series.t_s[0]))


def _folded(series: TimeSeries, of_rows: int, most: int, tau_s: float) -> TimeSeries:
    """The series as it is taken where all records have ``of_rows``, for at most ``most``."""
    rows_of_tau = ROWS_OF_TAU if most == MOST_ROWS else FEWER_OF_TAU
    rows = showing_the_angle(series, math.ceil(of_rows / most))
    if most == FEWER_ROWS and series.steps.edge_s.size <= len(series) // max(rows, 1):
        return thinned(series, rows)  # its edges stay where they were: the motion between them has a closed form
    of_drive = max(int(tau_s / series.period_s / ROWS_OF_TAU), 1)
    return thinned(series, min(rows, int(tau_s / series.period_s / rows_of_tau)), of_drive)


def _slow(series: TimeSeries, tau_s: float) -> TimeSeries:
    """A long survey with several rows as one: its sweeps are slow. Its loop follows every row, so its drive is kept."""
    is_survey = series.stage is not None and series.stage.kind is StageKind.SURVEY
    of_drive = max(int(tau_s / series.period_s / ROWS_OF_TAU), 1)
    return thinned(series, math.ceil(len(series) / MOST_SURVEY_ROWS), of_drive) if is_survey else series


def _alone(fit: Fit, of: Sequence[str]) -> tuple[RecordingEstimate, ...]:
    """What each recording alone says of the plain numbers, by the normal equations of the fit."""
    problem = fit.problem
    matrix, gradient = sums_of_pieces(fit.rows, problem.cut.begins)
    owner = np.repeat(of, [rows.size for rows in problem.cut.rows])
    core = [problem.free.index(name) for name in CORE_OF if name in problem.free]
    here = np.array([math.log(fit.motor.tau_s), math.log(fit.motor.K_rad_s_V), fit.motor.fc_V])
    found = []
    for name in dict.fromkeys(of):
        own = matrix[owner == name].sum(axis=0)[np.ix_(core, core)] / unit(fit)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(own), 1e-300))
        inverse = np.linalg.pinv(own * np.outer(scale, scale), rcond=1e-13, hermitian=True) * np.outer(scale, scale)
        change = -inverse @ gradient[owner == name].sum(axis=0)[core] / unit(fit)
        found.append(RecordingEstimate.at(name, here + change[:3], inverse[:3, :3]))
    return tuple(found)


def _freedom(fit: Fit) -> int:
    return max(1, fit.problem.cut.freedom - len(fit.problem.free))


def _found(law: Departure, fit: Fit, covariance: Array, gain: float) -> FoundLaw:
    free = fit.problem.free
    at = [free.index(name) for name in law.numbers]
    values = np.array([getattr(fit.motor, name) for name in law.numbers])
    size = float(values[0]) if values.size == 1 else float(np.sqrt(values @ values))
    slope = values / size if values.size > 1 and size > 0.0 else np.ones(values.size)
    error = math.sqrt(max(0.0, float(slope @ covariance[np.ix_(at, at)] @ slope)))
    half = student_975(_freedom(fit)) * error
    ci95 = as_likely(fit, law) if law.leaps else (size - half, size + half)
    price = law.costs * math.log(_freedom(fit))
    fields = () if law.name == LEVEL_EACH else law.fields  # no other record has such a level
    numbers = {name: float(getattr(fit.motor, name)) for name in fields}
    return FoundLaw(law, size, ci95, gain - price, numbers)


def _coupling(fit: Fit, coupling: Coupling) -> FoundLaw:
    """The soft coupling that the tests were read behind: no number of the motor's model."""
    free = replace(fit.problem, free=())
    size = coupling.rad_s**-2
    sizes = [size * share for share in (0.9, 1.0, 1.1)]
    low, here, high = (
        solve(
            begin(replace(free, cut=replace(fit.problem.cut, coupling=coupling._replace(rad_s=one**-0.5))), fit.motor)
        ).cost
        for one in sizes
    )
    bend = max((low + high - 2.0 * here) / (0.1 * size) ** 2, 1e-300)
    half = 1.96 * math.sqrt(2.0 * unit(fit) / bend)
    stiff = solve(begin(replace(free, cut=replace(fit.problem.cut, coupling=None)), fit.motor)).cost
    bic = (stiff - here) / unit(fit) - math.log(_freedom(fit))
    return FoundLaw(SOFT_COUPLING, size, (size - half, size + half), bic, {})


def _estimate(
    fit: Fit, covariance: Array, shown: Fit, tested: int, plain: Estimate, periods_s: Sequence[float | None]
) -> Estimate:
    """The estimate, with the residual of the tests: the first ``tested`` rows of the fit ``shown``."""
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
    quantile = student_975(_freedom(fit))
    noise = fit.problem.noise
    cut = shown.problem.cut
    residual = shown.residual_rad[:tested]
    white = replace(shown.problem, noise=noise).whitened(shown.residual_rad)[:tested]
    return Estimate(
        plain.method,
        *values,
        ci95=intervals(values, errors, quantile),
        covariance=full,
        rms_rad=float(np.sqrt(np.mean(residual**2))),
        iterations=len(fit.iterates),
        rows=plain.rows,
        iterates=fit.iterates,
        residual_rad=-residual,
        residual_t_s=cut.t_s[:tested],
        repeated=repeated_share(white, repetitions(cut.windows[: len(periods_s)], periods_s)),
        coloured=None if noise.white else (noise.memory_s, math.sqrt(noise.ratio)),
    )
