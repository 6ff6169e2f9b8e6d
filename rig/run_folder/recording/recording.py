"""``Recording``: the rows of one recording as arrays, with what a run folder says beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rig.core.signals import BenchDelay
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.sample_columns import COLUMNS, KINDS, Reads, SampleRow
from rig.run_folder.recording.servo_law import OwnLoop
from rig.run_folder.results import MeasuredDelay, RunEvent, RunMeta
from rig.run_folder.results.salvage import DamagedError, parsed

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Column = NDArray[Any]
"""Numbers or names: ``columns.KINDS`` says which."""
Columns = dict[str, Column]

MIN_ROWS: Final = 3
FIT_ROWS: Final = 22  # of a run that can be fitted: fewer are none
# A coarse clock goes on by the same tick, within this share of it, but for this share of the rows; of so many periods
ONE_TICK, STANDS, SLOW = 0.2, 0.1, 1.5
# Periods by which stamps of even rows scatter about where they belong; or in each part of the rows one is on time
FROM_LINE, ON_TIME, TIMED_PARTS = 8.0, 1.0, 10
LATEST_S: Final = 1e12
EVENTS: Final = "events.jsonl"


@dataclass(frozen=True, eq=False)
class Recording:
    """Rows of one recording; every array has one entry a row and is read-only.

    t_s          time of the sample y, s; strictly rising
    t_u_s        time at which u took effect, s; nan if unknown
    y_rad, u_V   position; drive that acts from t_u_s until t_u_s of the next row
    v_rad_per_s, z_rad_s, yd_rad, late_us, io_us   as in ``sample_columns``; nan if absent
    tick         as recorded, else 0, 1, 2, ...
    seq, y_counts   as recorded, else -1
    flags        as recorded, else 0
    stage        name of each row's stage, else ""
    columns_present   all columns of the file, in its order, also those that rig does not know
    meta, config_text, events   of a run folder; RunMeta(), None and () for a plain CSV file
    notes        defects that the reader put up with, as sentences: a torn last line, a missing meta.json
    first_row    number of the first row in the file; not 0 in a selection of rows
    units_stated whether somebody has said in which units the file is: then a large number is no sign of a wrong one
    drive_steps  the drive as it was, times in s and volts, where there are fewer positions than drives; None: u_V
    own_loop     of the servo that gave the drive; None: volts are volts
    reads        what shows its positions
    most_V       the largest drive that the bench gives, V; inf: not known
    slew_V_s     by which the device ramps its drive from one row's to the next, V/s; None: at once
    """

    t_s: Floats
    t_u_s: Floats
    y_rad: Floats
    u_V: Floats
    v_rad_per_s: Floats
    z_rad_s: Floats
    yd_rad: Floats
    y_counts: Integers
    tick: Integers
    seq: Integers
    late_us: Floats
    io_us: Floats
    flags: Integers
    stage: NDArray[np.str_]
    columns_present: tuple[str, ...]
    source: Path
    meta: RunMeta = field(default_factory=RunMeta)
    config_text: str | None = None
    events: tuple[RunEvent, ...] = ()
    notes: tuple[str, ...] = ()
    first_row: int = 0
    units_stated: bool = False
    drive_steps: tuple[Floats, Floats] | None = None
    own_loop: OwnLoop | None = None
    slew_V_s: float | None = None
    reads: Reads = "angle"
    most_V: float = math.inf

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def delay(self) -> BenchDelay | None:
        """The delay of the bench by the strokes of its breakaway check; None in a file or run that does not say it.

        Raises RecordingError if the event of it is broken.
        """
        for event in self.events:
            if event.kind == "delay":
                try:
                    return parsed(MeasuredDelay, event.detail).delay
                except DamagedError as error:
                    raise RecordingError(
                        self.source / EVENTS, f"event delay is broken ({error})", "copy the run folder again"
                    ) from error
        return None

    def stages(self) -> list[str]:
        """Names of the stages, in the order of their first rows; [] without a column ``stage``."""
        names, first = np.unique(self.stage, return_index=True)
        return [str(names[k]) for k in np.argsort(first) if names[k]]

    def stage_rows(self, name: str) -> slice:
        """The rows of one stage. Raises RecordingError if there is no such stage, or its rows are not in one piece."""
        rows = np.flatnonzero(self.stage == name)
        if len(rows) == 0:
            there = ", ".join(self.stages()) or "none"
            raise RecordingError(self.source, f"has no stage {name!r}", f"the stages there are: {there}")
        first, end = int(rows[0]), int(rows[-1]) + 1
        if end - first != len(rows):
            raise RecordingError(
                self.source,
                f"stage {name!r} is interrupted by another at row {first + int(np.argmax(np.diff(rows) > 1)) + 1}",
                f"choose its rows by number: --rows {first}:{end - 1}, or a part of them",
            )
        return slice(first, end)

    def rows(self) -> list[SampleRow]:
        """All rows, one by one."""
        columns = (getattr(self, name).tolist() for name in COLUMNS)
        return [SampleRow(*row) for row in zip(*columns, strict=True)]

    def select(self, first: int, last: int) -> Recording:
        """Rows ``first`` to ``last``, both included, counted from 0 as in the ``rows`` of result.json.

        Events, meta and configuration stay whole. Raises IndexError for rows outside the recording.
        """
        if not 0 <= first <= last < len(self):
            raise IndexError(f"rows {first} to {last} of a recording of {len(self)}")
        chosen = {name: getattr(self, name)[first : last + 1] for name in COLUMNS}
        return replace(self, first_row=self.first_row + first, **chosen)

    def only_rows(self, first: int | None, last: int | None) -> Recording:
        """As ``select``; None is the first or the last row. Raises RecordingError for rows outside the recording."""
        start, end = 0 if first is None else first, len(self) - 1 if last is None else last
        if not 0 <= start <= end < len(self):
            raise RecordingError(
                self.source,
                f"has no rows {start} to {end}: they are numbered 0 to {len(self) - 1}",
                f"give --rows within 0:{len(self) - 1}, the smaller number first",
            )
        return self.select(start, end)


def from_columns(
    source: Path,
    t_s: Floats,
    u_V: Floats,
    y_rad: Floats,
    t_u_s: Floats | None = None,
    late_us: Floats | None = None,
    meta: RunMeta | None = None,
) -> Recording:
    """A recording from arrays, as ``read_csv`` makes it from a file with these columns. Each has n >= 3 finite values.

    source         its name in messages
    late_us, meta  as in a run; late_us and meta.period_s together give the clock ratio
    Raises RecordingError if times do not rise.
    """
    given = {"t_s": t_s, "u_V": u_V, "y_rad": y_rad, "t_u_s": t_u_s, "late_us": late_us}
    columns: Columns = {k: np.array(values, dtype=np.float64) for k, values in given.items() if values is not None}
    recording = assembled(source, columns, range(1, t_s.size + 1), tuple(columns))
    return recording if meta is None else replace(recording, meta=meta)


def assembled(
    source: Path, columns: Columns, numbers: Sequence[int], columns_present: tuple[str, ...], notes: Sequence[str] = ()
) -> Recording:
    """A recording from its known columns; it keeps these arrays and makes them read-only.

    numbers   the line of each row, for messages
    Raises RecordingError if times do not rise.
    """
    require_rising(source, columns["t_s"], numbers)
    _add_absent(columns, len(numbers))
    for array in columns.values():
        array.setflags(write=False)
    arrays: dict[str, Any] = columns
    return Recording(**arrays, source=source, columns_present=columns_present, notes=tuple(notes))


def require_rising(path: Path, t_s: Floats, numbers: Sequence[int]) -> None:
    """Raise RecordingError at the first row, of these lines, whose time does not rise."""
    bad = np.flatnonzero(t_s[1:] <= t_s[:-1])
    if len(bad) == 0:
        return
    k = int(bad[0]) + 1
    with np.errstate(over="ignore"):
        steps = np.diff(t_s)
    cause = f"{'repeats the time before it' if steps[k - 1] == 0.0 else 'goes back in time'} "
    cause += f"(t_s = {t_s[k]:.9g} after {t_s[k - 1]:.9g})"
    cure = "keep one run in a file, with its rows in order and one row for each sample"
    goes_on = steps[steps > 0.0]
    tick_s = float(np.median(goes_on)) if goes_on.size else math.nan
    even_s = even_times_s(t_s)
    mean_s = tick_s if even_s is None else float(even_s[1] - even_s[0])
    of_a_tick = np.count_nonzero(np.abs(goes_on - tick_s) < ONE_TICK * tick_s)
    one_tick = of_a_tick > (1.0 - STANDS) * goes_on.size and tick_s > SLOW * mean_s
    if even_s is not None and one_tick:
        cause += f": the clock stands still, and then goes on by {1e3 * tick_s:.4g} ms: it is too coarse for these rows"
    elif even_s is not None:
        cause += f", {bad.size} rows in all: rows of {1e3 * mean_s:.4g} ms got their stamps late, or in bursts"
    if even_s is not None:
        cure = (
            f"log a finer clock where the position is read, such as micros(); or, if the rows came evenly, say how far "
            f"apart, instead of a time: --period {1e3 * mean_s:.4g}ms is their mean"
        )
    elif steps[k - 1] < 0.0:
        cure += "; or, if this is another run, let its time begin as that of the first, or say --run COLUMN"
    raise RecordingError(path, cause, cure, numbers[k])


def even_times_s(t_s: Floats) -> Floats | None:
    """Even times for stamps that scatter about these, or come late in bursts; None for others, as where rows are lost.

    Then no stamp is far from where it belongs, or in each part of the record the earliest ones are.
    """
    if t_s.size < TIMED_PARTS or not np.abs(t_s).max() < LATEST_S:
        return None
    rows = np.arange(t_s.size, dtype=np.float64)
    line = np.polynomial.Polynomial.fit(rows, t_s, 1)
    off_s, period_s = t_s - line(rows), float(line(1.0) - line(0.0))
    if np.abs(off_s).max() > FROM_LINE * period_s:
        at = np.array([part[np.argmin(off_s[part])] for part in np.array_split(np.arange(t_s.size), TIMED_PARTS)])
        line = np.polynomial.Polynomial.fit(at, t_s[at], 1)
        if np.abs(t_s[at] - line(at)).max() > ON_TIME * period_s:
            return None
    return np.asarray(line(rows)) if period_s > 0.0 else None


def _add_absent(columns: Columns, count: int) -> None:
    for name in COLUMNS:
        if name in columns:
            continue
        if KINDS[name] == "name":
            columns[name] = np.full(count, "", dtype=np.str_)
        elif name == "tick":
            columns[name] = np.arange(count, dtype=np.int64)
        elif KINDS[name] == "integer":
            columns[name] = np.full(count, 0 if name == "flags" else -1, dtype=np.int64)
        else:
            columns[name] = np.full(count, np.nan)
