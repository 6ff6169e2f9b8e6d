"""From recordings to estimates: which rows, which methods, and what to believe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rig.identify import describing_function, least_squares, sampled_data, triple_relay, verdict
from rig.identify.agreement import disagreement, opinions
from rig.identify.breakaway import Breakaway, breakaway
from rig.identify.cycles import find_cycle
from rig.identify.estimate import Estimate
from rig.identify.friction_law import Ladder, friction_law
from rig.identify.mean_cycle import Cycle
from rig.identify.plausibility import judge_motor, judge_records
from rig.identify.verdict import FEW_CYCLES
from rig.model.supply import SupplyReading
from rig.recording.reader import Recording
from rig.recording.series import IdentifyError, Record, from_recording
from rig.results import HystereticResult, IdentificationResult, RelayTestResult, StaticFrictionResult
from rig.signals import FLAG_GUARD_BRAKED, FLAG_GUARD_CLIPPED, FLAG_SATURATED

METHODS = (sampled_data.METHOD, triple_relay.METHOD, describing_function.METHOD, least_squares.METHOD)


@dataclass
class Identification:
    """Estimates by method, and what they rest on.

    estimates   method -> Estimate, in the order of ``METHODS``
    relays      the accepted relay tests
    hysteretic  the runs of hysteretic relays
    cycles      stage -> averaged cycle
    breakaway   drives at break-away both ways, None without a breakaway record
    friction_law    the ladder of friction laws, None where it was not asked for or sampled-data gave no estimate
    notes       which rows were used, how the gains were found, what was left out and why
    """

    estimates: dict[str, Estimate] = field(default_factory=dict)
    relays: list[RelayTestResult] = field(default_factory=list)
    hysteretic: list[HystereticResult] = field(default_factory=list)
    cycles: dict[str, Cycle] = field(default_factory=dict)
    breakaway: StaticFrictionResult | None = None
    friction_law: Ladder | None = None
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
        """The sampled-data estimate, else the next method's that was not refused and is a motor; None if all were."""
        usable = (self.estimates[method] for method in METHODS if method in self.estimates)
        return next((estimate for estimate in usable if estimate.verdict != "refused" and estimate.is_motor), None)


def identify(
    recordings: Sequence[Recording], methods: Sequence[str] | None = None, *, ladder: bool = True
) -> Identification:
    """Identify one motor from run folders or CSV files.

    methods   of ``METHODS``; default: all that the data allows
    ladder    whether to look for the friction law, with the sampled-data estimate
    A run's relay tests are used, or its hysteretic runs if it has no others; least squares takes the hysteretic runs
    alone. A CSV file without stages is used whole; it is taken for a hysteretic run only where least squares is asked
    for. Raises IdentifyError if a wanted method cannot work on the data, or none can.
    """
    unknown = [method for method in methods or () if method not in METHODS]
    if unknown:
        raise IdentifyError(f"there is no method {unknown[0]!r}", f"the methods are {', '.join(METHODS)}")
    if not recordings:
        raise IdentifyError("no recording was given", "give a run folder or a CSV file")
    wanted = tuple(methods) if methods else METHODS
    found = Identification()
    guarded: list[str] = []
    unsettled: list[str] = []  # relay tests without a settled cycle
    records: list[Record] = []
    hysteretic: list[Record] = []
    cycles: list[Cycle] = []
    periods_s: dict[int, float] = {}  # index of a record -> period of its cycle
    complaints: list[IdentifyError] = []
    of_recordings: list[tuple[str, list[Record]]] = []
    supplies: list[str] = []
    for recording in recordings:
        guarded += _guarded(recording)
        supplies += [said for said in _supply(recording) if said not in supplies]
        relay_tests, runs = _records(recording, len(recordings) > 1, found.notes)
        if least_squares.METHOD in (methods or ()) and not recording.stages():
            runs = relay_tests
        hysteretic += runs
        of_recordings.append((str(recording.source), relay_tests or runs))
        for record in relay_tests:
            records.append(record)
            if wanted == (least_squares.METHOD,):
                continue
            try:
                cycle = find_cycle(record)
            except IdentifyError as error:
                complaints.append(error)
                found.notes.append(f"{error.cause}: no cycle is averaged from it")
                if recording.stages():
                    unsettled.append(record.name)
                continue
            cycles.append(cycle)
            periods_s[len(records) - 1] = cycle.period_s
            found.cycles[record.name] = cycle
            found.relays.append(_relay(record.name, cycle))
            found.notes += [f"{record.name}: {note}" for note in cycle.notes]
    found.hysteretic = [least_squares.Transient.of(record).as_result() for record in hysteretic]
    records = records or hysteretic
    if not records:
        raise IdentifyError("no hysteretic run got as far as its first drive", "record it again: `rig relay CONFIG`")
    for method in METHODS:
        if method not in wanted or (method == least_squares.METHOD and not hysteretic and not methods):
            continue
        used = hysteretic if method == least_squares.METHOD else records
        try:
            if method == sampled_data.METHOD:
                estimate = _sampled_data(records, cycles, [periods_s.get(k) for k in range(len(records))])
                found.notes += filter(None, [verdict.confounding(estimate)])
            elif method == triple_relay.METHOD:
                estimate = _triple_relay(records, cycles, complaints)
            elif method == describing_function.METHOD:
                estimate = verdict.judge_reference(describing_function.fit(cycles), records, cycles)
            else:
                estimate = least_squares.fit(hysteretic)
                if sampled_data.METHOD in found.estimates:
                    estimate = least_squares.held_to(estimate, found.estimates[sampled_data.METHOD], hysteretic)
        except IdentifyError as error:
            if len(wanted) == 1:
                raise
            # the sampled-data estimator asks for least: what it misses is what the record lacks
            complaints.insert(0 if method == sampled_data.METHOD else len(complaints), error)
            found.notes.append(f"{method}: {error.cause}")
            continue
        objections = [*judge_records(used), *judge_motor(estimate, used)]
        consequences, estimate = estimate.reasons, replace(estimate, reasons=())  # the cause comes first
        for severity, reason in objections:
            estimate = estimate.judged(severity, reason)
        estimate = estimate.judged("ok", *consequences)
        if unsettled and not cycles and method != least_squares.METHOD:
            missing = f"no settled cycle in {', '.join(unsettled)}: {FEW_CYCLES} are missing; record ten"
            estimate = estimate.judged("refused", missing)
        if method == sampled_data.METHOD:
            found.notes += guarded  # it reads the drive as it acted
        elif method != least_squares.METHOD:  # it reads the drive too, and only until that first changes
            estimate = estimate.judged("doubtful", *guarded) if guarded else estimate
        found.estimates[method] = estimate
    if not found.estimates:
        raise complaints[0]
    several = len(recordings) > 1 and wanted != (least_squares.METHOD,)
    odd = disagreement(opinions(of_recordings)) if several else None
    if odd is not None:
        found.estimates = {method: e.judged("doubtful", odd) for method, e in found.estimates.items()}
    for wrong in supplies:
        found.estimates = {method: e.judged("doubtful", wrong) for method, e in found.estimates.items()}
    shown = _add_breakaway(recordings, found)
    if ladder:
        _add_friction_law(records, [periods_s.get(k) for k in range(len(records))], shown, found)
    return found


def _guarded(recording: Recording) -> list[str]:
    """What the guard changed of the relay's drive, as a sentence for each test."""
    said = []
    for stage in recording.stages():
        if stage.startswith("relay-"):
            rows = recording.flags[recording.stage_rows(stage)]
            changed = int(np.count_nonzero(rows & (FLAG_GUARD_BRAKED | FLAG_GUARD_CLIPPED)))
            if changed:
                said.append(
                    f"{stage}: the guard changed the drive in {changed} rows, so this is not the relay's own cycle; "
                    "record again with a smaller amplitude or wider limits"
                )
    return said


def _supply(recording: Recording) -> list[str]:
    """What a motor supply that is not the config's speaks against, from meta.json; nothing where that does not tell.

    A plain file and a run of an older version do not.
    """
    device, drive = recording.meta.firmware, recording.meta.drive
    if device is None or drive is None:
        return []
    measured_V, believed_V, drop_V = device.supply_V, drive.supply_V, drive.bridge_drop_V
    if measured_V is None or believed_V is None or drop_V is None or not 0.0 <= drop_V < believed_V:
        return []
    objection = SupplyReading(measured_V, device.supply_at_least is True, believed_V, drop_V).objection
    return [] if objection is None else [objection]


def _records(recording: Recording, several: bool, notes: list[str]) -> tuple[list[Record], list[Record]]:
    """The relay tests of a run, or all rows of a plain file; and the runs of hysteretic relays."""
    name = recording.source.name or str(recording.source)
    notes += [f"{name}: {note}" for note in recording.notes]
    stages = recording.stages()
    if not stages:
        chosen = [(slice(0, len(recording)), name)]
    else:
        relays = [stage for stage in stages if stage.startswith(("relay-", "hysteretic-"))]
        if not relays:
            raise IdentifyError(
                f"{name} has no relay test (stages: {', '.join(stages)})",
                "run `rig relay CONFIG` or `rig run CONFIG`, and identify that",
            )
        chosen = [(recording.stage_rows(stage), f"{name}:{stage}" if several else stage) for stage in relays]
    tests: list[Record] = []
    runs: list[Record] = []
    for rows, label in chosen:
        record, remarks = from_recording(recording, rows, label)
        if not str(recording.stage[rows][0]).startswith("hysteretic-"):
            tests.append(record)
        elif record.u_V.any():
            runs.append(record)
        else:
            notes.append(f"{label}: left out, it ended before its first drive")
        notes += [remark for remark in remarks if remark not in notes]
        saturated = int(np.count_nonzero(recording.flags[rows] & FLAG_SATURATED))
        if saturated:
            notes.append(f"{label}: the drive was saturated in {saturated} rows; the drive as it acted is used")
    return tests, runs


def _relay(stage: str, cycle: Cycle) -> RelayTestResult:
    return RelayTestResult(
        stage=stage,
        h1_V=cycle.h1_V,
        h2_V=cycle.h2_V,
        period_s=cycle.period_s,
        amplitude_rad=cycle.amplitude_rad,
        cycles=cycle.cycles,
    )


def _sampled_data(records: Sequence[Record], cycles: Sequence[Cycle], periods_s: Sequence[float | None]) -> Estimate:
    starts = [
        start
        for cycle in cycles[:1]
        for start in sampled_data.ridge_starts(cycle.omega_rad_s, cycle.amplitude_rad, cycle.h1_V, cycle.h2_V)
    ]
    estimate = sampled_data.fit(records, starts or None, periods_s=periods_s)
    return verdict.judge_sampled_data(estimate, records, cycles)


def _triple_relay(records: Sequence[Record], cycles: Sequence[Cycle], complaints: Sequence[IdentifyError]) -> Estimate:
    """Of several tests, the estimate whose cycles scatter least."""
    if not cycles:
        raise (
            complaints[-1] if complaints else IdentifyError("there is no relay test", "record one: `rig relay CONFIG`")
        )
    first = None
    if len(cycles) > 1:
        try:
            first = sampled_data.Start(*_parameters(describing_function.fit(cycles)))
        except IdentifyError:
            first = None  # the ridge's starts do without it
    estimates = [triple_relay.fit(cycle, first) for cycle in cycles]
    best = min(estimates, key=lambda e: e.covariance[0, 0] / e.tau_s**2 if e.covariance[0, 0] >= 0.0 else np.inf)
    used = cycles[estimates.index(best)]
    return verdict.judge_reference(best, records, [used])


def _parameters(estimate: Estimate) -> tuple[float, float, float]:
    if estimate.verdict == "refused":
        raise IdentifyError("the describing function gives no start", "use the others")
    return estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V


def _add_breakaway(recordings: Sequence[Recording], found: Identification) -> Breakaway | None:
    """Static friction, from the first recording that has a breakaway stage, on the sampled-data model."""
    estimate = found.estimates.get(sampled_data.METHOD)
    if estimate is None or estimate.verdict == "refused":
        return None
    for recording in recordings:
        if "breakaway" not in recording.stages():
            continue
        try:
            record, _ = from_recording(recording, recording.stage_rows("breakaway"), "breakaway")
        except IdentifyError as error:
            found.notes.append(error.cause)
            continue
        shown = breakaway(record, estimate, max(estimate.rms_rad, 1e-9))
        found.breakaway = shown.as_result()
        found.notes.append(f"breakaway: {shown.reason}")
        if shown.friction_V is not None:
            plus, minus, bias = shown.friction_V
            found.estimates[sampled_data.METHOD] = replace(estimate, fc_plus_V=plus, fc_minus_V=minus, bias_V=bias)
        return shown
    return None


def _add_friction_law(
    records: Sequence[Record], periods_s: Sequence[float | None], shown: Breakaway | None, found: Identification
) -> None:
    """The ladder of friction laws; the sampled-data estimate is doubtful where a law beyond its own predicts better."""
    estimate = found.estimates.get(sampled_data.METHOD)
    if estimate is None or estimate.verdict == "refused":
        return
    try:
        laws = friction_law(records, estimate, periods_s, shown)
    except IdentifyError as error:
        found.notes.append(f"friction law: {error.cause}")
        return
    found.friction_law = laws
    found.notes += laws.notes()
    richer = laws.beyond_coulomb
    if richer is not None:
        found.estimates[sampled_data.METHOD] = estimate.judged("doubtful", richer)
