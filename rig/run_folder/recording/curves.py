"""curves.json of a run folder: the arrays behind its answer, so that a report is drawn without another fit.

Each array is the base64 text of its 64-bit floats, the lowest byte first (docs/results.md).
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import Field

from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.folder import CURVES, json_text, write_whole
from rig.run_folder.recording.reader import MOST_BYTES, is_there, read_object
from rig.run_folder.recording.recording import Floats, Recording
from rig.run_folder.recording.sample_columns import COLUMNS
from rig.run_folder.results import Answer, Part, known
from rig.run_folder.results.estimates import LARGEST
from rig.run_folder.results.part import VERSION, Count, Number, Text
from rig.run_folder.results.salvage import DamagedError, parsed

_SAME: Final = 1e-6  # relative: so near are the answers of two processors to the same rows
_NUMBERS: Final = ("tau_s", "K_rad_s_V", "fc_V")
_ARRAYS: Final = ("residual_t_s", "residual_rad", "friction_V")


@dataclass(frozen=True, eq=False)
class Curves:
    """What an identification left sample by sample.

    answer        that they are of: its method, laws and numbers say which one it is
    residual_t_s, residual_rad   times, s, and recorded less modelled position, rad; of one length
    friction_V    friction after each sample of the recursion of least squares, V; nan before there is one; empty: none
    """

    answer: Answer
    residual_t_s: Floats
    residual_rad: Floats
    friction_V: Floats

    def is_of(self, answer: Answer) -> bool:
        """Whether they are of this answer: the same method, laws and numbers."""
        own, other = (
            (one.method, [law.name for law in one.law or ()], [known(one.value(name)) for name in _NUMBERS])
            for one in (self.answer, answer)
        )
        return own[:2] == other[:2] and np.allclose(own[2], other[2], rtol=_SAME, atol=0.0, equal_nan=True)


class _Law(Part):
    name: Text


class _Kept(Part):
    """The file."""

    version: Count = Field(alias="schema")
    rows_sha256: Text
    method: Text
    law: tuple[_Law, ...]
    tau_s: Number
    K_rad_s_V: Number
    fc_V: Number
    residual_t_s: Text
    residual_rad: Text
    friction_V: Text


def write_curves(folder: Path, recording: Recording, curves: Curves) -> None:
    """Write curves.json; not where the reader would refuse it for its size or its numbers: then a report fits again.

    recording   all rows of the run
    Raises CannotWriteError.
    """
    arrays = {name: getattr(curves, name) for name in _ARRAYS}
    content = json_text(
        {
            "schema": VERSION,
            "rows_sha256": _digest(recording),
            "method": curves.answer.method,
            "law": [{"name": law.name} for law in curves.answer.law or ()],
            **{name: known(curves.answer.value(name)) for name in _NUMBERS},
            **{name: base64.b64encode(array.astype("<f8").tobytes()).decode() for name, array in arrays.items()},
        }
    ).encode("utf-8")
    if len(content) <= MOST_BYTES and all(_is_drawn(name, array) for name, array in arrays.items()):
        write_whole(folder / CURVES, content)


def read_curves(folder: Path, recording: Recording, answer: Answer | None) -> Curves:
    """The curves of a run's answer.

    recording, answer   all rows of the run, and its answer now
    Raises RecordingError where there are none, and where the file is damaged, or of other rows, or of another answer.
    """
    path, cure = folder / CURVES, "delete it; `rig identify` on the folder writes it anew"
    if not is_there(path):
        raise RecordingError(path, "is missing", "`rig identify` on the folder writes it")
    try:
        kept = parsed(_Kept, read_object(path))
        if kept.version != VERSION:
            raise RecordingError(path, f"has the form {kept.version}, and this version of rig knows {VERSION}", cure)
        of = Answer.model_validate(kept.model_dump(include={"method", "law", *_NUMBERS}))
        found = Curves(of, *(_floats(kept, name) for name in _ARRAYS))
    except (DamagedError, ValueError) as error:
        raise RecordingError(path, f"is damaged ({error})", cure) from error
    if found.residual_t_s.size != found.residual_rad.size:
        raise RecordingError(path, "is damaged (residual_t_s and residual_rad differ in length)", cure)
    if kept.rows_sha256 != _digest(recording):
        raise RecordingError(path, "is of other rows", cure)
    if answer is None or not found.is_of(answer):
        raise RecordingError(path, "is of another answer than result.json", cure)
    return found


def _floats(kept: _Kept, name: str) -> Floats:
    """An array of the file. Raises ValueError."""
    array = np.frombuffer(base64.b64decode(getattr(kept, name), validate=True), dtype="<f8")
    if not _is_drawn(name, array):
        raise ValueError(f"{name} holds what is no number, or too large")
    return array


def _is_drawn(name: str, array: Floats) -> bool:
    small = np.abs(array) < LARGEST
    return bool(np.all(small | np.isnan(array) if name == "friction_V" else small))


def _digest(recording: Recording) -> str:
    """SHA-256 of the values of all rows, column by column."""
    digest = hashlib.sha256()
    for name in recording.columns_present:
        if name in COLUMNS:
            column = getattr(recording, name)
            values = "\n".join(column.tolist()).encode("utf-8") if column.dtype.kind == "U" else column.tobytes()
            digest.update(name.encode("utf-8") + values)
    return digest.hexdigest()
