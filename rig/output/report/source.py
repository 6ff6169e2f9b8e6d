"""Reads a run folder for the report. For each part that is missing or unreadable it keeps a sentence."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from rig.config.problems import ConfigError
from rig.config.yaml12 import parse
from rig.core.estimators import ESTIMATORS
from rig.core.faults import FAULTS
from rig.model.error_decay import K1_1_S, K2_1_S2
from rig.output.report.style import AbsentError, stage_kind
from rig.run_folder.recording.csv_file import read_csv
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import CONFIG, META, RESULT
from rig.run_folder.recording.reader import read_config_text, read_events, read_meta, read_result
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.writer import EVENTS, SAMPLES
from rig.run_folder.results import (
    EstimateResult,
    FaultReport,
    FoundLawResult,
    Part,
    RunEvent,
    RunMeta,
    RunResult,
    TrueLaw,
    known,
)
from rig.run_folder.results.estimates import LARGEST
from rig.run_folder.results.meta import REHEARSAL
from rig.run_folder.results.salvage import salvaged

_P = TypeVar("_P", bound=Part)
_T = TypeVar("_T")

PREFERRED = tuple(entry.name for entry in ESTIMATORS)


class Span(NamedTuple):
    """Rows ``first`` to ``last`` (both included) of one visit to ``stage``."""

    stage: str
    first: int
    last: int


@dataclass(frozen=True)
class Settings:
    """What the report shows of config.yaml; None if the config does not say it.

    soft_rad, hard_rad   travel limits
    wanted_amplitude_rad, wanted_period_s, tolerance   the cycle that the gain search looks for
    second_ratio         amplitude of the second test over the first's
    tracks               whether there is a trajectory to track
    decay                offset from which each check begins, rad, and k1, 1/s, and k2, 1/s^2, of (34); None without one
    text                 the file as it is; "" if there is none
    """

    period_s: float | None = None
    soft_rad: tuple[float, float] | None = None
    hard_rad: tuple[float, float] | None = None
    wanted_amplitude_rad: float | None = None
    wanted_period_s: float | None = None
    tolerance: float | None = None
    second_ratio: float | None = None
    tracks: bool = False
    decay: tuple[float, float, float] | None = None
    is_there: bool = False
    text: str = ""


@dataclass(frozen=True)
class ReportedRun:
    """A run folder as far as it could be read.

    recording  the rows of samples.csv; None if it is missing or unusable
    meta, result   empty if there is no such file, or nothing in it can be used
    missing    one sentence for each part that is missing or unreadable
    notes      what was wrong and was tolerated, such as a torn last line
    of_recordings   it is no run: the backend names the recordings of a page
    """

    folder: Path
    recording: Recording | None
    meta: RunMeta
    result: RunResult
    config: Settings = field(default_factory=Settings)
    events: tuple[RunEvent, ...] = ()
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    of_recordings: bool = False

    @property
    def name(self) -> str:
        """The run's name: its folder's."""
        return self.folder.resolve().name

    @property
    def backend(self) -> str:
        """The backend in words, as recorded."""
        return self.meta.backend or self.result.backend or "not recorded (meta.json is missing)"

    @property
    def foot(self) -> str:
        """What a figure was recorded from, for its foot: the backend, or without a run the recordings."""
        return f"{'recording' if self.of_recordings else 'backend'}: {self.backend}"

    @property
    def rehearsal(self) -> str:
        """That nothing was measured, as a sentence; empty of any other run."""
        return f"{REHEARSAL[0].upper()}{REHEARSAL[1:]}." if self.meta.rehearsal or self.result.rehearsal else ""

    @property
    def truth(self) -> dict[str, float]:
        """True parameters of an emulated motor; empty if the motor is real."""
        motor = self.meta.truth or self.result.truth
        if motor is None:
            return {}
        values = {name: known(motor.value(name)) for name in type(motor).model_fields}
        return {name: value for name, value in values.items() if math.isfinite(value)}

    @property
    def true_laws(self) -> tuple[TrueLaw, ...] | None:
        """What an emulated motor has beyond tau, K and Coulomb friction; None if it is real, and in an older run."""
        motor = self.meta.truth or self.result.truth
        return None if motor is None else motor.law

    @property
    def has_result(self) -> bool:
        """Whether the run has a result."""
        return bool(self.result.model_fields_set)

    @property
    def period_s(self) -> float:
        """The loop's period, s; nan if no file says it."""
        loop_s = None if self.result.loop is None else self.result.loop.period_s
        periods_s = (known(value) for value in (self.meta.period_s, loop_s, self.config.period_s))
        return next((value for value in periods_s if math.isfinite(value)), math.nan)

    @property
    def in_virtual_time(self) -> bool:
        """Whether the loop ran on a simulated clock: then its timing means nothing."""
        if self.meta.time is not None:
            return self.meta.time.kind == "virtual"
        return self.backend.startswith("simulated")  # before there was `time`

    @property
    def estimates(self) -> dict[str, EstimateResult]:
        """Estimates by method, the preferred first."""
        found = self.result.estimates
        order = [m for m in PREFERRED if m in found] + [m for m in found if m not in PREFERRED]
        return {m: found[m] for m in order}

    @property
    def compared(self) -> dict[str, EstimateResult]:
        """The estimates by method, and ``answer`` before them where its numbers are not those of its method."""
        answer = self.result.answer
        plain = None if answer is None else self.estimates.get(answer.method)
        if answer is None or (plain is not None and (answer.tau_s, answer.fc_V) == (plain.tau_s, plain.fc_V)):
            return self.estimates
        return {"answer": answer} | self.estimates

    def method_of(self, name: str) -> str:
        """The method behind a name of ``compared``."""
        return self.result.answer.method if name == "answer" and self.result.answer is not None else name

    @property
    def laws(self) -> tuple[FoundLawResult, ...]:
        """What the answer has beyond tau, K and friction."""
        return (None if self.result.answer is None else self.result.answer.law) or ()

    @property
    def faults(self) -> list[FaultReport]:
        """Faults with code, cause, cure and detail, from the result and the events, each once."""
        unique: dict[tuple[str, str], FaultReport] = {}
        for fault in (*self.result.faults, *self.events_of("fault", FaultReport)):
            entry = FAULTS.get(fault.code)
            before = unique.get((fault.code, fault.detail))
            unique[fault.code, fault.detail] = FaultReport(
                code=fault.code,
                cause=fault.cause or (entry.cause if entry else "not recorded"),
                cure=fault.cure
                or (entry.cure_with() if entry else "search for this code in docs/, or ask and send this report"),
                detail=fault.detail,
                t_s=before.t_s if fault.t_s is None and before is not None else fault.t_s,
            )
        return list(unique.values())

    def events_of(self, kind: str, part: type[_P]) -> list[_P]:
        """The events of one kind, without what is wrong in them."""
        return [salvaged(part, {"t_s": e.t_s, **e.detail})[0] for e in self.events if e.kind == kind]

    @property
    def rows(self) -> Recording:
        """The recorded rows. Raises AbsentError without any."""
        if self.recording is None:
            raise AbsentError("There are no samples to draw (see the notes at the top).")
        return self.recording

    @property
    def has_tracked(self) -> bool:
        """Whether a model has driven the bench along the trajectory."""
        return any(tracked.rms_rad is not None for tracked in self.result.tracking.values())

    def spans(self, kind: str = "") -> list[Span]:
        """Contiguous visits to named stages, in order; ``kind``: only of that kind (``relay`` for ``relay-1``)."""
        if self.recording is None:
            return []
        stage = self.recording.stage
        starts = [0, *(np.flatnonzero(stage[1:] != stage[:-1]) + 1).tolist(), len(stage)]
        spans = [Span(str(stage[a]), a, b - 1) for a, b in pairwise(starts)]
        return [s for s in spans if s.stage and kind in ("", stage_kind(s.stage))]

    def spans_of(self, kind: str, absent: str) -> list[Span]:
        """``spans`` of a kind. Raises AbsentError, with the sentence ``absent``, if there are none."""
        spans = self.spans(kind)
        if not spans:
            raise AbsentError(absent)
        return spans


def load(folder: Path, known: Recording | None = None) -> ReportedRun:
    """Read a run folder.

    known  the rows that were read before, so that they are not parsed again
    Raises FileNotFoundError if ``folder`` is no folder. All else that is missing goes into ``ReportedRun.missing``.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is not a run folder; give the path that `rig run` printed")
    missing: list[str] = []

    def part(name: str, read: Callable[[], _T], otherwise: str) -> _T | None:
        """What a file says; None, and a sentence in ``missing``, where it cannot be read."""
        try:
            found = read()
        except RecordingError as error:
            missing.append(f"{words_of(error)}: {otherwise}.")
            return None
        if not os.path.lexists(folder / name):
            missing.append(f"{name} is missing: {otherwise}.")
        return found

    of_meta = part(META, lambda: read_meta(folder), "backend, versions and host of this run are unknown")
    of_result = part(RESULT, lambda: read_result(folder), "the run ended before it had a result")
    (meta, meta_notes), (result, result_notes) = of_meta or (None, []), of_result or (None, [])
    broken: list[RecordingError] = []
    unknown = "events and faults come from the result only"
    events, event_notes = part(EVENTS, lambda: read_events(folder, broken=broken), unknown) or ((), [])
    missing.extend(f"{note}." for note in event_notes)
    if broken:
        count = "1 line is" if len(broken) == 1 else f"{len(broken)} lines are"
        missing.append(f"{EVENTS}: {count} broken; rig leaves them out. The first: {words_of(broken[0])}.")
    text = part(CONFIG, lambda: read_config_text(folder), "limits and settings are unknown")
    config = Settings() if text is None else _settings(text, missing)
    recording = part(
        SAMPLES,
        lambda: read_csv(folder / SAMPLES, own=True, known=known) if os.path.lexists(folder / SAMPLES) else None,
        "nothing that was measured can be shown",
    )
    notes = [f"{note}." for note in (*meta_notes, *result_notes)]
    if recording is not None:  # the estimators read the clock's period and the events, too
        notes.extend(f"{SAMPLES}: {note}." for note in recording.notes)
        recording = replace(recording, source=folder, meta=meta or RunMeta(), events=events)
    if any(event.kind == "loop_died" for event in events):
        notes.append("The process that ran the loop was killed. The recording is complete to its last tick.")
    return ReportedRun(folder, recording, meta or RunMeta(), result or RunResult(), config, events, missing, notes)


def words_of(error: RecordingError) -> str:
    """What is wrong with a file of the folder: its name, the line, the cause."""
    return f"{error.path.name}{'' if error.line is None else f' (line {error.line})'} {error.cause}"


def _settings(text: str, missing: list[str]) -> Settings:
    """What the report shows of a config, whichever version wrote it."""
    try:
        value = parse(text, CONFIG).data
    except ConfigError as error:
        missing.append(f"{error}: limits and settings are unknown.")
        return Settings(text=text)

    def at(*keys: str) -> Any:
        found: Any = value
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        return found

    return Settings(
        period_s=_number(at("period_s")),
        soft_rad=_pair(at("limits", "soft_rad")),
        hard_rad=_pair(at("limits", "hard_rad")),
        wanted_amplitude_rad=_number(at("relay", "target", "amplitude_rad")),
        wanted_period_s=_number(at("relay", "target", "period_s")),
        tolerance=_number(at("relay", "target", "tolerance")),
        second_ratio=_number(at("relay", "second_ratio")),
        tracks=bool(at("tracking")),
        decay=_decay(at("tracking")),
        is_there=bool(value),
        text=text,
    )


def _number(value: Any) -> float | None:
    """A number of a config; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) < LARGEST else None


def _decay(tracking: Any) -> tuple[float, float, float] | None:
    """Offset, k1 and k2 of a config's tracking section, where it has an offset."""
    given = tracking if isinstance(tracking, dict) else {}
    offset_rad = _number(given.get("offset_rad"))
    k1, k2 = _number(given.get("k1_1_s", K1_1_S)), _number(given.get("k2_1_s2", K2_1_S2))
    return (offset_rad, k1, k2) if offset_rad and k1 and k1 > 0.0 and k2 and k2 > 0.0 else None


def _pair(value: Any) -> tuple[float, float] | None:
    low, high = map(_number, value) if isinstance(value, list) and len(value) == 2 else (None, None)
    return None if low is None or high is None else (low, high)
