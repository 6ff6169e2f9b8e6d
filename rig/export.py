"""A run folder in one file of another kind: what people open next.

======= ==========================================================================================================
suffix  what is in it
======= ==========================================================================================================
.mat    MATLAB, Octave: structs ``samples``, ``units``, ``meta``, ``config``, ``result``, struct array ``events``
.npz    numpy: an array for each column; ``units``, ``meta``, ``config``, ``result``, ``events`` as JSON text
.csv    t_s, u_V, y_rad, t_u_s where it is known, and ``stage`` unless one stage is asked for: `rig identify` reads it
.json   all of it as one object, columns as lists, null for what is not known
======= ==========================================================================================================

Values are those of the record, to the last bit.
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
from rig.recording.columns import COLUMNS, KINDS, UNITS
from rig.recording.errors import RecordingError
from rig.recording.folder import RESULT, json_text, write_whole
from rig.recording.path_kind import is_file_of_a_run
from rig.recording.reader import Recording, read_result, read_run
from rig.results import JsonObject, RunResult
from rig.results.reading import remarks

LONGEST_NAME: Final = 63  # of a MATLAB variable or field: namelengthmax
# Words that MATLAB (iskeyword) or Octave do not take as a field's name.
_MATLAB_WORDS: Final = (
    *(
        "break",
        "case",
        "catch",
        "classdef",
        "continue",
        "do",
        "else",
        "elseif",
        "end",
        "for",
        "function",
        "global",
        "if",
    ),
    *("otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "until", "while", "endif", "endfor"),
    *("endfunction", "endwhile", "endswitch", "end_try_catch", "unwind_protect"),
)


@dataclass(frozen=True)
class Run:
    """What is exported: the rows asked for, and everything else of the folder as it is there.

    config, result  empty where the folder has none
    notes           in words, what the folder lacks
    """

    recording: Recording
    config: JsonObject
    result: RunResult
    notes: tuple[str, ...]

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns that the record has, by name, one entry a row."""
        return {name: getattr(self.recording, name) for name in COLUMNS if name in self.recording.columns_present}

    def papers(self) -> JsonObject:
        """Everything but rows and events, as JSON has it."""
        return {
            "units": {name: UNITS[name] for name in self.columns()},
            "meta": self.recording.meta.as_json(),
            "config": self.config,
            "result": self.result.as_json(),
            "notes": list(self.notes),
        }

    def events(self) -> list[JsonObject]:
        """The events, as JSON has them."""
        return [event.as_json() for event in self.recording.events]


def export(
    run_folder: Path,
    to: Path,
    stage: str | None = None,
    rows: tuple[int | None, int | None] | None = None,
    *,
    overwrite: bool = False,
) -> Run:
    """Write the run to the file ``to``, whose suffix says how: one of ``FORMATS``. What was written is returned.

    stage  the rows of this stage alone
    rows   rows first to last of the run alone, both included, counted from 0; with ``stage``: of that stage's
    Raises RecordingError where there is no run, no such suffix or no such stage, ``to`` is there already,
    or is a file of a run;
    CannotWriteError where it cannot be written.
    """
    written = FORMATS.get(to.suffix.lower())
    if written is None:
        raise RecordingError(to, f"ends in none of {', '.join(FORMATS)}", "name the file so: its end says the format")
    try:
        if to.is_dir():
            raise RecordingError(to, "is a folder", f"name a file in it, such as {to / ('run' + to.suffix)}")
        if not to.parent.is_dir():
            raise RecordingError(to.parent, "is no folder", "make it first, or name a file elsewhere")
        if is_file_of_a_run(to):
            raise RecordingError(
                to, "is a file of the run itself", f"name another file, such as {to.parent / ('run' + to.suffix)}"
            )
        if to.exists() and not overwrite:
            raise RecordingError(to, "is there already", "name another file, or add --force to replace it")
    except OSError as error:
        raise RecordingError(to, f"cannot be written: {error.strerror}", "name a file elsewhere") from error
    run = load(run_folder, stage, rows)
    write_whole(to, written(run))
    return run


def load(run_folder: Path, stage: str | None = None, rows: tuple[int | None, int | None] | None = None) -> Run:
    """The run, or of it the rows of ``stage`` alone, and of these rows ``rows`` alone. Raises RecordingError."""
    recording = read_run(run_folder)
    notes = list(recording.notes)
    result = read_result(run_folder)
    if result is None:
        notes.append(f"{RESULT} is missing: the run ended before it had a result")
    else:
        notes.extend(f"{RESULT}: {remark}" for remark in remarks(result))
    if any(event.kind == "loop_died" for event in recording.events):
        notes.append("the run was killed: its record is complete to its last tick")
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
    return Run(replace(recording, notes=()), config, result or RunResult(), tuple(notes))


# -- formats ----------------------------------------------------------------------------------------------------------


def as_csv(run: Run) -> bytes:
    """Comma-separated text with a line of names; numbers are the shortest that name the double, empty: not known."""
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


def as_json(run: Run) -> bytes:
    """One strict JSON object in UTF-8."""
    columns = {name: column.tolist() for name, column in run.columns().items()}
    run_name = run.recording.source.resolve().name
    whole = {"run": run_name, **run.papers(), "events": run.events(), "samples": columns}
    return json.dumps(json.loads(json_text(whole)), separators=(",", ":")).encode("utf-8") + b"\n"


def as_npz(run: Run) -> bytes:
    """A compressed .npz that ``numpy.load`` opens without pickle."""
    papers = {name: np.array(json_text({name: value})) for name, value in run.papers().items()}
    papers["events"] = np.array(json_text({"events": run.events()}))
    out = io.BytesIO()
    arrays: dict[str, Any] = {**run.columns(), **papers}
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def as_mat(run: Run) -> bytes:
    """A MATLAB 5 file: columns n x 1, numbers doubles, texts char, lists of texts cells, null []."""
    from scipy.io import savemat

    columns: dict[str, Any] = {
        name: _cell(column.tolist()) if KINDS[name] == "name" else column.astype(np.float64).reshape(-1, 1)
        for name, column in run.columns().items()
    }
    whole = {name: _matlab(value) for name, value in run.papers().items()}
    out = io.BytesIO()
    savemat(
        out,  # type: ignore[arg-type]  # scipy writes to open files, its stubs do not know
        {"samples": columns, "events": _struct_array(run.events()), **whole},
        long_field_names=True,
        do_compression=True,
        oned_as="column",
    )
    return out.getvalue()


FORMATS: Final[dict[str, Callable[[Run], bytes]]] = {".mat": as_mat, ".npz": as_npz, ".csv": as_csv, ".json": as_json}


# -- MATLAB's kinds of values -----------------------------------------------------------------------------------------


def matlab_names(names: Sequence[str]) -> list[str]:
    """These names as MATLAB takes them: a letter, then letters, digits and _, at most 63 in all, each once."""
    taken: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:LONGEST_NAME]
        if not plain[:1].isalpha() or plain in _MATLAB_WORDS:
            plain = f"x{plain}"[:LONGEST_NAME]
        unique, number = plain, 1
        while unique in taken:
            number += 1
            unique = f"{plain[: LONGEST_NAME - len(str(number)) - 1]}_{number}"
        taken.append(unique)
    return taken


def _matlab(value: Any) -> Any:
    """A value of JSON as savemat writes it best."""
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
    """A vector or matrix of the numbers of a list, null as nan; None where there is anything else in it."""
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
    """An n x 1 struct array with every field that one of the items has; [] where an item has none."""
    fields = list(dict.fromkeys(name for item in items for name in item))
    if not fields:
        return np.zeros((0, 0))
    array = np.empty((len(items), 1), dtype=[(name, object) for name in matlab_names(fields)])
    for row, item in enumerate(items):
        array[row, 0] = tuple(_matlab(item.get(name)) for name in fields)
    return array
