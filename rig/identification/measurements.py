"""The data for the estimators: the tests in some recordings of one motor, their cycles, and their defects."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rig.core.signals import FLAG_GUARD_BRAKED, FLAG_GUARD_CLIPPED, FLAG_SATURATED
from rig.identification.cycles import NoRelayError, find_cycle
from rig.identification.mean_cycle import Cycle
from rig.identification.plausibility import since_it_moves, without_holes
from rig.identification.preprocessing import evened, from_recording
from rig.identification.records import FURTHER, left_out, sound_rows
from rig.identification.stated_errors import StatedErrors
from rig.model.supply import SupplyReading
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import FEWEST_ROWS, TimeSeries
from rig.run_folder.recording.stage import Stage, StageKind, kind_of
from rig.run_folder.results import Answer


@dataclass
class Measurements:
    """The tests of one motor.

    tests       relay tests, and plain files as a whole; hysteretic runs if there are no others
    hysteretic  runs of hysteretic relays
    cycles      for each of ``tests`` its averaged limit cycle, or None
    complaints  why a test has no cycle
    unsettled   names of the relay tests without a settled cycle
    guarded     one sentence for each test in which the guard changed the relay's drive
    doubts      one sentence for each motor supply that differs from the config, and for time stamps of other rows
    sources     for each recording its name, and its series
    recording_of  for each of ``tests`` the name of its recording
    further     records beside the tests, for the law of the motor: gain search and breakaway check, as far as they are
                sound, each with the number of a test of the same run
    stated      for each recording what its bench may be wrong by
    changes     one sentence for each change of what plain files say before the fit; also in ``notes``
    notes       what was left out or corrected, how gains and cycles were found
    has_searches  whether gain searches count as tests beside others
    unsure      what each oddity of plain files leaves unknown in the answer
    """

    tests: list[TimeSeries] = field(default_factory=list)
    hysteretic: list[TimeSeries] = field(default_factory=list)
    cycles: list[Cycle | None] = field(default_factory=list)
    complaints: list[IdentifyError] = field(default_factory=list)
    unsettled: list[str] = field(default_factory=list)
    guarded: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    sources: list[tuple[str, Sequence[TimeSeries]]] = field(default_factory=list)
    further: list[tuple[TimeSeries, int]] = field(default_factory=list)
    stated: list[StatedErrors] = field(default_factory=list)
    recording_of: list[str] = field(default_factory=list)
    changes: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    has_searches: bool = False
    unsure: list[Callable[[Answer], Answer]] = field(default_factory=list)

    @property
    def settled(self) -> list[Cycle]:
        """The limit cycles that were found."""
        return [cycle for cycle in self.cycles if cycle is not None]

    @property
    def of_relay(self) -> bool:
        """Whether a test is, or ought to be, of a dual-channel relay."""
        return bool(self.settled or self.unsettled) or any(
            not isinstance(complaint, NoRelayError) for complaint in self.complaints
        )

    @property
    def periods_s(self) -> list[float | None]:
        """For each of ``tests`` the period of its cycle, s; None if it has no cycle."""
        return [None if cycle is None else cycle.period_s for cycle in self.cycles]

    @property
    def beside(self) -> list[TimeSeries]:
        """Breakaway check and gain search, as far as they are sound. A survey is too slow for a plain motor."""
        kinds = (StageKind.BREAKAWAY, StageKind.SEARCH)
        return [series for series, _ in self.further if series.stage is not None and series.stage.kind in kinds]

    def take_unknown_delay(self, delay_s: tuple[float, float]) -> None:
        """From now on the drives of all series act an unknown constant delay later, s: at least and at most."""
        known = [*self.tests, *(series for series, _ in self.further)]
        late = {id(series): series.with_unknown_delay(delay_s) for series in known}
        self.tests = [late[id(test)] for test in self.tests]
        self.further = [(late[id(series)], number) for series, number in self.further]
        self.sources = [(name, [late.get(id(series), series) for series in each]) for name, each in self.sources]

    def take(self, changed: Callable[[TimeSeries], TimeSeries], *notes: str) -> None:
        """From now on the tests are changed by this; ``notes``: what was changed."""
        moved = {id(test): changed(test) for test in self.tests}
        self.tests = [moved[id(test)] for test in self.tests]
        self.sources = [(name, [moved.get(id(series), series) for series in each]) for name, each in self.sources]
        self.tell(*notes)

    def tell(self, *changes: str) -> None:
        """Note what was changed before the fit."""
        self.changes += changes
        self.notes += changes

    def take_searches(self) -> bool:
        """Read the gain searches as tests, too, before the others; whether there were any.

        For tests that are too short to tell a motor: the run ended soon after its search.
        """
        found = [(one, k) for one, k in self.further if one.stage is not None and one.stage.kind is StageKind.SEARCH]
        if not found:
            return False
        searches = [search for search, _ in found]
        kept = [(one, k + len(found)) for one, k in self.further if all(one is not search for search in searches)]
        names = [self.recording_of[number] for _, number in found]
        self.further, self.has_searches = kept, True
        short = " and ".join(test.name for test in self.tests)
        self.notes.append(f"{short}: too little alone to tell the motor: the gain search is a test, too")
        self.tests = [*searches, *self.tests]
        self.cycles = [*([None] * len(found)), *self.cycles]
        self.recording_of = [*names, *self.recording_of]
        self.sources = [
            (name, [*(s for s, own in zip(searches, names, strict=True) if own == name), *each])
            for name, each in self.sources
        ]
        return True


def measurements(
    recordings: Sequence[Recording], *, with_cycles: bool, plain_is_hysteretic: bool, without: Sequence[str] = ()
) -> Measurements:
    """Gather the tests of the recordings.

    with_cycles          whether to find the limit cycles
    plain_is_hysteretic  whether a file without stages may also be the run of a hysteretic relay
    without              names of stages that are not read
    Raises IdentifyError if a recording has no test, or if no test can be used.
    """
    data = Measurements()
    beside: list[tuple[TimeSeries, TimeSeries]] = []
    for recording in recordings:
        stated = StatedErrors.of(recording.meta)
        data.stated.append(stated if recording.reads == "angle" else replace(stated, linearity_percent=0.0))
        gone = left_out(recording, without)
        data.guarded += _guarded(recording)
        data.doubts += [reason for reason in _supply(recording) if reason not in data.doubts]
        tests, runs = _series_of(recording, gone, len(recordings) > 1, data.notes)
        if not recording.stages() and not plain_is_hysteretic:
            [whole] = tests
            tests, changes = at_their_times(whole)
            data.tell(*changes)
        if plain_is_hysteretic and not recording.stages():
            runs = tests
        data.hysteretic += runs
        data.sources.append((str(recording.source), tests or runs))
        if tests or runs:
            further = _further_of(recording, gone, [*tests, *runs], len(recordings) > 1, data.notes)
            beside += [(series, (tests or runs)[0]) for series in further]
        for test in tests:
            data.tests.append(test)
            data.recording_of.append(str(recording.source))
            has_cycle = with_cycles and (test.stage is None or test.stage.kind is not StageKind.STROKES)
            data.cycles.append(_cycle(test, data) if has_cycle else None)
    moved = [k for k, test in enumerate(data.tests) if test.stage is not None or np.ptp(test.y_rad) > 0.0]
    if 0 < len(moved) < len(data.tests):
        still = [test.name for k, test in enumerate(data.tests) if k not in moved]
        data.notes += [f"{name}: left out, because its shaft never moved" for name in still]
        data.tests, data.cycles = [data.tests[k] for k in moved], [data.cycles[k] for k in moved]
        data.recording_of = [data.recording_of[k] for k in moved]
    if not data.tests:
        data.tests = data.hysteretic
        data.recording_of = [name for name, series in data.sources for _ in series]
        data.cycles = [None] * len(data.tests)
    if not data.tests:
        raise IdentifyError("every hysteretic run ended before its first drive", "record again: `rig relay CONFIG`")
    of_run = {id(test): number for number, test in enumerate(data.tests)}
    data.further = [(series, of_run[id(test)]) for series, test in beside if id(test) in of_run]
    return data


def _cycle(test: TimeSeries, data: Measurements) -> Cycle | None:
    """The limit cycle of a test. Without one, the reason goes into ``data``."""
    try:
        cycle = find_cycle(test)
    except IdentifyError as error:
        data.complaints.append(error)
        if test.stage is not None or not isinstance(error, NoRelayError):  # a chirp is no failed relay test
            data.notes.append(f"{error.cause}: no cycle is averaged from it")
        if test.stage is not None and test.stage.is_test:
            data.unsettled.append(test.name)
        return None
    data.notes += [f"{test.name}: {note}" for note in cycle.notes]
    return cycle


def _guarded(recording: Recording) -> list[str]:
    """One sentence for each test in which the guard changed the relay's drive."""
    reasons = []
    for stage in recording.stages():
        if kind_of(stage) is StageKind.RELAY:
            rows = recording.flags[recording.stage_rows(stage)]
            changed = int(np.count_nonzero(rows & (FLAG_GUARD_BRAKED | FLAG_GUARD_CLIPPED)))
            if changed:
                reasons.append(
                    f"{stage}: the guard changed the drive in {changed} rows, so this is not the relay's own cycle; "
                    "record again with a smaller amplitude or wider limits"
                )
    return reasons


def _supply(recording: Recording) -> list[str]:
    """One sentence if the measured motor supply in meta.json differs from the config.

    It is empty for a plain file and for a run of an older version: they have no measurement.
    """
    device, drive = recording.meta.firmware, recording.meta.drive
    if device is None or drive is None:
        return []
    measured_V, believed_V, drop_V = device.supply_V, drive.supply_V, drive.bridge_drop_V
    if measured_V is None or believed_V is None or drop_V is None or not 0.0 <= drop_V < believed_V:
        return []
    objection = SupplyReading(measured_V, device.supply_at_least is True, believed_V, drop_V).objection
    return [] if objection is None else [objection]


def _series_of(
    recording: Recording, gone: Collection[str], several: bool, notes: list[str]
) -> tuple[list[TimeSeries], list[TimeSeries]]:
    """The relay tests, or the gain search of a run that ended before them, or a plain file; and the hysteretic runs."""
    name = recording.source.name or str(recording.source)
    notes += [f"{name}: {note}" for note in recording.notes]
    stages = recording.stages()
    chosen: list[tuple[str, slice]] = []
    if not stages:
        chosen = [(name, slice(0, len(recording)))]
    for stage in _tests_of(recording, name, gone) if stages else ():
        rows, remark = sound_rows(recording, stage)
        notes += [] if remark is None else [remark]
        chosen.append((_label(name, stage, several), rows))
    if len(chosen) > 1:
        short = [label for label, rows in chosen if rows.stop - rows.start < FEWEST_ROWS]
        if len(short) < len(chosen):
            notes += [f"{label}: left out, because fewer than {FEWEST_ROWS} of its rows can be used" for label in short]
            chosen = [(label, rows) for label, rows in chosen if label not in short]
        # another test took its place within one stroke
        steady = [label for label, rows in chosen if stages and np.ptp(recording.u_V[rows]) == 0.0]
        if len(steady) < len(chosen):
            notes += [f"{label}: left out, because its drive never changed" for label in steady]
            chosen = [(label, rows) for label, rows in chosen if label not in steady]
    tests: list[TimeSeries] = []
    runs: list[TimeSeries] = []
    for label, rows in chosen:
        series, remarks = from_recording(recording, rows, label)
        if series.stage is None or series.stage.kind is not StageKind.HYSTERETIC:
            tests.append(series)
        elif series.u_V.any():
            runs.append(series)
        else:
            notes.append(f"{label}: left out, because it ended before its first drive")
        notes += [remark for remark in remarks if remark not in notes]
        saturated = int(np.count_nonzero(recording.flags[rows] & FLAG_SATURATED))
        if saturated:
            notes.append(f"{label}: the drive was saturated in {saturated} rows; rig uses the drive that acted")
    return tests, runs


def at_their_times(whole: TimeSeries) -> tuple[list[TimeSeries], list[str]]:
    """The parts of a plain file between gaps, at even times where its stamps scatter about these, and sentences."""
    whole = since_it_moves(whole)
    test, said = evened(whole)
    parts, gaps = ([test], said) if said else without_holes(whole)
    if len(parts) > 1:
        each = [evened(part) for part in parts]
        parts, said = [part for part, _ in each], next((notes for _, notes in each if notes), [])
    return parts, [*gaps, *said] if len(parts) > 1 else gaps


def _tests_of(recording: Recording, name: str, gone: Collection[str]) -> list[str]:
    """The stages that are tests; of a run that ended before the first one, or soon after it began, its gain search.

    Raises IdentifyError if there are none.
    """
    stages = recording.stages()
    relays = [stage for stage in stages if Stage.parse(stage).is_test]
    short = [stage for stage in relays if _rows_of(recording, stage) < FEWEST_ROWS]
    searches = [stage for stage in stages if kind_of(stage) is StageKind.SEARCH] if short == relays else []
    kept = [stage for stage in searches or relays if stage not in gone] or [one for one in relays if one not in gone]
    if kept:
        return kept
    if relays:
        raise IdentifyError(f"{name}: every relay test is left out", f"keep one of {', '.join(relays)}")
    raise IdentifyError(
        f"{name} has no relay test (stages: {', '.join(stages)})",
        "run `rig relay CONFIG` or `rig run CONFIG`, and identify that",
    )


def _rows_of(recording: Recording, stage: str) -> int:
    rows = sound_rows(recording, stage)[0]
    return int(rows.stop) - int(rows.start)


def _further_of(
    recording: Recording, gone: Collection[str], tests: Sequence[TimeSeries], several: bool, notes: list[str]
) -> list[TimeSeries]:
    """Records of a run beside its tests, as far as they are sound."""
    name = recording.source.name or str(recording.source)
    used = [test.stage.name for test in tests if test.stage is not None]
    found = []
    for stage in recording.stages():
        if kind_of(stage) not in FURTHER or stage in gone or stage in used:
            continue
        rows, remark = sound_rows(recording, stage)
        notes += [] if remark is None else [remark]
        if rows.stop - rows.start >= FEWEST_ROWS:
            series, remarks = from_recording(recording, rows, _label(name, stage, several))
            notes += [remark for remark in remarks if remark not in notes]
            found.append(series)
    return found


def _label(name: str, stage: str, several: bool) -> str:
    return f"{name}:{stage}" if several else stage
