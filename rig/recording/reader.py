"""Reads a recording: a run folder, or any CSV file with at least the columns t_s, u_V and y_rad.

``csv_file`` reads the rows. This file reads what stands beside them in a run folder.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from pydantic import JsonValue

from rig.recording.csv_file import read_csv
from rig.recording.errors import RecordingError
from rig.recording.folder import CONFIG, META, RESULT
from rig.recording.log_file import read_log
from rig.recording.log_format import LogFormat
from rig.recording.path_kind import no_recording, no_run
from rig.recording.recording import Recording
from rig.recording.text_file import content_of, is_folder, text_of, whole_content, without_torn_line
from rig.recording.writer import EVENTS, SAMPLES
from rig.results import JsonObject, Part, RunEvent, RunMeta, RunResult
from rig.results.reading import remarks, salvaged
from rig.signals import plain

_P = TypeVar("_P", bound=Part)
_File = TypeVar("_File", RunMeta, RunResult)


def read(path: Path, log: LogFormat | None = None) -> Recording:
    """Read a run folder or a CSV file, whichever ``path`` is.

    log  what the columns of the CSV file are; None: they are those of samples.csv
    Raises RecordingError.
    """
    mistaken = no_recording(path)
    if mistaken is not None:
        raise mistaken
    if is_folder(path):
        if log is not None:
            raise RecordingError(
                path, "is a run folder: its columns have names and units", "leave the options of a log out"
            )
        return read_run(path)
    return read_csv(path) if log is None else read_log(path, log)


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
    meta, meta_notes = _read_part(folder / META, RunMeta, strict=strict)
    config = folder / CONFIG
    config_text = text_of(config, content_of(config)) if config.exists() else None
    events, event_notes = _read_events(folder / EVENTS, strict=strict)
    notes = (*recording.notes, *([f"{META} is missing"] if meta is None else meta_notes), *event_notes)
    return replace(
        recording, source=folder, meta=meta or RunMeta(), config_text=config_text, events=events, notes=notes
    )


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


def _read_events(path: Path, *, strict: bool) -> tuple[tuple[RunEvent, ...], list[str]]:
    """The events, none without the file; and notes on the file."""
    content, notes = whole_content(path) if path.exists() else (b"", [])
    if not content:
        return (), []
    whole, torn = without_torn_line(path, content)
    events: list[RunEvent] = []
    wrong: list[str] = []
    for number, line in enumerate(text_of(path, whole).split("\n"), 1):
        if line.strip():
            event, left_out = _typed(path, RunEvent, line, number, strict=strict)
            events.append(event)
            wrong += [f"line {number}: {words}" for words in left_out]
    if wrong:
        others = "" if len(wrong) == 1 else f", and {len(wrong) - 1} more"
        torn.append(f"{wrong[0]}; rig leaves it out{others}")
    return tuple(events), [f"{EVENTS}: {note}" for note in [*notes, *torn]]


def _read_part(path: Path, kind: type[_File], *, strict: bool) -> tuple[_File | None, list[str]]:
    """The content of a JSON file, None without the file; and notes on it."""
    if not path.exists():
        return None, []
    part, left_out = _typed(path, kind, text_of(path, content_of(path)), None, strict=strict)
    notes = [f"{words}; rig leaves it out" for words in left_out] + remarks(part)
    return part, [f"{path.name}: {note}" for note in notes]


def _typed(path: Path, kind: type[_P], text: str, line: int | None, *, strict: bool) -> tuple[_P, list[str]]:
    """A JSON object as a part, and a sentence on each wrong value, which is left out. ``strict``: it is an error."""
    part, left_out = salvaged(kind, _parse_object(path, text, line))
    if strict and left_out:
        raise RecordingError(path, left_out[0], "correct it, or take that key out of the file", line)
    return part, left_out


def _parse_object(path: Path, text: str, line: int | None) -> JsonObject:
    try:
        value = json.loads(text, parse_constant=_no_such_number)
    except (ValueError, RecursionError) as error:
        if line is None and isinstance(error, json.JSONDecodeError):
            line = error.lineno
        raise RecordingError(path, f"is broken JSON ({error})", "delete or correct it", line) from error
    if not isinstance(value, dict):
        raise RecordingError(path, "is no JSON object", "delete or correct it", line)
    return {plain(key): printable(item) for key, item in value.items()}


def printable(value: JsonValue) -> JsonValue:
    """A JSON value with its texts made safe for a terminal. A traceback keeps its lines."""
    if isinstance(value, str):
        return "\n".join(plain(line) for line in value.split("\n"))
    if isinstance(value, dict):
        return {plain(key): printable(item) for key, item in value.items()}
    return [printable(item) for item in value] if isinstance(value, list) else value


def _no_such_number(text: str) -> float:
    raise ValueError(f"{text} is no JSON number")
