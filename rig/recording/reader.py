"""Reads a recording: a run folder, or any CSV file with at least the columns t_s, u_V and y_rad.

``csv_file`` reads the rows. This file reads what stands beside them in a run folder.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from rig.recording.csv_file import read_csv
from rig.recording.errors import RecordingError
from rig.recording.folder import CONFIG, META, RESULT
from rig.recording.path_kind import no_recording, no_run
from rig.recording.recording import Recording
from rig.recording.text_file import content_of, is_folder, text_of, whole_content, without_torn_line
from rig.recording.writer import EVENTS, SAMPLES
from rig.results import Part, RunEvent, RunMeta, RunResult
from rig.results.reading import DamagedError, parsed, remarks
from rig.signals import plain

_P = TypeVar("_P", bound=Part)


def read(path: Path) -> Recording:
    """Read a run folder or a CSV file, whichever ``path`` is. Raises RecordingError."""
    mistaken = no_recording(path)
    if mistaken is not None:
        raise mistaken
    return read_run(path) if is_folder(path) else read_csv(path)


def read_run(folder: Path, known: Recording | None = None) -> Recording:
    """Read a run folder. ``notes`` say what a killed run did not write.

    known  this run as read earlier: its rows are not parsed again

    Raises RecordingError if this is not a run (see `no_run`), if samples.csv is unusable, or if another file of the
    folder is broken.
    """
    if not is_folder(folder) or not (folder / SAMPLES).exists():
        raise no_run(folder)
    recording = read_csv(folder / SAMPLES, own=True, known=known)
    notes = list(recording.notes)

    meta = _read_part(folder / META, RunMeta)
    if meta is not None:
        notes.extend(f"{META}: {remark}" for remark in remarks(meta))
    else:
        meta = RunMeta()
        notes.append(f"{META} is missing")
    config = folder / CONFIG
    config_text = text_of(config, content_of(config)) if config.exists() else None
    events: list[RunEvent] = []
    if (folder / EVENTS).exists():
        events = _read_events(folder / EVENTS, notes)
    return replace(
        recording, source=folder, meta=meta, config_text=config_text, events=tuple(events), notes=tuple(notes)
    )


def read_result(folder: Path) -> RunResult | None:
    """The content of a run folder's result.json; None without that file. Raises RecordingError if it is broken."""
    return _read_part(folder / RESULT, RunResult)


def _read_events(path: Path, notes: list[str]) -> list[RunEvent]:
    content, moved = whole_content(path)
    if not content:
        return []
    whole, torn = without_torn_line(path, content)
    notes.extend(f"{EVENTS}: {note}" for note in [*moved, *torn])
    lines = text_of(path, whole).split("\n")
    return [_typed(path, RunEvent, line, number) for number, line in enumerate(lines, 1) if line.strip()]


def _read_part(path: Path, kind: type[_P]) -> _P | None:
    """The content of a JSON file; None without the file."""
    return _typed(path, kind, text_of(path, content_of(path)), None) if path.exists() else None


def _typed(path: Path, kind: type[_P], text: str, line: int | None) -> _P:
    try:
        return parsed(kind, _parse_object(path, text, line))
    except DamagedError as error:
        raise RecordingError(path, error.cause, "correct it, or take that key out of the file", line) from error


def _parse_object(path: Path, text: str, line: int | None) -> dict[str, Any]:
    try:
        value = json.loads(text, parse_constant=_no_such_number)
    except (ValueError, RecursionError) as error:
        if line is None and isinstance(error, json.JSONDecodeError):
            line = error.lineno
        raise RecordingError(path, f"is broken JSON ({error})", "delete or correct it", line) from error
    if not isinstance(value, dict):
        raise RecordingError(path, "is no JSON object", "delete or correct it", line)
    return {plain(key): printable(item) for key, item in value.items()}


def printable(value: Any) -> Any:
    """A JSON value with its texts made safe for a terminal. A traceback keeps its lines."""
    if isinstance(value, str):
        return "\n".join(plain(line) for line in value.split("\n"))
    if isinstance(value, dict):
        return {plain(key): printable(item) for key, item in value.items()}
    return [printable(item) for item in value] if isinstance(value, list) else value


def _no_such_number(text: str) -> float:
    raise ValueError(f"{text} is no JSON number")
