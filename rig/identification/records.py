"""Which stages of a run are read beside its relay tests, and up to which row a stage is sound."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.stage import Stage, StageKind, kind_of

FURTHER = (StageKind.BREAKAWAY, StageKind.SEARCH, StageKind.SURVEY)
"""Kinds of stages that the law of the motor is fitted to, beside the tests. Tracking never is: it is the check."""

SOUND = frozenset(
    (
        "NO_CYCLE", "NO_SWITCHING", "INTERRUPTED", "RECORDER_DEAD", "LAW_FAILED", "LAW_TIME", "LAW_UNWATCHED",
        "INTERNAL",
        "NOT_IDENTIFIED", "LATE", "OVERSPEED", "TRAVEL_HARD", "DEVICE_TRAVEL", "DEVICE_END_SWITCH", "DEVICE_ESTOP",
        "DRIVE_TOO_SMALL", "NOT_HOME",
    )
)  # fmt: skip
"""Faults that say nothing against sensor and drive: every row before them is sound."""
LATE_TICKS = 2  # a fault of the sensor or the drive is found within the longest period so far, and two ticks


def names_of(recording: Recording) -> list[str]:
    """Names of the stages that identification reads: the relay tests, and the records beside them."""
    return [name for name in recording.stages() if Stage.parse(name).is_test or kind_of(name) in FURTHER]


def require_known(recordings: Sequence[Recording], without: Sequence[str]) -> None:
    """Raises IdentifyError where no recording has a record of one of these names."""
    known = list(dict.fromkeys(name for recording in recordings for name in names_of(recording)))
    unknown = [name for name in without if name not in known]
    if unknown:
        there = f"the records are {', '.join(known)}" if known else "only the stages of a run folder have names"
        raise IdentifyError(f"there is no record {unknown[0]!r} to leave out", there)


def left_out(recording: Recording, without: Sequence[str]) -> frozenset[str]:
    """Names of the records that are not read: those given, and those that the run's own config leaves out."""
    return frozenset(without) | frozenset(recording.meta.identify_without or ())


def sound_rows(recording: Recording, stage: str) -> tuple[slice, str | None]:
    """The rows of a stage up to where they are sound, and a note on what was left out; None if nothing was.

    A fault of the sensor or the drive is found within a period (docs/theory.md 12.7). So of the stage that it ended,
    the last period is left out. Raises RecordingError as ``Recording.stage_rows``.
    """
    rows = recording.stage_rows(stage)
    code = _ended_by(recording, rows)
    if code is None or code in SOUND:
        return rows, None
    kept = rows.stop - _last_period(recording, rows) - LATE_TICKS
    stop = max(rows.start, kept)
    return slice(rows.start, stop), f"{stage}: its last {rows.stop - stop} rows are left out: {code} ended it"


def _ended_by(recording: Recording, rows: slice) -> str | None:
    """Code of the fault that ended the stage of these rows; None if none did."""
    faults = [event for event in recording.events if event.kind == "fault"]
    was_last = bool(np.all(recording.stage[rows.stop :] == str(StageKind.STOPPING)))
    return str(faults[-1].detail.get("code", "")) if faults and was_last else None


def _last_period(recording: Recording, rows: slice) -> int:
    """Rows of the longest period of the drive; all rows if it has no whole period."""
    positive = recording.u_V[rows] > 0.0
    rises = np.flatnonzero(positive[1:] & ~positive[:-1])
    return int(np.diff(rises).max()) if rises.size > 1 else rows.stop - rows.start
