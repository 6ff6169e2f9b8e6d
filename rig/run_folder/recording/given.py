"""What a program gives to be identified or predicted, as recordings: runs, paths, or arrays."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rig.run_folder.recording import reader
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.recording import MIN_ROWS, Recording, from_columns

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
    return [
        recording
        for one in given
        for recording in ([one] if isinstance(one, Recording) else reader.read_all(Path(one)))
    ]


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
