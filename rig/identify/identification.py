"""From recordings to estimates: gather the tests, run each estimator of the list, choose the friction law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module

import numpy as np

from rig.estimators import ESTIMATORS, LEADING, EstimatorEntry
from rig.identify.agreement import disagreement, estimates_of_each
from rig.identify.breakaway import StaticFriction, breakaway
from rig.identify.estimate import Estimate
from rig.identify.estimator import Estimator
from rig.identify.friction_law import FrictionLawChoice, friction_law
from rig.identify.least_squares import Transient
from rig.identify.mean_cycle import Cycle
from rig.identify.measurements import Measurements, measurements
from rig.identify.motor_law import NO_LAW, MotorLaw, motor_law
from rig.identify.plausibility import judge_motor, judge_records
from rig.identify.preprocessing import from_recording
from rig.identify.sampled_data_verdict import judge_with_laws, late_s, slipped_rms_rad
from rig.identify.stroke_delay import strokes_delay
from rig.identify.verdict import settled
from rig.recording.errors import IdentifyError
from rig.recording.recording import Recording
from rig.recording.series import LATENCY_S, TimeSeries
from rig.recording.stage import StageKind, kind_of
from rig.results import HystereticResult, IdentificationResult, RelayTestResult, StaticFrictionResult

METHODS = tuple(entry.name for entry in ESTIMATORS)
AS_GOOD = 1.05  # ratio of residuals within which two explanations are as good


@dataclass
class Identification:
    """Estimates by method, and the data behind them.

    estimates   method -> Estimate, in the order of ``ESTIMATORS``
    relays      the accepted relay tests
    hysteretic  the runs of hysteretic relays
    cycles      stage -> averaged cycle
    breakaway   drives at break-away in both directions; None without breakaway ramps
    friction_law    the choice of a friction law; None if not asked for, or without a sampled-data estimate
    motor_law       what the tests show beyond the plain motor; None if not asked for, or without that estimate
    notes       rows used, how the gains were found, what was left out and why
    """

    estimates: dict[str, Estimate] = field(default_factory=dict)
    relays: list[RelayTestResult] = field(default_factory=list)
    hysteretic: list[HystereticResult] = field(default_factory=list)
    cycles: dict[str, Cycle] = field(default_factory=dict)
    breakaway: StaticFrictionResult | None = None
    friction_law: FrictionLawChoice | None = None
    motor_law: MotorLaw | None = None
    notes: list[str] = field(default_factory=list)

    def as_result(self) -> IdentificationResult:
        """As `rig identify --json` prints it. result.json has the same names."""
        return IdentificationResult(
            relays=tuple(self.relays),
            estimates={method: estimate.as_result() for method, estimate in self.estimates.items()},
            notes=tuple(self.notes),
            hysteretic=tuple(self.hysteretic) or None,
            breakaway=self.breakaway,
            friction_law=None if self.friction_law is None else self.friction_law.as_result(),
            **(NO_LAW if self.motor_law is None else self.motor_law.as_keys()),
        )

    @property
    def best(self) -> Estimate | None:
        """The first estimate of the list that is not refused and has tau and K; None without one."""
        usable = (estimate for estimate in self.estimates.values() if estimate.verdict != "refused")
        return next((estimate for estimate in usable if estimate.is_motor), None)


def identify(
    recordings: Sequence[Recording], methods: Sequence[str] | None = None, *, choose_law: bool = True
) -> Identification:
    """Identify one motor from run folders or CSV files.

    methods     names of ``ESTIMATORS``; default: all that the data allow
    choose_law  whether to choose a friction law, from the sampled-data estimate
    The estimators read a run's relay tests, or its hysteretic runs if it has no relay tests. Least squares reads only
    hysteretic runs. A CSV file without stages is one test; it counts as a hysteretic run only if ``methods`` has least
    squares. Raises IdentifyError if a method of ``methods`` cannot work on the data, or if no method can.
    """
    wanted = _wanted(methods)
    if not recordings:
        raise IdentifyError("no recording was given", "give a run folder or a CSV file")
    reads_tests = any(estimator.reads_relay_tests for estimator in wanted)
    reads_runs = bool(methods) and not all(estimator.reads_relay_tests for estimator in wanted)
    data = measurements(recordings, with_cycles=reads_tests, plain_is_hysteretic=reads_runs)
    found = _found(data)
    chosen = [e for e in wanted if methods or e.series(data)]
    errors = _add_estimates(chosen, data, found)
    if _takes_delay(data, found.estimates.get(LEADING), recordings):
        found = _found(data)
        errors = _add_estimates(chosen, data, found)
    if not found.estimates:
        # the leading estimator needs the least data: what it misses, the recording lacks
        decisive = wanted[0].name if len(wanted) == 1 else LEADING
        raise errors.get(decisive) or [*data.complaints, *errors.values()][0]
    objections = list(data.supplies)
    if len(recordings) > 1 and reads_tests:
        odd = disagreement(estimates_of_each(data.sources))
        objections = objections if odd is None else [odd, *objections]
    if objections:
        found.estimates = {method: e.judged("doubtful", *objections) for method, e in found.estimates.items()}
    if choose_law:
        _add_motor_law(data, found, objections)
    static = _add_breakaway(recordings, found)
    if choose_law:
        _add_friction_law(data, static, found)
    return found


def _takes_delay(data: Measurements, estimate: Estimate | None, recordings: Sequence[Recording]) -> bool:
    """Whether the bench acts later than its tests say. Then the tests of ``data`` have an unknown delay.

    If they say when each drive acted, the strokes of a breakaway check must allow that it was later: else it is
    columns that are wrong, not the bench.
    """
    if estimate is None or estimate.verdict == "ok" or any(test.delay_s is not None for test in data.tests):
        return False
    later_s = late_s(estimate, data.tests)
    if later_s == 0.0:
        return False
    bound_s = (0.0, LATENCY_S)
    if data.tests[0].t_u_s is not None:
        strokes = [strokes_delay(recording) for recording in recordings]
        if any(one is None or not one.low_s <= later_s <= one.high_s for one in strokes):
            return False
        bound_s = (0.0, estimate.delay_s + max(one.high_s for one in strokes if one is not None))
    data.tests = [test.with_unknown_delay(bound_s) for test in data.tests]
    data.notes.append("the drive acts later than the recording says: its delay is fitted")
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
    estimators: Sequence[Estimator], data: Measurements, found: Identification
) -> dict[str, IdentifyError]:
    """Add what each estimator finds, and its notes. Returns why the others cannot work on the data, by name."""
    errors: dict[str, IdentifyError] = {}
    for estimator in estimators:
        try:
            estimate = _estimate(estimator, data, found.estimates)
        except IdentifyError as error:
            errors[estimator.name] = error
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
    """The judged estimate with what is wrong in columns and units, which comes first: it is the cause."""
    consequences, estimate = judged.reasons, replace(judged, reasons=())
    for severity, reason in [*judge_records(read), *judge_motor(estimate, read)]:
        estimate = estimate.judged(severity, reason)
    return estimate.judged("ok", *consequences)


def _found(data: Measurements) -> Identification:
    """The identification before the first estimate: tests, cycles, notes."""
    cycles = [(test.name, cycle) for test, cycle in zip(data.tests, data.cycles, strict=True) if cycle is not None]
    return Identification(
        relays=[_relay(name, cycle) for name, cycle in cycles],
        hysteretic=[Transient.of(run).as_result() for run in data.hysteretic],
        cycles=dict(cycles),
        notes=list(data.notes),
    )


def _relay(stage: str, cycle: Cycle) -> RelayTestResult:
    return RelayTestResult(
        stage=stage,
        h1_V=cycle.h1_V,
        h2_V=cycle.h2_V,
        period_s=cycle.period_s,
        amplitude_rad=cycle.amplitude_rad,
        cycles=cycle.cycles,
    )


def _add_breakaway(recordings: Sequence[Recording], found: Identification) -> StaticFriction | None:
    """Static friction from the first recording with a breakaway stage, by the sampled-data model."""
    estimate = found.estimates.get(LEADING)
    if estimate is None or estimate.verdict == "refused":
        return None
    for recording in recordings:
        stage = next((name for name in recording.stages() if kind_of(name) is StageKind.BREAKAWAY), None)
        if stage is None:
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


def _add_motor_law(data: Measurements, found: Identification, objections: Sequence[str]) -> None:
    """What the motor has beyond the plain law, and the estimate with it. The plain estimate stays as it is."""
    plain = found.estimates.get(LEADING)
    if plain is None or not plain.is_motor or not _may_have_laws(plain, data):
        return
    try:
        law = motor_law(data.tests, plain, data.periods_s)
    except IdentifyError as error:
        found.notes.append(f"law of the motor: {error.cause}")
        return
    except np.linalg.LinAlgError as error:
        found.notes.append(f"law of the motor: these tests give no answer ({error}); the plain estimate holds")
        return
    if law.estimate is not None and slipped_rms_rad(plain, data.tests) < AS_GOOD * law.estimate.rms_rad:
        law = law.without_laws()  # other times of the drive explain the record as well: the plain verdict says so
    if law.estimate is not None:
        judged = settled(judge_with_laws(law.estimate, data.tests, data.settled), data)
        judged = _with_causes(judged, data.tests).judged("doubtful" if objections else "ok", *objections)
        law = replace(law, estimate=judged)
    found.motor_law = law
    found.notes += law.notes()
    uncertain = law.reservation(law.estimate or plain, max(float(np.abs(test.u_V).max()) for test in data.tests))
    if uncertain is not None:
        found.notes.append(uncertain)


def _may_have_laws(plain: Estimate, data: Measurements) -> bool:
    """Whether the plain estimate is near a motor, whatever its residual. No law mends wrong columns."""
    fine = replace(plain, rms_rad=0.0, repeated=0.0, verdict="ok", reasons=())
    judged = settled(judge_with_laws(fine, data.tests, data.settled), data)
    return _with_causes(judged, data.tests).verdict != "refused"


def _add_friction_law(data: Measurements, static: StaticFriction | None, found: Identification) -> None:
    """Choose a law. The sampled-data estimate becomes doubtful if a richer law predicts better."""
    estimate = found.estimates.get(LEADING)
    if estimate is None or estimate.verdict == "refused":
        return
    try:
        choice = friction_law(data.tests, estimate, data.periods_s, static)
    except IdentifyError as error:
        found.notes.append(f"friction law: {error.cause}")
        return
    found.friction_law = choice
    found.notes += choice.notes()
    richer = choice.beyond_coulomb
    if richer is not None:
        found.estimates[LEADING] = estimate.judged("doubtful", richer)
