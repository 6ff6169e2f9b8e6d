"""Recorded runs for a page: one, thin enough to draw; and whether several are of one motor."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rig.panel.messages import Compared, Drawn
from rig.run_folder.recording.reader import read_run
from rig.run_folder.recording.recording import Floats, Recording
from rig.run_folder.recording.stage import kind_of
from rig.run_folder.results import JsonObject, RunEvent

MOST_POINTS: Final = 4000
_DRIVEN: Final = ("relay", "strokes", "hysteretic", "track")


def drawn(folder: Path) -> Drawn:
    """A run to be drawn. Raises RecordingError."""
    recording = read_run(folder)
    shown = thinned(recording.y_rad, MOST_POINTS)
    return {
        "series": {
            "t_s": _numbers(recording.t_s[shown], 4),
            "y_rad": _numbers(recording.y_rad[shown], 5),
            "u_V": _numbers(recording.u_V[shown], 4),
        },
        "rows": len(recording.t_s),
        "first_switch_s": first_switch_s(recording),
        "stages": [_of(event, "name") for event in recording.events if event.kind == "stage"],
        "faults": [_of(event, "code", "cause", "cure") for event in recording.events if event.kind == "fault"],
        "notes": list(recording.notes),
    }


def compared(*folders: Path) -> Compared:
    """What `rig compare` says of these runs. Raises RecordingError."""
    from rig.output.compare.comparison import CompareError, compare  # the panel itself compares nothing

    try:
        return {"comparison": compare(folders).result.as_json(), "why": ""}
    except CompareError as error:
        return {"comparison": None, "why": f"{error.cause}: {error.cure}"}


def thinned(y_rad: Floats, most: int) -> NDArray[np.intp]:
    """At most ``most`` row numbers, rising: of each stretch its lowest and its highest row, so that no peak is lost."""
    rows = len(y_rad)
    if rows <= most:
        return np.arange(rows)
    edges = np.linspace(0, rows, most // 2 + 1).astype(int)
    found = [
        first + index
        for first, last in itertools.pairwise(edges.tolist())
        for index in (int(np.argmin(y_rad[first:last])), int(np.argmax(y_rad[first:last])))
    ]
    return np.unique(found)


def first_switch_s(recording: Recording) -> float | None:
    """When the drive first changes its sign in the first test, s; None if it never does. Runs are aligned by it."""
    for stage in recording.stages():
        if kind_of(stage) in _DRIVEN:
            rows = np.flatnonzero(recording.stage == stage)  # a broken recording may have them in pieces
            sign = np.sign(recording.u_V[rows])
            changed = np.flatnonzero(sign[1:] * sign[:-1] < 0)
            if len(changed):
                return float(recording.t_s[rows][changed[0] + 1])
    return None


def _of(event: RunEvent, *keys: str) -> JsonObject:
    return {"t_s": event.t_s, **{key: event.detail.get(key) for key in keys}}


def _numbers(values: Floats, digits: int) -> list[float | None]:
    return [round(value, digits) if np.isfinite(value) else None for value in values.tolist()]
