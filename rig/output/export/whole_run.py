"""Export: a run folder as one file that other programs open.

======= ==========================================================================================================
suffix  what is in it
======= ==========================================================================================================
.mat    MATLAB, Octave: structs ``samples``, ``units``, ``meta``, ``config``, ``result``, struct array ``events``
.npz    numpy: an array for each column; ``units``, ``meta``, ``config``, ``result``, ``events`` as JSON text
.csv    t_s, u_V, y_rad, t_u_s if known, ``stage`` if there is more than one; `rig identify` reads it
.json   everything as one object: columns as lists, null for unknown
======= ==========================================================================================================

Values are those of the recording, to the last bit.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rig.config.problems import ConfigError
from rig.config.yaml12 import parse
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import RESULT, json_text, write_whole
from rig.run_folder.recording.path_kind import require_free
from rig.run_folder.recording.reader import read_result, read_run
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.sample_columns import COLUMNS, KINDS, UNITS
from rig.run_folder.results import JsonObject, RunResult

LONGEST_NAME: Final = 63  # of a MATLAB variable or field: namelengthmax
# Words that MATLAB (iskeyword) or Octave do not take as a field's name.
_MATLAB_WORDS: Final = re.compile(
    "break|case|catch|classdef|continue|do|else|elseif|end|for|function|global|if|otherwise|parfor|persistent|return|"
    "spmd|switch|try|until|while|endif|endfor|endfunction|endwhile|endswitch|end_try_catch|unwind_protect"
)


@dataclass(frozen=True)
class ExportedRun:
    """What an export writes: the rows asked for, and everything else in the folder.

    config, result  empty if the folder has none
    notes           what the folder lacks, in words
    """

    recording: Recording
    config: JsonObject
    result: RunResult
    notes: tuple[str, ...]

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns of the recording by name, one entry per row."""
        return {name: getattr(self.recording, name) for name in COLUMNS if name in self.recording.columns_present}

    def documents(self) -> JsonObject:
        """Everything but rows and events, as JSON."""
        return {
            "units": {name: UNITS[name] for name in self.columns()},
            "meta": self.recording.meta.as_json(),
            "config": self.config,
            "result": self.result.as_json(),
            "notes": list(self.notes),
        }

    def events(self) -> list[JsonObject]:
        """The events, as JSON."""
        return [event.as_json() for event in self.recording.events]


def export(
    run_folder: Path,
    to: Path,
    stage: str | None = None,
    rows: tuple[int | None, int | None] | None = None,
    *,
    overwrite: bool = False,
) -> ExportedRun:
    """Write a run to the file ``to``. Its suffix, one of ``FORMATS``, names the format. Returns what was written.

    stage      only the rows of this stage
    rows       only the rows first to last, both included, counted from 0; with ``stage``: counted in that stage
    overwrite  replace ``to`` if it is there already
    Raises RecordingError if there is no run, no such suffix or no such stage, or if ``to`` is there already or is a
    file of a run; CannotWriteError if ``to`` cannot be written.
    """
    written = FORMATS.get(to.suffix.lower())
    if written is None:
        raise RecordingError(
            to, f"ends in none of {', '.join(FORMATS)}", "give the file one of these suffixes: it names the format"
        )
    try:
        if to.is_dir():
            raise RecordingError(to, "is a folder", f"name a file in it, such as {to / ('run' + to.suffix)}")
        if not to.parent.is_dir():
            raise RecordingError(to.parent, "is no folder", "make it first, or name a file in another folder")
        require_free(to, f"another file, such as {to.parent / ('run' + to.suffix)}", overwrite=overwrite)
    except OSError as error:
        raise RecordingError(to, f"cannot be written: {error.strerror}", "name a file in another folder") from error
    run = load(run_folder, stage, rows)
    write_whole(to, written(run))
    return run


def load(run_folder: Path, stage: str | None = None, rows: tuple[int | None, int | None] | None = None) -> ExportedRun:
    """Read a run; only the rows of ``stage``, and of these only ``rows``, if given. Raises RecordingError."""
    recording = read_run(run_folder)
    notes = list(recording.notes)
    result, result_notes = read_result(run_folder)
    notes += [f"{RESULT} is missing: the run ended before it had a result"] if result is None else result_notes
    if any(event.kind == "loop_died" for event in recording.events):
        notes.append("the run was killed: its recording is complete to its last tick")
    config: JsonObject = {}
    try:
        if recording.config_text is None:
            notes.append("config.yaml is missing")
        else:
            config = parse(recording.config_text, str(run_folder / "config.yaml")).data
    except ConfigError as error:
        notes.append(f"the config is left out: {error}")
    if stage is not None:
        of_stage = recording.stage_rows(stage)
        recording = recording.select(of_stage.start, of_stage.stop - 1)
    if rows is not None:
        recording = recording.only_rows(*rows)
    return ExportedRun(replace(recording, notes=()), config, result or RunResult(), tuple(notes))


# -- formats ----------------------------------------------------------------------------------------------------------


def as_csv(run: ExportedRun) -> bytes:
    """Comma-separated text with a line of names. Each number has as few digits as name the double; empty: unknown."""
    r = run.recording
    columns: list[Iterable[str]] = [map(repr, getattr(r, name).tolist()) for name in ("t_s", "u_V", "y_rad")]
    names = ["t_s", "u_V", "y_rad"]
    if np.isfinite(r.t_u_s).any():
        names.append("t_u_s")
        columns.append("" if math.isnan(value) else repr(value) for value in r.t_u_s.tolist())
    if len(r.stages()) > 1:
        names.append("stage")
        columns.append(r.stage.tolist())
    lines = [",".join(names), *map(",".join, zip(*columns, strict=True))]
    return ("\n".join(lines) + "\n").encode("utf-8")


def as_json(run: ExportedRun) -> bytes:
    """One strict JSON object in UTF-8."""
    columns = {name: column.tolist() for name, column in run.columns().items()}
    run_name = run.recording.source.resolve().name
    whole = {"run": run_name, **run.documents(), "events": run.events(), "samples": columns}
    return json.dumps(json.loads(json_text(whole)), separators=(",", ":")).encode("utf-8") + b"\n"


def as_npz(run: ExportedRun) -> bytes:
    """A compressed .npz that ``numpy.load`` opens without pickle."""
    documents = {name: np.array(json_text({name: value})) for name, value in run.documents().items()}
    documents["events"] = np.array(json_text({"events": run.events()}))
    out = io.BytesIO()
    arrays: dict[str, NDArray[Any]] = {**run.columns(), **documents}
    np.savez_compressed(out, allow_pickle=True, **arrays)
    return out.getvalue()


def as_mat(run: ExportedRun, further: JsonObject | None = None) -> bytes:
    """A MATLAB 5 file: columns n x 1, numbers doubles, texts char, lists of texts cells, null [].

    further   variables beside those of the run
    """
    from scipy.io import savemat

    columns: dict[str, NDArray[Any]] = {
        name: _cell(column.tolist()) if KINDS[name] == "name" else column.astype(np.float64).reshape(-1, 1)
        for name, column in run.columns().items()
    }
    whole = {name: _matlab(value) for name, value in (run.documents() | (further or {})).items()}
    out = io.BytesIO()
    savemat(
        out,  # type: ignore[arg-type]  # scipy writes to open files, its stubs do not know
        {"samples": columns, "events": _struct_array(run.events()), **whole},
        long_field_names=True,
        do_compression=True,
        oned_as="column",
    )
    return out.getvalue()


FORMATS: Final[dict[str, Callable[[ExportedRun], bytes]]] = {
    ".mat": as_mat,
    ".npz": as_npz,
    ".csv": as_csv,
    ".json": as_json,
}


# -- MATLAB's kinds of values -----------------------------------------------------------------------------------------


def matlab_names(names: Sequence[str]) -> list[str]:
    """Names that MATLAB takes: a letter, then letters, digits and _, 63 characters at most, no name twice."""
    taken: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:LONGEST_NAME]
        if not plain[:1].isalpha() or _MATLAB_WORDS.fullmatch(plain):
            plain = f"x{plain}"[:LONGEST_NAME]
        unique, number = plain, 1
        while unique in taken:
            number += 1
            unique = f"{plain[: LONGEST_NAME - len(str(number)) - 1]}_{number}"
        taken.append(unique)
    return taken


def _matlab(value: Any) -> Any:
    """A JSON value as the type that savemat writes best."""
    if value is None:
        return np.zeros((0, 0))
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int | float):
        return float(value)
    if isinstance(value, Mapping):
        return dict(zip(matlab_names(list(value)), map(_matlab, value.values()), strict=True))
    if not value:
        return np.zeros((0, 0))
    if all(isinstance(item, Mapping) for item in value):
        return _struct_array(value)
    numbers = _numbers(value)
    return _cell([_matlab(item) for item in value]) if numbers is None else numbers


def _numbers(values: Sequence[Any]) -> NDArray[np.float64] | None:
    """A vector or matrix of the numbers in a list, null as nan; None if the list holds anything else."""
    if all(isinstance(item, list) and item and len(item) == len(values[0]) for item in values):
        rows = [_numbers(item) for item in values]
        return np.vstack([row for row in rows if row is not None]) if all(row is not None for row in rows) else None
    if all(item is None or (isinstance(item, int | float) and not isinstance(item, bool)) for item in values):
        return np.array([math.nan if item is None else float(item) for item in values])
    return None


def _cell(items: Sequence[Any]) -> NDArray[np.object_]:
    cell = np.empty((len(items), 1), dtype=object)
    cell[:, 0] = items
    return cell


def _struct_array(items: Sequence[Mapping[str, Any]]) -> Any:
    """An n x 1 struct array with the fields of all items; [] if an item lacks one."""
    fields = list(dict.fromkeys(name for item in items for name in item))
    if not fields:
        return np.zeros((0, 0))
    array = np.empty((len(items), 1), dtype=[(name, object) for name in matlab_names(fields)])
    for row, item in enumerate(items):
        array[row, 0] = tuple(_matlab(item.get(name)) for name in fields)
    return array
