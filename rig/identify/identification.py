"""From recordings to estimates: gather the tests, run each estimator of the list, choose the friction law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from rig.identify.agreement import disagreement, estimates_of_each
from rig.identify.breakaway import StaticFriction, breakaway
from rig.identify.describing_function import DescribingFunction
from rig.identify.estimate import Estimate
from rig.identify.estimator import Estimator
from rig.identify.friction_law import FrictionLawChoice, friction_law
from rig.identify.least_squares import LeastSquares, Transient
from rig.identify.mean_cycle import Cycle
from rig.identify.measurements import Measurements, measurements
from rig.identify.plausibility import judge_motor, judge_records
from rig.identify.preprocessing import from_recording
from rig.identify.sampled_data import SampledData
from rig.identify.triple_relay import TripleRelay
from rig.recording.errors import IdentifyError
from rig.recording.reader import Recording
from rig.recording.stage import StageKind, kind_of
from rig.results import HystereticResult, IdentificationResult, RelayTestResult, StaticFrictionResult

# The estimators, the one to trust first: another one is a file, and a line here.
ESTIMATORS: list[Estimator] = [
    SampledData(),
    TripleRelay(),
    DescribingFunction(),
    LeastSquares(),
]
METHODS = tuple(estimator.name for estimator in ESTIMATORS)
LEADING = ESTIMATORS[0].name  # asks for least, and its model is the one that friction laws are added to


@dataclass
class Identification:
    """Estimates by method, and what they rest on.

    estimates   method -> Estimate, in the order of ``ESTIMATORS``
    relays      the accepted relay tests
    hysteretic  the runs of hysteretic relays
    cycles      stage -> averaged cycle
    breakaway   drives at break-away both ways, None without a breakaway record
    friction_law    the choice of a friction law, None where it was not asked for or sampled-data gave no estimate
    notes       which rows were used, how the gains were found, what was left out and why
    """

    estimates: dict[str, Estimate] = field(default_factory=dict)
    relays: list[RelayTestResult] = field(default_factory=list)
    hysteretic: list[HystereticResult] = field(default_factory=list)
    cycles: dict[str, Cycle] = field(default_factory=dict)
    breakaway: StaticFrictionResult | None = None
    friction_law: FrictionLawChoice | None = None
    notes: list[str] = field(default_factory=list)

    def as_result(self) -> IdentificationResult:
        """As `rig identify --json` prints it, and result.json holds it, by the same names."""
        return IdentificationResult(
            relays=tuple(self.relays),
            estimates={method: estimate.as_result() for method, estimate in self.estimates.items()},
            notes=tuple(self.notes),
            hysteretic=tuple(self.hysteretic) or None,
            breakaway=self.breakaway,
            friction_law=None if self.friction_law is None else self.friction_law.as_result(),
        )

    @property
    def best(self) -> Estimate | None:
        """The first estimate, in the order of the list, that was not refused and is a motor; None if all were."""
        usable = (estimate for estimate in self.estimates.values() if estimate.verdict != "refused")
        return next((estimate for estimate in usable if estimate.is_motor), None)


def identify(
    recordings: Sequence[Recording], methods: Sequence[str] | None = None, *, choose_law: bool = True
) -> Identification:
    """Identify one motor from run folders or CSV files.

    methods     names of ``ESTIMATORS``; default: all that the data allow
    choose_law  whether to look for the friction law, with the sampled-data estimate
    A run's relay tests are used, or its hysteretic runs if it has no others; least squares takes the hysteretic runs
    alone. A CSV file without stages is used whole; it is taken for a hysteretic run only where least squares is asked
    for. Raises IdentifyError if a wanted method cannot work on the data, or none can.
    """
    wanted = _wanted(methods)
    if not recordings:
        raise IdentifyError("no recording was given", "give a run folder or a CSV file")
    reads_tests = any(estimator.reads_relay_tests for estimator in wanted)
    reads_runs = bool(methods) and not all(estimator.reads_relay_tests for estimator in wanted)
    data = measurements(recordings, with_cycles=reads_tests, plain_is_hysteretic=reads_runs)
    found = _found(data)
    complaints: dict[str, IdentifyError] = {}
    for estimator in wanted:
        if not methods and not estimator.series(data):
            continue
        try:
            estimate = _estimate(estimator, data, found.estimates)
        except IdentifyError as error:
            if len(wanted) == 1:
                raise
            complaints[estimator.name] = error
            found.notes.append(f"{estimator.name}: {error.cause}")
            continue
        found.estimates[estimator.name] = estimate
        found.notes += estimator.notes(estimate, data)
    if not found.estimates:
        # the estimator that asks for least: what it misses is what the record lacks
        leading = complaints.pop(LEADING, None)
        raise leading or [*data.complaints, *complaints.values()][0]
    odd = disagreement(estimates_of_each(data.sources)) if len(recordings) > 1 and reads_tests else None
    for objection in [*([] if odd is None else [odd]), *data.supplies]:
        found.estimates = {method: e.judged("doubtful", objection) for method, e in found.estimates.items()}
    shown = _add_breakaway(recordings, found)
    if choose_law:
        _add_friction_law(data, shown, found)
    return found


def _wanted(methods: Sequence[str] | None) -> list[Estimator]:
    """The estimators of these names, in the order of the list; all without names. Raises IdentifyError."""
    known = [estimator.name for estimator in ESTIMATORS]
    unknown = [method for method in methods or () if method not in known]
    if unknown:
        raise IdentifyError(f"there is no method {unknown[0]!r}", f"the methods are {', '.join(known)}")
    return [estimator for estimator in ESTIMATORS if not methods or estimator.name in methods]


def _estimate(estimator: Estimator, data: Measurements, earlier: dict[str, Estimate]) -> Estimate:
    """One estimator's estimate, with its verdict; what the columns and units say goes first. Raises IdentifyError."""
    lacking = estimator.applies(data)
    if lacking is not None:
        raise lacking
    judged = estimator.judge(estimator.fit(data), data, earlier)
    consequences, estimate = judged.reasons, replace(judged, reasons=())  # the cause comes first
    read = estimator.series(data)
    for severity, reason in [*judge_records(read), *judge_motor(estimate, read)]:
        estimate = estimate.judged(severity, reason)
    return estimate.judged("ok", *consequences)


def _found(data: Measurements) -> Identification:
    """What there is to say before anything is estimated."""
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
    """Static friction, from the first recording that has a breakaway stage, on the sampled-data model."""
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
        shown = breakaway(ramps, estimate, max(estimate.rms_rad, 1e-9))
        found.breakaway = shown.as_result()
        found.notes.append(f"breakaway: {shown.reason}")
        if shown.friction_V is not None:
            plus, minus, bias = shown.friction_V
            found.estimates[LEADING] = replace(estimate, fc_plus_V=plus, fc_minus_V=minus, bias_V=bias)
        return shown
    return None


def _add_friction_law(data: Measurements, shown: StaticFriction | None, found: Identification) -> None:
    """The choice of a law; the sampled-data estimate is doubtful where one beyond its own predicts better."""
    estimate = found.estimates.get(LEADING)
    if estimate is None or estimate.verdict == "refused":
        return
    try:
        choice = friction_law(data.tests, estimate, data.periods_s, shown)
    except IdentifyError as error:
        found.notes.append(f"friction law: {error.cause}")
        return
    found.friction_law = choice
    found.notes += choice.notes()
    richer = choice.beyond_coulomb
    if richer is not None:
        found.estimates[LEADING] = estimate.judged("doubtful", richer)
