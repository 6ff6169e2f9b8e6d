"""Reads a recording: a run folder, or any CSV file with at least the columns t_s, u_V and y_rad.

``csv_file`` reads the rows. This file reads what stands beside them in a run folder, and nothing else does: a plain
file, no link, of a bounded size, in strict JSON (``strict_json``) of bounded depth.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import JsonValue

from rig.core import strict_json
from rig.core.signals import plain
from rig.core.strict_json import JsonError
from rig.run_folder.recording.bam_log import read_bam_log
from rig.run_folder.recording.csv_file import read_csv, read_csv_runs
from rig.run_folder.recording.errors import IdentifyError, RecordingError
from rig.run_folder.recording.folder import CONFIG, META, RESULT
from rig.run_folder.recording.log_file import read_log
from rig.run_folder.recording.log_format import LogFormat
from rig.run_folder.recording.path_kind import no_recording, no_run
from rig.run_folder.recording.recording import MIN_ROWS, Recording, from_columns
from rig.run_folder.recording.text_file import content_of, is_folder, line_of, text_of, whole_content, without_torn_line
from rig.run_folder.recording.writer import EVENTS, SAMPLES
from rig.run_folder.results import JsonObject, Part, RunEvent, RunMeta, RunResult
from rig.run_folder.results.salvage import remarks, salvaged

_MOST_EVENTS: Final = 100_000  # a run has some hundreds; each becomes an object
MOST_BYTES: Final = 20_000_000  # of a file beside the rows; ours have some thousands

_P = TypeVar("_P", bound=Part)
_File = TypeVar("_File", RunMeta, RunResult)


def read(path: Path, log: LogFormat | None = None) -> Recording:
    """Read a run folder or a CSV file of one run, whichever ``path`` is. Raises RecordingError.

    log  as in ``read_all``
    """
    recordings = read_all(path, log)
    if len(recordings) > 1:
        raise RecordingError(
            path, f"holds {len(recordings)} runs, one after the other", "`rig identify` reads them all; or cut the file"
        )
    return recordings[0]


def read_all(path: Path, log: LogFormat | None = None) -> list[Recording]:
    """Read a run folder, a log of BAM's, or each run in a CSV file, whichever ``path`` is.

    A time that begins again begins another run.

    log  what the columns of the CSV file are; None: they are those of samples.csv
    Raises RecordingError.
    """
    of_bam = read_bam_log(path, log)
    if of_bam is not None:
        return [of_bam]
    mistaken = no_recording(path)
    if mistaken is not None:
        raise mistaken
    if is_folder(path):
        if log is not None:
            raise RecordingError(
                path, "is a run folder: its columns have names and units", "leave the options of a log out"
            )
        return [read_run(path)]
    return read_csv_runs(path) if log is None else read_log(path, log)


def read_run(folder: Path, known: Recording | None = None, *, strict: bool = False) -> Recording:
    """Read a run folder. ``notes`` say what a killed run did not write, and which wrong values are left out.

    known   this run as read earlier: its rows are not parsed again
    strict  whether a wrong value in meta.json or events.jsonl is an error

    Raises RecordingError if this is not a run (see `no_run`), if samples.csv is unusable, or if another file of the
    folder is broken.
    """
    if not is_folder(folder) or not (folder / SAMPLES).exists():
        raise no_run(folder)
    recording = read_csv(folder / SAMPLES, own=True, known=known)
    meta, meta_notes = _read_part(folder / META, RunMeta, strict=strict, may_end=not strict)
    config_text = read_config_text(folder)
    events, event_notes = read_events(folder, strict=strict)
    notes = (*recording.notes, *([f"{META} is missing"] if meta is None else meta_notes), *event_notes)
    most_V = math.inf if meta is None or meta.drive is None else meta.drive.full_V
    return replace(
        recording, source=folder, meta=meta or RunMeta(), config_text=config_text, events=events, notes=notes,
        most_V=most_V,
    )  # fmt: skip


def read_result(folder: Path) -> tuple[RunResult | None, list[str]]:
    """The content of a run folder's result.json, without wrong values; and notes on it. None without that file.

    Raises RecordingError if the file is no JSON object.
    """
    return _read_part(folder / RESULT, RunResult, strict=False)


def read_meta(folder: Path) -> tuple[RunMeta | None, list[str]]:
    """The content of a run folder's meta.json, without wrong values; and notes on it. None without that file.

    Raises RecordingError if the file is no JSON object.
    """
    return _read_part(folder / META, RunMeta, strict=False)


def read_config_text(folder: Path) -> str | None:
    """The text of a run folder's config.yaml; None without that file. Raises RecordingError."""
    path = folder / CONFIG
    return text_of(path, content_of(path, MOST_BYTES, own=True)) if is_there(path) else None


def read_events(
    folder: Path, *, strict: bool = False, broken: list[RecordingError] | None = None
) -> tuple[tuple[RunEvent, ...], list[str]]:
    """The events of a run folder, none without events.jsonl; and notes on the file.

    strict  whether a wrong value is an error
    broken  takes the errors of lines that are no event, and the others are read; None: such a line is an error
    Raises RecordingError.
    """
    path = folder / EVENTS
    content, notes = whole_content(path, own=True) if is_there(path) else (b"", [])
    if not content:
        return (), []
    whole, torn = without_torn_line(path, content)
    events: list[RunEvent] = []
    wrong: list[str] = []
    if whole.count(b"\n") > _MOST_EVENTS:
        raise RecordingError(path, f"has more than {_MOST_EVENTS} lines", "cut it, or delete it")
    for number, line in enumerate(whole.split(b"\n"), 1):
        if not line.strip():
            continue
        try:
            value = _parse_object(path, line_of(path, line, number), number)
            event, left_out = _salvaged(path, RunEvent, value, number, strict=strict)
        except RecordingError as error:
            if broken is None:
                raise
            broken.append(error)
            continue
        events.append(event)
        wrong += [f"line {number}: {words}" for words in left_out]
    if wrong:
        others = "" if len(wrong) == 1 else f", and {len(wrong) - 1} more"
        torn.append(f"{wrong[0]}; rig leaves it out{others}")
    return tuple(events), [f"{EVENTS}: {note}" for note in [*notes, *torn]]


def read_object(path: Path) -> JsonObject:
    """The object in a JSON file of a run folder, its texts safe for a terminal. Raises RecordingError."""
    return _parse_object(path, text_of(path, content_of(path, MOST_BYTES, own=True)), None)


def is_there(path: Path) -> bool:
    """Whether anything has this name: also a link that leads nowhere."""
    return os.path.lexists(path)


def _read_part(path: Path, kind: type[_File], *, strict: bool, may_end: bool = False) -> tuple[_File | None, list[str]]:
    """The content of a JSON file, None without the file; and notes on it. ``may_end``: it may end early."""
    if not is_there(path):
        return None, []
    try:
        value, ends_early = read_object(path), []
    except RecordingError:
        begun = _begun_object(path) if may_end else None
        if begun is None:
            raise
        value, ends_early = begun, ["ends early; rig reads what is there"]
    part, left_out = _salvaged(path, kind, value, None, strict=strict)
    notes = ends_early + [f"{words}; rig leaves it out" for words in left_out] + remarks(part)
    return part, [f"{path.name}: {note}" for note in notes]


def _salvaged(path: Path, kind: type[_P], value: JsonObject, line: int | None, *, strict: bool) -> tuple[_P, list[str]]:
    """A JSON object as a part, and a sentence on each wrong value, which is left out. ``strict``: it is an error."""
    part, left_out = salvaged(kind, value)
    if strict and left_out:
        raise RecordingError(path, left_out[0], "correct it, or take that key out of the file", line)
    return part, left_out


def _begun_object(path: Path) -> JsonObject | None:
    """The whole keys of an object whose file ends early; None where that is not what is wrong with it."""
    text = text_of(path, content_of(path, MOST_BYTES, own=True)).rstrip()
    while text.count("{") > text.count("}"):
        text = text.rpartition(",\n")[0]
        with contextlib.suppress(RecordingError):
            return _parse_object(path, text + "}", None)
    return None


def _parse_object(path: Path, text: str, line: int | None) -> JsonObject:
    try:
        value = strict_json.parse(text)
    except JsonError as error:
        raise RecordingError(
            path, f"is broken JSON ({error})", "delete or correct it", error.line if line is None else line
        ) from error
    if not isinstance(value, dict):
        raise RecordingError(path, "is no JSON object", "delete or correct it", line)
    return {plain(key): _printable(item) for key, item in value.items()}


def _printable(value: JsonValue) -> JsonValue:
    """A JSON value with its texts made safe for a terminal. A traceback keeps its lines."""
    if isinstance(value, str):
        return "\n".join(plain(line) for line in value.split("\n"))
    if isinstance(value, dict):
        return {plain(key): _printable(item) for key, item in value.items()}
    return [_printable(item) for item in value] if isinstance(value, list) else value


ARRAYS = Path("t, u, y")  # what messages call columns that are in no file


def recordings_of(
    data: Any, u: ArrayLike | None, y: ArrayLike | None, t_u: ArrayLike | None, wanted: str
) -> list[Recording]:
    """The recordings in ``data``: a run, a path, or several in a list; or, with ``u`` and ``y``, the times of samples.

    wanted  one sentence: what the caller takes
    Raises IdentifyError for columns that are none, RecordingError for what cannot be read, TypeError for the rest.
    """
    if u is not None and y is not None:
        return [_from_arrays(data, u, y, t_u)]
    given = [data] if isinstance(data, Recording | str | PathLike) else data
    if u is not None or y is not None or t_u is not None or not isinstance(given, Sequence):
        raise TypeError(wanted)
    return [recording for one in given for recording in ([one] if isinstance(one, Recording) else read_all(Path(one)))]


def _from_arrays(t: ArrayLike, u: ArrayLike, y: ArrayLike, t_u: ArrayLike | None) -> Recording:
    """Columns as a recording. Raises IdentifyError where they are no columns of one length and of numbers."""
    given = {"t": t, "u": u, "y": y} | ({} if t_u is None else {"t_u": t_u})
    columns = {name: np.asarray(values, dtype=np.float64) for name, values in given.items()}
    for name, column in columns.items():
        if column.ndim != 1 or column.size != columns["t"].size:
            raise IdentifyError(
                f"{name} has the shape {column.shape}, and t {columns['t'].shape}", "give columns of one length"
            )
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise IdentifyError(f"{name}[{bad[0]}] is {column[bad[0]]}", "leave such samples out, in every column")
    if columns["t"].size < MIN_ROWS:
        raise IdentifyError(f"there are {columns['t'].size} samples", "record ten cycles: some hundred samples")
    return from_columns(ARRAYS, columns["t"], columns["u"], columns["y"], columns.get("t_u"))
