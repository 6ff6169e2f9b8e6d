"""From recordings to estimates: gather the tests, run each estimator of the list, choose the law of the motor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from rig.core.estimators import ESTIMATORS, LEADING, EstimatorEntry
from rig.identification.agreement import are_one_motor, disagreement, estimates_of_each
from rig.identification.breakaway import StaticFriction, breakaway
from rig.identification.clipped_drive import clipped, limit_of
from rig.identification.departures.laws import LEVEL_EACH
from rig.identification.drive_scale import (
    OF_FILTER,
    by_bends,
    by_filter,
    by_own_loop,
    by_speed_limit,
    by_steps,
    hidden_step_V,
)
from rig.identification.estimate import VERDICTS, Estimate
from rig.identification.estimator import Estimator
from rig.identification.friction_map import FrictionMap, friction_map
from rig.identification.in_pieces import is_reversed
from rig.identification.known_model import model_of
from rig.identification.least_squares import METHOD as FRICTION_METHOD
from rig.identification.least_squares import Transient
from rig.identification.lost_counts import explains_more, lost_share, with_counts
from rig.identification.mean_cycle import Cycle
from rig.identification.measurements import Measurements, measurements
from rig.identification.motor_law import MotorLaw, motor_law
from rig.identification.opinion import RecordingEstimate
from rig.identification.plausibility import hole_rows, is_cut_off, judge_motor, judge_records
from rig.identification.preprocessing import from_recording, with_stamps_of
from rig.identification.records import left_out, require_known
from rig.identification.sampled_data_verdict import is_early, judge_with_laws, late_s, slipped_rms_rad
from rig.identification.sampled_velocity import SAID_SAMPLES, are_samples, as_sampled, bends
from rig.identification.side_by_side import on_all_cores
from rig.identification.smoothing import smoothings
from rig.identification.stroke_delay import strokes_delay
from rig.identification.time_stamps import drives_stand_late, stamps_by_motion, stamps_off_by
from rig.identification.verdict import by_prediction, in_percent, largest_drive_V, reserved
from rig.model.real_motor import FramedMotor
from rig.run_folder.recording.curves import Curves
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import LATENCY_S, TimeSeries, noise_of_all_rad
from rig.run_folder.recording.servo_law import OwnLoop, least_known
from rig.run_folder.recording.stage import StageKind, kind_of
from rig.run_folder.results import (
    Answer,
    HystereticResult,
    IdentificationResult,
    RelayTestResult,
    SamplingResult,
    StaticFrictionResult,
    answer_of,
    chosen,
)

METHODS = tuple(entry.name for entry in ESTIMATORS)
AS_GOOD = 1.05  # ratio of residuals within which two explanations are as good
SHOWS = 1.01  # ratio of residuals beyond which an explanation shows in the tests
BEHIND_STEPS = 1.5  # residual over noise from which on steps of a drive may hide the true one
ROWS_EARLY = 3.0  # of a drive that stands rows too late
MOST = 0.9  # share of what laws explain that another explanation as good explains, too


@dataclass
class Identification:
    """Estimates by method, and the data behind them.

    estimates   method -> Estimate, in the order of ``ESTIMATORS``
    relays      the accepted relay tests
    hysteretic  the runs of hysteretic relays
    cycles      stage -> averaged cycle
    tests       the series that the estimators read
    breakaway   drives at break-away in both directions; None without breakaway ramps
    friction_map    the drive over speed and over position; None without a survey, or without a motor
    motor_law       what the tests show beyond the plain motor; None if not asked for, or without that estimate
    changes     a sentence for each change of what plain files say before the fit; also in ``notes``
    notes       rows used, how the gains were found, what was left out and why
    rehearsal   whether a recording is a rehearsal: its motor was made up
    own_loop    of a servo that made a recording; None: volts are volts
    unsure      what each oddity of plain files leaves unknown in the answer
    """

    estimates: dict[str, Estimate] = field(default_factory=dict)
    relays: list[RelayTestResult] = field(default_factory=list)
    hysteretic: list[HystereticResult] = field(default_factory=list)
    cycles: dict[str, Cycle] = field(default_factory=dict)
    tests: list[TimeSeries] = field(default_factory=list, repr=False)
    breakaway: StaticFrictionResult | None = None
    friction_map: FrictionMap | None = None
    motor_law: MotorLaw | None = None
    changes: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    rehearsal: bool = False
    own_loop: OwnLoop | None = None
    unsure: list[Callable[[Answer], Answer]] = field(default_factory=list, repr=False)

    def as_result(self) -> IdentificationResult:
        """As `rig identify --json` prints it. result.json has the same names."""
        return IdentificationResult(
            answer=self.answer,
            estimates={method: estimate.as_result() for method, estimate in self.estimates.items()},
            rehearsal=self.rehearsal or None,
            sampling=self.sampling,
            relays=tuple(self.relays),
            notes=tuple(self.notes),
            hysteretic=tuple(self.hysteretic) or None,
            breakaway=self.breakaway,
            friction_map=None if self.friction_map is None else self.friction_map.as_result(),
            **self.evidence,
        )

    @property
    def answer(self) -> Answer | None:
        """The numbers to use, with their laws, u95 and verdict, as in result.json; None without an estimate."""
        law, largest_V = self.motor_law, largest_drive_V(self.tests) if self.tests else 0.0
        found = {method: estimate.as_result() for method, estimate in self.estimates.items()}
        answer = answer_of(found) if law is None else law.answer(found, self.leading, largest_V)
        if answer is None:
            return None
        for widened in self.unsure:
            answer = widened(answer)
        return answer if self.own_loop is None else by_own_loop(answer, self.own_loop)

    @property
    def sampling(self) -> SamplingResult | None:
        """How the tests were sampled; None without tests. Of tests that differ the coarser."""
        if not self.tests:
            return None
        return SamplingResult(
            period_s=max(test.period_s for test in self.tests),
            noise_rad=max(test.noise_rad() for test in self.tests),
            step_rad=max(test.resolution_rad() for test in self.tests),
        )

    @property
    def evidence(self) -> dict[str, Any]:
        """The keys of a result that say what the answer was fitted to, and what its uncertainty is made of."""
        return {} if self.motor_law is None else dict(self.motor_law.as_result())

    @property
    def leading(self) -> Estimate | None:
        """The estimate of the answer, whatever its verdict; None without an estimate."""
        found = chosen(self.estimates, None if self.motor_law is None else self.motor_law.estimate)
        return None if found is None else found[1]

    @property
    def curves(self) -> Curves | None:
        """The arrays behind the answer, and the recursion of least squares; None without an estimate."""
        answer, found, friction = self.answer, self.leading, self.estimates.get(FRICTION_METHOD)
        if answer is None or found is None:
            return None
        trace = np.empty(0) if friction is None else friction.iterates[:, 2]
        return Curves(answer, found.residual_t_s, found.residual_rad, trace)

    @property
    def best(self) -> Estimate | None:
        """The estimate of the answer; None where that is refused, or has no tau and K."""
        found = self.leading
        return found if found is not None and found.is_motor and found.verdict != "refused" else None

    @property
    def real_motor(self) -> FramedMotor | None:
        """The motor of the answer, with its laws; None without one. Raises ValueError as ``model_of``."""
        return model_of(self.answer, in_its_time=True)


def identify(
    recordings: Sequence[Recording],
    methods: Sequence[str] | None = None,
    *,
    choose_law: bool = True,
    without: Sequence[str] = (),
) -> Identification:
    """Identify one motor from run folders or CSV files.

    methods     names of ``ESTIMATORS``; default: all that the data allow
    choose_law  whether to choose the law of the motor, from the sampled-data estimate. False: the motor is known to be
                plain, and no verdict asks for u95
    without     names of stages that are not read, such as breakaway, search and relay-2
    The estimators read a run's relay tests, or its hysteretic runs if it has no relay tests. Least squares reads only
    hysteretic runs. A CSV file without stages is one test; it counts as a hysteretic run only if ``methods`` has least
    squares. The law of the motor is fitted to breakaway check and gain search, too; tracking is never read.
    Raises IdentifyError if a method of ``methods`` cannot work on the data, if no method can, or if no recording has a
    stage of a name in ``without``.
    """
    wanted = _wanted(methods)
    if not recordings:
        raise IdentifyError("no recording was given", "give a run folder or a CSV file")
    reads_tests = any(estimator.reads_relay_tests for estimator in wanted)
    reads_runs = bool(methods) and not all(estimator.reads_relay_tests for estimator in wanted)
    require_known(recordings, without)
    data = measurements(recordings, with_cycles=reads_tests, plain_is_hysteretic=reads_runs, without=without)
    asked = _Asked(recordings, wanted, bool(methods), choose_law, without)
    with on_all_cores():
        found = _tried(asked, data)
    if _rank(found)[0] > 0 and not data.has_searches and any(map(_was_known, recordings)):
        data = measurements(recordings, with_cycles=reads_tests, plain_is_hysteretic=reads_runs, without=without)
        if data.take_searches():  # the run knew its motor by both
            with on_all_cores():
                found = min(found, _tried(asked, data), key=_rank)
    if isinstance(found, IdentifyError):
        raise found
    found.own_loop = least_known(recording.own_loop for recording in recordings)
    found.rehearsal = any(recording.meta.rehearsal for recording in recordings)
    return found


class _Asked(NamedTuple):
    """What ``identify`` was asked for; by_name: whether the methods were."""

    recordings: Sequence[Recording]
    wanted: Sequence[Estimator]
    by_name: bool
    choose_law: bool
    without: Sequence[str]


def _tried(asked: _Asked, data: Measurements) -> Identification | IdentifyError:
    """The identification from these data, or why there is none."""
    try:
        return _identified(asked, data)
    except IdentifyError as error:
        return error


def _identified(asked: _Asked, data: Measurements) -> Identification:
    """The identification from these data; it may take the gain search as a test. Raises IdentifyError."""
    recordings, wanted, without = asked.recordings, asked.wanted, asked.without
    used = [e for e in wanted if asked.by_name or e.series(data)]

    def estimated() -> tuple[Identification, dict[str, IdentifyError]]:
        found = _found(data)
        return found, _add_estimates(used, data, found, asked.by_name)

    takes_stamps = _takes_stamps(data, None)
    found, errors = estimated()
    leading = found.estimates.get(LEADING)
    if leading is not None and _tells_no_motor(leading, data) and data.take_searches():
        found, errors = estimated()
    leading = found.estimates.get(LEADING)
    if leading is not None and are_samples(data.tests, leading):
        data.take(as_sampled, SAID_SAMPLES)
        found, errors = estimated()
    if _takes_delay(data, found.estimates.get(LEADING), recordings):
        found, errors = estimated()
    if _takes_change(data, found.estimates.get(LEADING)):
        found, errors = estimated()
    if not takes_stamps and LEADING in found.estimates and _takes_stamps(data, found.estimates[LEADING]):
        found, errors = estimated()
    if not found.estimates:
        # the leading estimator needs the least data: what it misses, the recording lacks
        decisive = wanted[0].name if len(wanted) == 1 else LEADING
        raise errors.get(decisive) or [*data.complaints, *errors.values()][0]
    reads_tests = any(estimator.reads_relay_tests for estimator in wanted)
    each = estimates_of_each(data.sources, found.estimates.get(LEADING)) if len(recordings) > 1 and reads_tests else []
    _doubt_all(found, data.doubts, _said(disagreement(each)))
    static = _add_breakaway(recordings, without, found)
    if asked.choose_law:
        _add_motor_law(data, found, each, static, any(map(_was_known, recordings)))
        found = _with_lost_counts(data, found, used, asked.by_name)
    _add_friction_map(recordings, without, found)
    is_own_loop = any(recording.own_loop for recording in recordings)
    found.unsure = [*data.unsure, *([] if is_own_loop else _by_steps(data.tests, found.leading))]
    return found


def _was_known(recording: Recording) -> bool:
    """Whether the tests ended because the live fit of everything driven knew the motor."""
    decided = (event.detail for event in recording.events if event.kind == "decided")
    return any(one.get("what") == "stop" and one.get("by") == "advice" for one in decided)


def _rank(found: Identification | IdentifyError) -> tuple[int, float]:
    """Of the answer: 0 if ok, 1 doubtful, 2 refused, 3 none; its widest relative interval."""
    answer = None if isinstance(found, IdentifyError) else found.leading
    return (len(VERDICTS), math.inf) if answer is None else (VERDICTS.index(answer.verdict), answer.widest)


def _takes_delay(data: Measurements, estimate: Estimate | None, recordings: Sequence[Recording]) -> bool:
    """Whether the bench acts later than its tests say, or rows earlier. Then those of ``data`` have an unknown delay.

    If they say when each drive acted, the strokes of a breakaway check must allow that it was later: else it is
    columns that are wrong, not the bench.
    """
    if estimate is None or estimate.verdict == "ok" or any(test.delay_s is not None for test in data.tests):
        return False
    if is_early(estimate, data.tests) and _stand_late(data, estimate):
        period_s = max(test.period_s for test in data.tests)
        data.take_unknown_delay(((1.0 - ROWS_EARLY) * period_s, period_s))
        return True
    later_s = late_s(estimate, data.tests)
    if later_s == 0.0:
        return False
    bound_s = (0.0, LATENCY_S)
    if data.tests[0].t_u_s is not None:
        strokes = [strokes_delay(recording) for recording in recordings]
        if any(one is None or not one.low_s <= later_s <= one.high_s for one in strokes):
            return False
        bound_s = (0.0, estimate.delay_s + max(one.high_s for one in strokes if one is not None))
    data.take_unknown_delay(bound_s)
    data.notes.append("the drive acts later than the recording says: its delay is fitted")
    return True


def _stand_late(data: Measurements, estimate: Estimate) -> bool:
    """Whether drives stand more than a row too late; not known of tests that are too short for pieces."""
    try:
        return drives_stand_late(data.tests, estimate)
    except IdentifyError:
        return False


def _takes_change(data: Measurements, estimate: Estimate | None) -> bool:
    """Whether plain files have a limited drive, or a column that was smoothed. Then ``data`` has what was."""
    if estimate is None or any(test.stage is not None for test in data.tests):
        return False
    try:
        if estimate.spoiled and is_reversed(data.tests):
            return False
        limit = limit_of(data.tests, estimate)
        bent = bends(data.tests, estimate) if math.isinf(limit.drive_V) else None
        otherwise_rad = math.inf if bent is None else bent.rad
        smoothed = smoothings(data.tests, estimate, otherwise_rad) if math.isinf(limit.drive_V) else []
    except IdentifyError:
        return False  # too short for pieces
    is_bent = bent is not None and not any(smoothed)
    if bent is not None and is_bent:
        mended = dict(zip(map(id, data.tests), bent.tests, strict=True))
        data.take(lambda test: mended[id(test)], bent.words)
        data.unsure.append(partial(by_bends, moves=bent.moves))
    if math.isfinite(limit.drive_V):
        data.take(partial(clipped, limit=limit), limit.in_words())
        data.unsure += [by_speed_limit] if limit.from_rad_s > 0.0 else []
    undone = {id(test): one for test, one in zip(data.tests, smoothed, strict=False) if one and one.left != 1.0}
    if undone:
        period_s, is_alike = max(test.period_s for test in data.tests), len(set(smoothed)) == 1
        words = [
            ("" if is_alike else f"{name}: ") + undone[id(test)].in_words(period_s)
            for test, name in zip(data.tests, data.recording_of, strict=True)
            if id(test) in undone
        ]
        data.take(lambda test: undone[id(test)].undone(test) if id(test) in undone else test, *dict.fromkeys(words))
    told = [one for one in smoothed if one is not None]
    worst = max(told, key=lambda one: max(OF_FILTER, one.left) * one.late_s, default=None)
    if worst is not None and worst.late_s > 0.0:
        data.unsure.append(partial(by_filter, lag_s=worst.late_s, left=worst.left, moves=worst.moves))
    return math.isfinite(limit.drive_V) or bool(undone) or is_bent


def _by_steps(tests: Sequence[TimeSeries], found: Estimate | None) -> list[Callable[[Answer], Answer]]:
    """What steps of the drive leave unknown, where the motor leaves more than noise: else they are what it got."""
    if found is None or found.rms_rad < BEHIND_STEPS * noise_of_all_rad(tests):
        return []
    plain = [test for test in tests if test.stage is None]
    step_V = max((hidden_step_V(test, found.K_rad_s_V, found.rms_rad) for test in plain), default=0.0)
    if step_V == 0.0:
        return []
    return [partial(by_steps, step_V=step_V, largest_V=largest_drive_V(tests))]


def _takes_stamps(data: Measurements, estimate: Estimate | None) -> bool:
    """Whether the rows of plain files have the time stamps of other rows. Then those of ``data`` have theirs.

    estimate  of the plain motor; None: by the motion alone
    """
    spoiled = estimate is not None and estimate.spoiled
    if spoiled or any(test.stage is not None or hole_rows(test).size for test in data.tests):
        return False  # an unknown drive in a gap looks like other times, too
    try:
        rows = stamps_by_motion(data.tests) if estimate is None else stamps_off_by(data.tests, estimate)
    except IdentifyError:
        return False  # too short for pieces
    if not rows:
        return False
    which = "before" if rows < 0 else "after"
    data.take(partial(with_stamps_of, rows=rows), f"the time stamps were moved by a row: {rows}")
    said = f"each row seems to have the time stamp of the row {which}, and is fitted so: try --time-row {rows}"
    data.doubts.append(said)
    return True


def _wanted(methods: Sequence[str] | None) -> list[Estimator]:
    """The estimators of these names, in the order of the list; all if ``methods`` is None. Raises IdentifyError."""
    known = [entry.name for entry in ESTIMATORS]
    unknown = [method for method in methods or () if method not in known]
    if unknown:
        raise IdentifyError(f"there is no method {unknown[0]!r}", f"the methods are {', '.join(known)}")
    return [_made(entry) for entry in ESTIMATORS if not methods or entry.name in methods]


def _made(entry: EstimatorEntry) -> Estimator:
    module, name = entry.place.split(":")
    estimator: Estimator = getattr(import_module(module), name)()
    return estimator


def _add_estimates(
    estimators: Sequence[Estimator], data: Measurements, found: Identification, by_name: bool
) -> dict[str, IdentifyError]:
    """Add what each estimator finds, and its notes. Returns why the others cannot work on the data, by name.

    by_name   whether somebody asked for these estimators; else one that reads relay tests has nothing to say of a chirp
    """
    errors: dict[str, IdentifyError] = {}
    for estimator in estimators:
        try:
            estimate = _estimate(estimator, data, found.estimates)
        except IdentifyError as error:
            errors[estimator.name] = error
            if by_name or data.of_relay or not estimator.reads_relay_tests:
                found.notes.append(f"{estimator.name}: {error.cause}")
        else:
            found.estimates[estimator.name] = estimate
            found.notes += estimator.notes(estimate, data)
    return errors


def _estimate(estimator: Estimator, data: Measurements, earlier: dict[str, Estimate]) -> Estimate:
    """One estimator's estimate with its verdict. Reasons about columns and units come first. Raises IdentifyError."""
    lacking = estimator.applies(data)
    if lacking is not None:
        raise lacking
    return _with_causes(estimator.judge(estimator.fit(data), data, earlier), estimator.series(data))


def _with_causes(judged: Estimate, read: Sequence[TimeSeries]) -> Estimate:
    """The judged estimate with what is wrong in columns and units, which comes first: it is the cause.

    But where the shaft only turned one way, and no better fit mends an estimate, that is another cause.
    """
    consequences, estimate = judged.reasons, replace(judged, reasons=())
    causes = [*judge_records(read, estimate), *judge_motor(estimate, read)]
    if judged.spoiled and not any(one.spoils for one in causes):
        estimate, consequences = judged, ()
    for one in causes:
        estimate = estimate.judged(one.verdict, one.reason, spoiled=one.spoils)
    return estimate.judged("ok", *consequences)


def _found(data: Measurements) -> Identification:
    """The identification before the first estimate: tests, cycles, notes."""
    cycles = [(test.name, cycle) for test, cycle in zip(data.tests, data.cycles, strict=True) if cycle is not None]
    return Identification(
        relays=[RelayTestResult.of(cycle, stage=name) for name, cycle in cycles],
        hysteretic=[Transient.of(run).as_result() for run in data.hysteretic],
        cycles=dict(cycles),
        tests=list(data.tests),
        changes=list(data.changes),
        notes=list(data.notes),
    )


def _add_breakaway(
    recordings: Sequence[Recording], without: Sequence[str], found: Identification
) -> StaticFriction | None:
    """Static friction from the first recording with a breakaway stage, by the sampled-data model."""
    estimate = found.estimates.get(LEADING)
    if estimate is None or estimate.verdict == "refused":
        return None
    for recording in recordings:
        stage = next((name for name in recording.stages() if kind_of(name) is StageKind.BREAKAWAY), None)
        if stage is None or stage in left_out(recording, without):
            continue
        try:
            ramps, _ = from_recording(recording, recording.stage_rows(stage), stage)
        except IdentifyError as error:
            found.notes.append(error.cause)
            continue
        static = breakaway(ramps, estimate, max(estimate.rms_rad, 1e-9))
        found.breakaway = static.as_result()
        found.notes.append(f"breakaway: {static.reason}")
        if static.friction_V is not None:
            plus, minus, bias = static.friction_V
            found.estimates[LEADING] = replace(estimate, fc_plus_V=plus, fc_minus_V=minus, bias_V=bias)
        return static
    return None


def _said(sentence: str | None) -> list[str]:
    return [] if sentence is None else [sentence]


def _add_friction_map(recordings: Sequence[Recording], without: Sequence[str], found: Identification) -> None:
    """The friction map of the first recording with a survey, with the identified motor beside it."""
    motor = found.real_motor
    stage = str(StageKind.SURVEY)
    for recording in recordings:
        if motor is None or stage not in recording.stages() or stage in left_out(recording, without):
            continue
        try:
            survey, _ = from_recording(recording, recording.stage_rows(stage), stage)
            first = survey.first_row - recording.first_row
            found.friction_map = friction_map(survey, recording.yd_rad[first : first + len(survey)], motor)
        except IdentifyError as error:
            found.notes.append(f"friction map: {error.cause}")
            continue
        found.notes += found.friction_map.notes()
        return


def _add_motor_law(
    data: Measurements,
    found: Identification,
    each: Sequence[RecordingEstimate],
    static: StaticFriction | None,
    was_known: bool,
) -> None:
    """What the motor has beyond the plain law, the estimate with it, and the verdicts by u95.

    each        what each recording alone says; empty if there is one
    static      static friction from breakaway ramps; None without any
    was_known   whether the tests of one ended because its live fit knew the motor
    The numbers of the plain estimates stay as they are. Without a budget none of them can be ok.
    """
    plain = _leading(data, found)
    if plain is None or not plain.is_motor or not _may_have_laws(plain, data):
        return
    spoiled = _beyond_laws(plain, data.tests)
    if spoiled is not None:
        _doubt(found, spoiled)
        return
    try:
        law = motor_law(
            data.tests,
            plain,
            data.periods_s,
            data.stated,
            () if disagreement(each) else data.further,  # a level of friction in each is looked for in the tests
            data.recording_of,
            level_V=None if static is None else static.level_V,
            was_known=was_known,
        )
    except IdentifyError as error:
        _doubt(found, error.cause)
        return
    except np.linalg.LinAlgError as error:
        _doubt(found, f"these tests give no answer ({error})")
        return
    if (
        law.found
        and law.estimate is not None
        and other_times_explain(slipped_rms_rad(plain, data.tests), plain.rms_rad, law.estimate.rms_rad)
    ):
        law = law.without_laws()  # the plain verdict says so
    largest_V = largest_drive_V(data.tests)
    if law.estimate is not None:
        judged = _with_causes(judge_with_laws(law.estimate, data.tests, law.growth), data.tests)
        numbers = sum(len(one.numbers) for one in law.found)
        has_levels = any(one.law.name == LEVEL_EACH for one in law.found)  # then friction is what differs
        one_motor = has_levels or are_one_motor(each, law.estimate.rms_rad, numbers)
        odd = None if one_motor else disagreement(each)
        objections = [*_said(odd or disagreement(law.alone)), *data.doubts, *law.bounded]
        law = law.judged(largest_V, judged.judged("doubtful" if objections else "ok", *objections))
    found.motor_law = law
    found.notes += law.notes()
    noise_rad = noise_of_all_rad(data.tests)
    if law.predicts is not None and law.estimate is not None:
        law = replace(law, estimate=by_prediction(law.estimate, law.predicts, noise_rad))
        found.motor_law = law
    for method, estimate in found.estimates.items():
        reservations = law.reservations(estimate, largest_V) if estimate.is_motor else []
        if not reservations or not (method == LEADING or estimate.verdict == "ok"):
            continue
        if law.instead_of(estimate, largest_V) is None:
            found.estimates[method] = reserved(estimate, reservations)
        else:  # the law is the cause, so it comes first; what it explains is left out
            others = _said(disagreement(each)) if law.explains else estimate.reasons
            found.estimates[method] = replace(estimate, reasons=()).judged("doubtful", *reservations, *others)
    if law.estimate is None and law.bounded and LEADING in found.estimates:
        found.estimates[LEADING] = found.estimates[LEADING].judged("doubtful", *law.bounded)
    if law.predicts is not None and law.estimate is None and LEADING in found.estimates:
        found.estimates[LEADING] = by_prediction(found.estimates[LEADING], law.predicts, noise_rad)


def _doubt_all(found: Identification, first: Sequence[str], last: Sequence[str] = ()) -> None:
    """No estimate is ok for these sentences, before and behind its own reasons."""
    if first or last:
        found.estimates = {
            method: replace(one.judged("doubtful"), reasons=(*first, *one.reasons, *last))
            for method, one in found.estimates.items()
        }


def _with_lost_counts(
    data: Measurements, found: Identification, used: Sequence[Estimator], by_name: bool
) -> Identification:
    """The same of plain files whose encoder loses counts one way, with these counts; else as it is."""
    law, plain = found.motor_law, found.estimates.get(LEADING)
    if law is None or plain is None or any(test.stage is not None for test in data.tests):
        return found
    try:
        share = lost_share(data.tests, plain, law)
    except IdentifyError:
        return found  # too short for pieces
    if share == 0.0:
        return found
    mended = replace(data, sources=list(data.sources), changes=list(data.changes), notes=list(data.notes))
    lost = f"{in_percent(abs(share))} of them {'forwards' if share > 0.0 else 'backwards'}"
    mended.take(partial(with_counts, share=share), f"the encoder loses counts, {lost}: put right before the fit")
    mended.doubts = [*data.doubts, f"the encoder loses counts, as it seems {lost}: see to its wires, and to the reader"]
    other = _found(mended)
    _add_estimates(used, mended, other, by_name)
    _doubt_all(other, mended.doubts)
    _add_motor_law(mended, other, (), None, was_known=False)
    return other if other.motor_law is not None and explains_more(other.motor_law, law) else found


def other_times_explain(slipped_rad: float, plain_rad: float, with_laws_rad: float) -> bool:
    """Whether other times of the drive explain the tests as well as laws do, by the RMS residuals of both, rad.

    plain_rad   of the plain motor: other times that better it by nothing explain nothing, and where the tests need no
                laws, other records showed them
    """
    gained, with_laws = (plain_rad**2 - rad**2 for rad in (slipped_rad, with_laws_rad))
    shows = SHOWS * slipped_rad < plain_rad
    return shows and slipped_rad < AS_GOOD * with_laws_rad and gained > MOST * with_laws


def _leading(data: Measurements, found: Identification) -> Estimate | None:
    """The leading estimate, fitted if it was not asked for; None if another has no tau and K, or if it fails."""
    if LEADING in found.estimates or not any(estimate.is_motor for estimate in found.estimates.values()):
        return found.estimates.get(LEADING)
    try:
        return _estimate(_made(next(entry for entry in ESTIMATORS if entry.name == LEADING)), data, {})
    except IdentifyError as error:
        _doubt(found, error.cause)
        return None


def _doubt(found: Identification, cause: str) -> None:
    """No estimate is ok that has no uncertainty budget."""
    for method, estimate in found.estimates.items():
        if estimate.is_motor:
            reason = f"what else the motor has is not known, so there is no u95: {cause}"
            found.estimates[method] = estimate.judged("doubtful", reason)


def _tells_no_motor(plain: Estimate, data: Measurements) -> bool:
    """Whether the tests say too little of any motor: with laws, too, they would. A fit without an end says nothing."""
    near = plain.is_motor and plain.converged and _bare(plain, data).verdict != "refused"
    return plain.verdict == "refused" and not near


def _may_have_laws(plain: Estimate, data: Measurements) -> bool:
    """Whether the plain estimate is near a motor, whatever its residual. No law mends wrong columns."""
    return not any(one.verdict == "refused" and one.spoils for one in judge_records(data.tests, plain))


def _bare(plain: Estimate, data: Measurements) -> Estimate:
    """The plain estimate judged as if it had no residual."""
    fine = replace(plain, rms_rad=0.0, repeated=0.0, verdict="ok", reasons=(), spoiled=False)
    return _with_causes(judge_with_laws(fine, data.tests, [(0.0, 0.0)]), data.tests)


def _beyond_laws(plain: Estimate, tests: Sequence[TimeSeries]) -> str | None:
    """What is wrong in the tests that laws would only imitate; None if nothing is known to be."""
    if any(is_cut_off(test) for test in tests):
        return "the position was cut off, and laws would only imitate that"
    noise_rad = noise_of_all_rad(tests)
    if plain.verdict == "refused" and other_times_explain(slipped_rms_rad(plain, tests), plain.rms_rad, noise_rad):
        return "the drive acted at other times than t_u_s says, and laws would only imitate that"
    return None
