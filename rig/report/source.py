"""What the report is made from: a run folder, with every part that is missing or unreadable said in words."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from rig.faults import FAULTS
from rig.recording.reader import Recording, RecordingError, printable, read_csv, whole_content
from rig.report.style import AbsentError, stage_kind

Array = NDArray[np.float64]
Json = dict[str, Any]

PREFERRED = ("sampled-data", "triple-relay", "describing-function", "least-squares")


class Span(NamedTuple):
    """Rows ``first`` to ``last`` (both included) of one visit to ``stage``."""

    stage: str
    first: int
    last: int


@dataclass(frozen=True)
class Run:
    """A run folder as far as it could be read.

    recording  the rows of samples.csv; None where it is missing or unusable
    missing    one sentence for each part that is missing or unreadable
    notes      what was tolerated, such as a torn last line
    """

    folder: Path
    recording: Recording | None
    meta: Json
    result: Json
    config: Json
    config_text: str
    events: list[Json]
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The run's name: its folder's."""
        return self.folder.resolve().name

    @property
    def backend(self) -> str:
        """The backend in words, as recorded."""
        return str(self.meta.get("backend") or self.result.get("backend") or "not recorded (meta.json is missing)")

    @property
    def truth(self) -> dict[str, float]:
        """True parameters where the backend is emulated, else empty."""
        return numbers(self.meta.get("truth") or self.result.get("truth"))

    @property
    def period_s(self) -> float:
        """The loop's period, s; nan where it is not recorded."""
        for source in (self.meta, section(self.result, "loop"), self.config):
            value = number(source.get("period_s"))
            if math.isfinite(value):
                return value
        return math.nan

    @property
    def in_virtual_time(self) -> bool:
        """Whether the loop ran on a simulated clock, where its timing means nothing."""
        return self.backend.startswith("simulated")

    @property
    def estimates(self) -> dict[str, Json]:
        """Estimates by method, the preferred first."""
        found = {k: v for k, v in section(self.result, "estimates").items() if isinstance(v, dict)}
        order = [m for m in PREFERRED if m in found] + [m for m in found if m not in PREFERRED]
        return {m: found[m] for m in order}

    @property
    def faults(self) -> list[Json]:
        """Faults with code, cause, cure and detail, from the result and the events, each once."""
        recorded = self.result.get("faults")
        candidates = list(recorded) if isinstance(recorded, list) else []
        candidates += [e for e in self.events if e.get("kind") == "fault"]
        unique: dict[tuple[str, str], Json] = {}
        for entry in candidates:
            fault = entry if isinstance(entry, dict) else {"code": str(entry)}
            code, detail = str(fault.get("code", "unknown")), str(fault.get("detail") or "")
            known = FAULTS.get(code)
            old = unique.get((code, detail), {})
            unique[code, detail] = {
                "code": code,
                "cause": fault.get("cause") or (known.cause if known else "not recorded"),
                "cure": fault.get("cure")
                or (known.cure if known else "look the code up in docs, or ask with this report"),
                "detail": detail,
                "t_s": fault.get("t_s", old.get("t_s")),
            }
        return list(unique.values())

    @property
    def rows(self) -> Recording:
        """The recorded rows. Raises AbsentError without any."""
        if self.recording is None:
            raise AbsentError("There are no samples to draw (see the notes at the top).")
        return self.recording

    def spans(self, kind: str = "") -> list[Span]:
        """Contiguous visits to named stages, in order; only of one kind (``relay`` for ``relay-1``) where given."""
        if self.recording is None:
            return []
        stage = self.recording.stage
        starts = [0, *(np.flatnonzero(stage[1:] != stage[:-1]) + 1).tolist(), len(stage)]
        spans = [Span(str(stage[a]), a, b - 1) for a, b in pairwise(starts)]
        return [s for s in spans if s.stage and kind in ("", stage_kind(s.stage))]

    def limits(self, which: str) -> tuple[float, float] | None:
        """Travel limits ``soft_rad`` or ``hard_rad`` of the configuration, rad; None where they are not known."""
        return pair(section(self.config, "limits").get(which))


def section(of: Json, key: str) -> Json:
    """``of[key]`` where it is a mapping, else an empty one."""
    value = of.get(key)
    return value if isinstance(value, dict) else {}


LARGEST = 1e100  # nothing measured is larger, and no axis is drawn to numbers whose square overflows


def number(value: Any) -> float:
    """``value`` as a float; nan where it is no number, or one that cannot have been measured."""
    if value is None or isinstance(value, bool):
        return math.nan
    try:
        measured = float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return measured if abs(measured) < LARGEST else math.nan


def numbers(of: Any) -> dict[str, float]:
    """The finite numbers of a mapping."""
    items = of.items() if isinstance(of, dict) else ()
    return {k: number(v) for k, v in items if math.isfinite(number(v))}


def mappings(value: Any) -> list[Json]:
    """The mappings in a list; none where ``value`` is no list."""
    return [v for v in value if isinstance(v, dict)] if isinstance(value, list) else []


def texts(value: Any) -> tuple[str, ...]:
    """The items of a list as texts; none where ``value`` is no list."""
    return tuple(str(v) for v in value) if isinstance(value, list) else ()


def pair(value: Any) -> tuple[float, float] | None:
    """Two finite numbers of a list; None where it is anything else."""
    if not isinstance(value, list) or len(value) != 2:
        return None
    low, high = number(value[0]), number(value[1])
    return (low, high) if math.isfinite(low) and math.isfinite(high) else None


def interval(estimate: Json, key: str) -> tuple[float, float] | None:
    """The 95 % interval of one parameter of an estimate; None where it has none."""
    return pair(section(estimate, "ci95").get(key))


def load(folder: Path, known: Recording | None = None) -> Run:
    """Read a run folder; ``known``: its rows as far as they were read before.

    Raises FileNotFoundError if ``folder`` is no folder; every other want is put into ``Run.missing``.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is not a run folder; give the path that `rig run` printed")
    missing: list[str] = []
    meta = _json(folder / "meta.json", "the backend, versions and host of this run are not known", missing)
    result = _json(folder / "result.json", "the run ended before it had a result", missing)
    events = _events(folder / "events.jsonl", missing)
    config, config_text = _config(folder / "config.yaml", missing)
    notes: list[str] = []
    try:
        recording = read_csv(folder / "samples.csv", known=known) if (folder / "samples.csv").is_file() else None
        if recording is None:
            missing.append("samples.csv is missing: nothing that was measured can be shown.")
        else:
            notes.extend(f"samples.csv: {note}." for note in recording.notes)
    except RecordingError as error:
        recording = None
        missing.append(f"samples.csv {error.cause}{_line(error)}: nothing that was measured can be shown.")
    if any(event.get("kind") == "loop_died" for event in events):
        notes.append("The process that ran the loop was killed; the record is complete to its last tick.")
    if recording is not None:  # estimators compare the clock with the period in meta
        recording = replace(recording, source=folder, meta=meta)
    return Run(folder, recording, meta, result, config, config_text, events, missing, notes)


def _line(error: RecordingError) -> str:
    return "" if error.line is None else f" (line {error.line})"


def _json(path: Path, consequence: str, missing: list[str]) -> Json:
    if not path.is_file():
        missing.append(f"{path.name} is missing: {consequence}.")
        return {}
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        missing.append(f"{path.name} cannot be read ({error}): {consequence}.")
        return {}
    if not isinstance(value, dict):
        missing.append(f"{path.name} does not hold an object: {consequence}.")
        return {}
    return {str(key): printable(item) for key, item in value.items()}


def _events(path: Path, missing: list[str]) -> list[Json]:
    """The events; a torn or broken line is left out and said."""
    if not path.is_file():
        missing.append(f"{path.name} is missing: events and faults are known from the result only.")
        return []
    events: list[Json] = []
    broken = 0
    for text in whole_content(path)[0].decode("utf-8", errors="replace").splitlines():
        try:
            value = json.loads(text) if text.strip() else None
        except json.JSONDecodeError:
            broken += 1
            continue
        if isinstance(value, dict):
            events.append({str(key): printable(item) for key, item in value.items()})
    if broken:
        missing.append(f"{path.name}: {broken} line(s) are torn or broken and were left out.")
    return events


def _config(path: Path, missing: list[str]) -> tuple[Json, str]:
    if not path.is_file():
        missing.append(f"{path.name} is missing: limits and settings are not known.")
        return {}, ""
    text = path.read_text(encoding="utf-8", errors="replace")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        missing.append(f"{path.name} is no valid YAML: limits and settings are not known.")
        return {}, text
    return (value if isinstance(value, dict) else {}), text
