"""The runs of a folder: a line each, from their meta.json and result.json; which of them, and in which order.

The index beside them has a line of JSON for each run, with size and time of the files that it was made from. A line
counts only while these are the folder's: a lost, damaged or older index is made anew; nobody has to delete it.
"""

from __future__ import annotations

import json
import math
import operator
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import Field

from rig.core import strict_json
from rig.core.errors import CauseError
from rig.core.package import VERSION
from rig.core.plain_file import read_plain
from rig.run_folder.recording.errors import CannotWriteError, RecordingError
from rig.run_folder.recording.folder import META, RESULT, write_whole
from rig.run_folder.recording.path_kind import CAMPAIGN_ROWS, is_run, no_run
from rig.run_folder.recording.reader import read_meta, read_result
from rig.run_folder.recording.text_file import is_folder
from rig.run_folder.results import RunMeta, RunResult, known
from rig.run_folder.results.part import Flag, Number, Part, Sometimes, Text, key
from rig.run_folder.results.salvage import DamagedError, parsed


class ListedRun(Part):
    """A run in one line. A number is null if the run does not know it."""

    name: Text = Field(description="the run's folder")
    started_utc: Text | None = key("when it started: ISO 8601, UTC")
    command: Text | None = key("what ran: run, relay, survey, track, jog, law, breakaway")
    config: Text | None = key("the config's name")
    backend: Text | None = key("the bench in words")
    emulated: Flag = key("whether nothing real moved", False)
    rehearsal: Sometimes[Flag] = key("true: `rig rehearse` ran it; nothing was measured")
    state: Text = Field(description="done, fault, no result (it was killed, or runs still) or damaged")
    fault: Text | None = key("code of the fault that ended it")
    problem: Text | None = key("what is wrong with its files")
    method: Text | None = key("method of the answer")
    verdict: Text | None = key("of the answer: ok, doubtful or refused")
    tau_s: Number = key("time constant, s")
    K_rad_s_V: Number = key("gain, (rad/s)/V")
    fc_V: Number = key("friction, V")
    tau_percent: Number = key("half width of its 95 % interval, %")
    K_percent: Number = key("half width of its 95 % interval, %")
    fc_percent: Number = key("half width of its 95 % interval, %")
    laws: Text = key("laws that it shows, with commas between", "")
    tracking_rms_rad: Number = key("RMS error of tracking with the leading model, rad")
    duration_s: Number = key("how long its loop ran, s")


DONE, FAULT, NO_RESULT, DAMAGED = "done", "fault", "no result", "damaged"


def read_entry(folder: Path) -> ListedRun:
    """The line of a run folder. What is wrong with its files is its ``problem``."""
    try:
        meta, meta_notes = read_meta(folder)
        result, notes = read_result(folder)
    except (RecordingError, OSError) as error:
        return ListedRun(name=folder.name, state=DAMAGED, problem=str(error))
    problem = "; ".join([*meta_notes, *notes, *([] if meta is not None else ["meta.json is missing"])])
    return of_files(folder.name, meta or RunMeta(), result, problem)


def of_files(name: str, meta: RunMeta, result: RunResult | None, problem: str = "") -> ListedRun:
    """The line of a run from its two files; ``result``: None of a run without one."""
    about = ListedRun(
        name=name,
        started_utc=meta.started_utc,
        command=None if meta.script is None else meta.script.name,
        config=meta.name or None,
        backend=meta.backend or None,
        emulated=meta.emulated,
        rehearsal=meta.rehearsal,
        state=NO_RESULT if result is None else FAULT if result.faults else DONE,
        fault=result.faults[0].code if result is not None and result.faults else None,
        problem=problem or None,
    )
    return about if result is None else about.model_copy(update=_found(result))


def _found(result: RunResult) -> dict[str, object]:
    answer = result.answer
    tracked = None if answer is None else result.tracking.get(answer.method)
    loop = result.loop
    found: dict[str, object] = {
        "laws": ", ".join(law.name for law in (answer.law if answer else None) or ()),
        "tracking_rms_rad": None if tracked is None else tracked.rms_rad,
        "duration_s": None
        if loop is None or loop.ticks is None or loop.period_s is None
        else round(loop.ticks * loop.period_s, 6),
    }
    if answer is None:
        return found
    found |= {"method": answer.method, "verdict": answer.verdict}
    if answer.is_refused:
        return found  # a refusal gives no number
    for name, percent in (("tau_s", "tau_percent"), ("K_rad_s_V", "K_percent"), ("fc_V", "fc_percent")):
        value, interval = known(answer.value(name)), answer.at_95(name)
        found[name] = value if math.isfinite(value) else None
        if interval is not None and value > 0.0:
            found[percent] = 50.0 * (interval[1] - interval[0]) / value
    return found


FIELDS: Final = tuple(ListedRun.model_fields)
_COMPARED: Final[dict[str, Callable[[float, float], bool]]] = {
    "<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt,
}  # fmt: skip
_WHERE: Final = re.compile(r"\s*(\w+)\s*(!=|<=|>=|=|<|>|~)\s*(.*?)\s*")


class QueryError(CauseError):
    """A filter or an order that cannot be."""


@dataclass(frozen=True)
class Condition:
    """``field operator value``, such as ``fc_V > 0.5``, ``verdict = ok`` or ``name ~ demo``.

    = and != compare numbers as numbers, and texts without regard to case; = with nothing finds what is not known; ~
    looks for a part of the text. A number that is not known is neither less nor more.
    """

    field: str
    operator: str
    value: str

    @classmethod
    def of(cls, text: str) -> Condition:
        """From its text. Raises QueryError."""
        match = _WHERE.fullmatch(text)
        if match is None:
            raise QueryError(
                f"{text!r} is no condition", "write FIELD, one of = != < <= > >= ~, and a value, such as fc_V>0.5"
            )
        found = cls(*match.groups())
        require_field(found.field)
        if found.operator in _COMPARED and _number(found.value) is None:
            raise QueryError(f"{text!r}: {found.value!r} is no number", f"{found.operator} compares numbers")
        return found

    def holds(self, run: ListedRun) -> bool:
        """Whether a run meets it."""
        value = getattr(run, self.field)
        if self.operator in _COMPARED:
            wanted = _number(self.value)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            return is_number and wanted is not None and _COMPARED[self.operator](value, wanted)
        text = "" if value is None else str(value).lower()
        if self.operator == "~":
            return self.value.lower() in text
        numbers = _number(text), _number(self.value)
        same = text == self.value.lower() or (None not in numbers and numbers[0] == numbers[1])
        return same == (self.operator == "=")


def selected(runs: Sequence[ListedRun], where: Sequence[str] = (), sort: Sequence[str] = ()) -> list[ListedRun]:
    """The runs that meet all conditions, in order.

    sort   fields, the first counts most; ``-`` before one turns its order round. What is not known comes last
    Raises QueryError.
    """
    conditions = [Condition.of(text) for text in where]
    for name in sort:
        require_field(name.removeprefix("-"))
    found = [run for run in runs if all(condition.holds(run) for condition in conditions)]
    for name in reversed(sort):
        field = name.removeprefix("-")
        there = [run for run in found if getattr(run, field) is not None]
        there.sort(key=operator.attrgetter(field), reverse=name.startswith("-"))
        found = there + [run for run in found if getattr(run, field) is None]
    return found


def require_field(name: str) -> None:
    """Raise QueryError if runs have no such field."""
    if name not in FIELDS:
        raise QueryError(f"runs have no field {name!r}", f"they have {', '.join(FIELDS)}")


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


INDEX = ".rig-index.jsonl"
FORM = 2  # of the index
_MOST_BYTES = 64 * 2**20  # a hundred thousand runs
FROM = (META, RESULT)  # files that a line is made from

Stamp = tuple[tuple[int, int], ...]
"""Size in bytes, and time of the last change in ns, of each file of ``FROM``; (-1, -1): it is not there."""


@dataclass(frozen=True)
class Catalogue:
    """The runs of a folder.

    runs     by name, which is by their start
    read     how many of them had to be read; the others were in the index
    notes    why the index was not written, and which folders could not be looked into
    """

    runs: tuple[ListedRun, ...]
    read: int
    notes: tuple[str, ...] = ()


def catalogue(folder: Path) -> Catalogue:
    """The runs in a folder, not in those below. Writes the index if it has changed.

    Raises RecordingError if it is no folder of runs (`no_run`), or is not there.
    """
    if not os.path.lexists(folder):
        cure = "it comes with the first `rig run CONFIG`; for another one type `rig list FOLDER`"
        raise RecordingError(folder, "is not there", cure)
    if not is_folder(folder):
        raise no_run(folder)
    if is_run(folder):
        raise RecordingError(folder, "is a run itself", f"list the folder that holds it: `rig list {folder.parent}`")
    notes: list[str] = []
    try:
        stamps = dict(sorted(_stamps(folder, notes)))
    except OSError as error:
        raise RecordingError(folder, f"cannot be read: {error.strerror}", "check its permissions") from error
    known = _read(folder / INDEX)
    lines = {name: known[name][1] for name, stamp in stamps.items() if name in known and known[name][0] == stamp}
    missing = [name for name in stamps if name not in lines]
    lines |= {name: read_entry(folder / name) for name in missing}
    if missing or set(known) != set(stamps):
        try:
            _write(folder / INDEX, stamps, lines)
        except CannotWriteError as error:
            notes.append(f"no index: {error.path} {error.cause}; so the next `rig list` reads all runs again")
    return Catalogue(tuple(lines[name] for name in stamps), len(missing), tuple(notes))


def _stamps(folder: Path, notes: list[str]) -> Iterator[tuple[str, Stamp]]:
    """The runs with their stamps; ``notes`` take the folders that cannot be looked into."""
    for child in folder.iterdir():
        try:
            if child.is_dir() and is_run(child) and not (child / CAMPAIGN_ROWS).exists():
                yield child.name, tuple(_stamp(child / name) for name in FROM)
        except OSError as error:
            notes.append(f"left out: {child} cannot be looked into: {error.strerror}")


def _stamp(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:
        return -1, -1
    return found.st_size, found.st_mtime_ns


def _read(path: Path) -> dict[str, tuple[Stamp, ListedRun]]:
    """The lines of the index by run; empty if it is lost, damaged or of another form."""
    try:
        head, *lines = read_plain(path, _MOST_BYTES).decode("utf-8").splitlines()
        if strict_json.parse(head) != _head():
            return {}
        return dict(_line(strict_json.parse(line)) for line in lines)
    except (OSError, ValueError, KeyError, TypeError, DamagedError):
        return {}  # it is made anew from the folder


def _line(entry: Any) -> tuple[str, tuple[Stamp, ListedRun]]:
    run = parsed(ListedRun, entry["run"])
    return run.name, (tuple((int(size), int(ns)) for size, ns in entry["stamp"]), run)


def _write(path: Path, stamps: dict[str, Stamp], lines: dict[str, ListedRun]) -> None:
    entries = [_head(), *({"stamp": stamps[name], "run": lines[name].as_json()} for name in stamps)]
    write_whole(path, "".join(json.dumps(entry) + "\n" for entry in entries))


def _head() -> dict[str, object]:
    return {"rig_index": FORM, "rig": VERSION}
