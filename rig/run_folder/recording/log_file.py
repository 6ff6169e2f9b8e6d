"""Reads somebody's own log: a CSV file with any columns and units, with or without a line of column names.

For any content of the file the result is a ``Recording``, or a ``RecordingError`` with file, line and one cure.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rig.run_folder.recording import log_mends
from rig.run_folder.recording.csv_table import EVENTS, CsvTable, CsvText
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_format import (
    CURRENT_CAUSE,
    CURRENT_CURE,
    LARGEST,
    OWN_NAMES,
    UNITS,
    USUAL_NAMES,
    USUAL_SUPPLY,
    LogColumn,
    LogFormat,
    says_current,
    sounds_like,
    units_of_column,
    units_said,
    usual_places,
    words_of,
)
from rig.run_folder.recording.log_lines import is_number, shown
from rig.run_folder.recording.recording import (
    FIT_ROWS,
    MIN_ROWS,
    Columns,
    Floats,
    Integers,
    Recording,
    assembled,
    require_rising,
)
from rig.run_folder.recording.sample_columns import Reads
from rig.run_folder.recording.servo_law import OwnLoop, ServoLaw

_LONGEST_PERIOD_S, _SHORTEST_PERIOD_S = 0.5, 20e-6  # between samples; rig/identification/plausibility.py refuses others
_SIGNED = 0.05  # of the largest drive: a smaller negative one may be noise of a size
# Of a drive whose middle is 0 V: of full drive, how far that is from the half; of all motion, the way back; and how
# drive and motion are correlated
_HALF, _TO_AND_FRO, _TURNS = 0.02, 0.1, 0.4
_PULSE_US = 1500.0  # middle of the pulses for a servo or a motor's controller, us
_NO_DUTY = 100.0  # a full drive that is so large is none of a duty
_OVER = 1.001  # of full drive: what rounding may show
_FULL: Final = (255, 1023, 4095, 65535)  # usual numbers for full drive


def read_log(path: Path, log: LogFormat) -> list[Recording]:
    """Read a CSV file whose columns are those of ``log``; other columns are not read. One recording for each run in it.

    Separators, comments and decimal commas are as for ``read_csv``. Without a line of names the columns are numbered
    from 1; if there are no others than those of ``log``, they are time, drive, and position or velocity, in this order.
    What is no row is left out (``log_lines``). What wraps or lost its sign is put right
    (``log_mends``). A velocity is summed up to a position.

    The notes say which column was taken for what, and what was put right. Raises RecordingError.
    """
    text = CsvText.of(path)
    if len(text.rows) < MIN_ROWS:
        raise RecordingError(path, f"has {len(text.rows)} rows", f"record at least {FIT_ROWS}", text.line)
    text = text.with_decimal_points()
    first, rows, has_names = text.header, text.rows, bool(text.names)
    choices = log.columns()
    places = _places(path, text.line, first, has_names, choices)
    called = {place: first[place] if has_names else str(place + 1) for place in places.values()}
    quantity_at = {place: quantity for quantity, place in places.items()}
    table = CsvTable(
        text,
        tuple(OWN_NAMES[quantity_at[k]] if k in quantity_at else "" for k in range(len(first))),
        tuple(called.get(k, "") for k in range(len(first))),
        rows,
        frozenset(OWN_NAMES.values()),
    )
    if has_names:
        said = {q: (first[place], text.units[place] if text.units else "") for q, place in places.items()}
        if "drive" in said and says_current(*said["drive"]):
            cure = f"{CURRENT_CURE}; if this column holds that, rename it"
            raise RecordingError(path, f"column {shown(said['drive'][0])}: {CURRENT_CAUSE}", cure, text.line)
        _refuse_other_units(path, text.line, choices, said)
    raw, rows = table.of_log(text_notes := list(text.notes))
    for name, values in raw.items():
        if float(np.nanmax(np.abs(values))) > LARGEST:
            row = int(np.nanargmax(np.abs(values)))
            column = table.called[table.names.index(name)]
            raise RecordingError(path, f"column {column}: {values[row]:g} is too large", "correct this line", rows[row])
    notes = [*text_notes, _taken({q: called[place] for q, place in places.items()}, log)]
    if log.period_s is not None:
        raw["t_s"] = np.searchsorted(sorted([*text.rows, *text.torn]), rows).astype(np.float64)
    if log.run is None and log.period_s is None:
        _refuse_several(text, rows, raw["t_s"], set(range(len(first))) - set(places.values()))
    supply_V = log.supply_V
    guessed = [] if has_names or any(one.column is not None for one in choices.values()) else [_numbered(choices)]
    if log.servo is None:
        if log.direction is None and "y_rad" in raw:
            _refuse_middle(path, raw["u_V"], raw["y_rad"], log.most(choices["drive"].unit), rows)
        with _or_numbered(*guessed):
            raw["u_V"] = _drive_V(path, raw["u_V"], choices["drive"], log, rows, notes)
        if log.direction is not None:
            words = _words(path, text, text.line if has_names else None, rows, "direction", log.direction)
            ways = _ways(path, words, raw["u_V"], log.direction, rows, notes)
            raw["u_V"] = _directed(path, raw["u_V"], ways, log.direction, rows)
    else:
        supply_V = _supply_V(text, rows, first if has_names else (), log, notes)
    runs = _runs(path, table, text.line if has_names else None, raw, rows, log, notes)
    recordings = []
    for number, run in enumerate(runs, 1):
        source = path if len(runs) == 1 else path.with_name(f"{path.name} (run {number} of {len(runs)})")
        heard = notes if number == 1 else []
        own = {name: values[run] for name, values in raw.items()}
        lines = [rows[k] for k in run]
        with _or_numbered(*guessed):
            if log.servo is not None and supply_V is not None:
                recordings.append(_of_servo(source, own, lines, log, supply_V, heard))
            else:
                recordings.append(_recording(source, own, lines, log, heard))
    return recordings


@contextmanager
def _or_numbered(*numbered: str) -> Iterator[None]:
    """Errors inside say this, too, if there is something: how to number columns whose order was taken for granted."""
    try:
        yield
    except RecordingError as error:
        if not numbered:
            raise
        cure = f"{error.cure}; or, if the columns have another order, number them: {' '.join(numbered)}"
        raise RecordingError(error.path, error.cause, cure, error.line) from error


def _recording(source: Path, raw: Columns, rows: Sequence[int], log: LogFormat, notes: Sequence[str]) -> Recording:
    """One run as a recording: in s, V and rad, unwrapped; a velocity summed up to a position. Raises RecordingError."""
    notes, choices = list(notes), log.columns()
    raw = _in_place(log_mends.once(raw | {"line": np.array(rows)}, notes), log)
    rows = raw.pop("line").tolist()
    raw, rows = log_mends.in_order(raw | {"t_s": _times_s(raw, log, notes)}, rows, notes)
    t_s, u_V = log_mends.added_up(raw["t_s"], notes), raw["u_V"]
    require_rising(source, t_s, rows)
    reads: Reads = "angle"
    steps = None
    if "velocity" in choices:
        summed = _summed(source, raw, t_s, choices["velocity"], log, notes)
        y_rad, reads = summed.y_rad, "samples" if summed.adds_up else "speed"
        if summed.rows is not None:
            steps = (t_s, u_V)
            rows, t_s, u_V = [rows[k] for k in summed.rows], t_s[summed.rows], u_V[summed.rows]
    else:
        seen = np.flatnonzero(np.isfinite(raw["y_rad"]))
        if seen.size < MIN_ROWS:
            raise RecordingError(
                source, f"has {seen.size} rows with a position in a run", f"record at least {FIT_ROWS}", rows[0]
            )
        if seen.size < t_s.size:
            steps = (t_s, u_V)
            rows, t_s, u_V, raw["y_rad"] = [rows[k] for k in seen.tolist()], t_s[seen], u_V[seen], raw["y_rad"][seen]
        unit = choices["position"].unit
        scale = log.scale("position", unit)
        y_rad = scale * log_mends.unwrapped_position(raw["y_rad"], unit == "counts", 2.0 * np.pi / abs(scale), notes)
        if unit == "counts" and np.ptp(y_rad) > 2.0 * np.pi and np.all(raw["y_rad"] == np.round(raw["y_rad"])):
            reads = "counter"
    columns: Columns = {"t_s": t_s, "u_V": u_V, "y_rad": y_rad}
    recording = assembled(source, columns, rows, tuple(columns), notes)
    if "time" in choices:
        _refuse_other_clock(source, t_s, choices["time"])
    most_V = math.inf if log.most(choices["drive"].unit) is None else log.supply_V or math.inf
    return replace(recording, units_stated=True, drive_steps=steps, reads=reads, most_V=most_V)


def _of_servo(
    source: Path, raw: Columns, rows: Sequence[int], log: LogFormat, supply_V: float, notes: Sequence[str]
) -> Recording:
    """One run of a servo in its position mode: the drive by its law. Raises RecordingError."""
    assert log.servo is not None
    if log.servo.P is None:
        raise RecordingError(source, "does not say the servo's gain P", "give what its register held: --gain P")
    if not np.isfinite(raw["y_rad"]).all():
        line = rows[int(np.argmax(~np.isfinite(raw["y_rad"])))]
        raise RecordingError(source, "the position is empty: it makes the drive", "keep the rows that have one", line)
    notes, law, choices = list(notes), replace(log.servo, goal_first=log.drive_row < 0), log.columns()
    t_s = _times_s(raw, log, notes)
    require_rising(source, t_s, rows)
    y_rad, goal_rad = (
        np.asarray(log.scale(name, choices[name].unit) * raw[OWN_NAMES[name]]) for name in ("position", "goal")
    )
    return servo_recording(source, (t_s, y_rad, goal_rad), rows, (law, log.servo.P), supply_V, notes)


def servo_recording(
    source: Path,
    columns: tuple[Floats, Floats, Floats],
    rows: Sequence[int],
    law: tuple[ServoLaw, float],
    supply_V: float,
    notes: Sequence[str],
) -> Recording:
    """The log of a servo's own loop as a recording.

    columns  times, s, rising; positions and goals, rad
    rows     their lines
    law      of the servo, and its P
    Raises RecordingError where rows lie too far apart: between them the drive is that of the servo's loop.
    """
    t_s, y_rad, goal_rad = columns
    servo, P = law
    periods_s = np.diff(t_s)
    if (period_s := float(np.median(periods_s))) > _LONGEST_PERIOD_S:
        raise RecordingError(source, f"its rows are {period_s:.3g} s apart", "correct the unit of time, or log faster")
    if periods_s.max() > _LONGEST_PERIOD_S:
        k = int(np.argmax(periods_s))
        raise RecordingError(
            source, f"nothing says which goal it had in the {periods_s[k]:.3g} s before this row",
            "cut the log here, and give both parts", rows[k + 1],
        )  # fmt: skip
    t_s = t_s - servo.position_age_s
    edges_s, u_V, at_rows_V = servo.drive(P, t_s, y_rad, goal_rad, supply_V)
    scale = servo.scale
    said = (
        f"the drive is that of the servo's own law, P {P:g}, {supply_V:.3g} V: 1 rad makes {scale.middle * P:.3g} of it"
    )
    own: Columns = {"t_s": t_s, "u_V": at_rows_V, "y_rad": y_rad}
    return replace(
        assembled(source, own, rows, tuple(own), (*notes, f"{said} ({scale.source})")),
        units_stated=True,
        drive_steps=(edges_s, u_V),
        own_loop=OwnLoop(scale, scale.middle * P * supply_V, servo.is_P_alone),
    )


def _supply_V(text: CsvText, rows: Sequence[int], names: Sequence[str], log: LogFormat, notes: list[str]) -> float:
    """What --supply-V says, else the median of the only column that is called like a voltage. Raises RecordingError."""
    if log.supply_V is not None:
        return log.supply_V
    places = [k for k, name in enumerate(names) if any(word in USUAL_SUPPLY for word in words_of(name)[:1])]
    if len(places) != 1:
        raise RecordingError(
            text.path, "has no column, or several, of the supply's voltage", "give the volts at the servo: --supply-V 5"
        )
    fields = [text.fields(row) for row in rows]
    values = [float(one[places[0]]) for one in fields if len(one) > places[0] and is_number(one[places[0]])]
    supply_V = float(np.median(values)) if values else 0.0
    if not 0.0 < supply_V < LARGEST:
        raise RecordingError(text.path, f"column {shown(names[places[0]])} holds no voltage", "give --supply-V")
    notes.append(f"the supply is the median of column {names[places[0]]}, {supply_V:.3g} V")
    return supply_V


def _in_place(raw: Columns, log: LogFormat) -> Columns:
    """The columns with drives and times in the rows where they belong; the rows at the ends that lack one go."""
    off = {"u_V": log.drive_row, "t_s": log.time_row}
    first, last = max(0, *off.values()), min(0, *off.values())
    count = raw["u_V"].size - first + last
    return {
        name: values[first - off.get(name, 0) : first - off.get(name, 0) + max(count, 0)]
        for name, values in raw.items()
    }


def _times_s(raw: Columns, log: LogFormat, notes: list[str]) -> Floats:
    """The times in s, as they go on where the clock begins anew."""
    if log.period_s is not None:
        return np.asarray(log.period_s * raw["t_s"])
    second_s = log.scale("time", log.columns()["time"].unit)
    motion = raw["y_rad"] if "y_rad" in raw else raw["v_rad_per_s"]
    return np.asarray(second_s * log_mends.unwrapped_clock(raw["t_s"], motion, 1.0 / second_s, notes))


def _summed(
    path: Path, raw: Columns, t_s: Floats, column: LogColumn, log: LogFormat, notes: list[str]
) -> log_mends.Summed:
    """The position from velocities. Raises RecordingError."""
    v, u_V = log_mends.signed(raw["v_rad_per_s"], None, "velocities", notes), raw["u_V"]
    unwrapped = log_mends.unwrapped_velocity(v, u_V, notes)
    if unwrapped is None:
        raise RecordingError(
            path,
            "the velocity jumps by most of what a number of 16 bits can be: it wraps, and nobody can tell how often",
            "log it as a number of 32 bits, or log the position",
        )
    if log_mends.has_no_sign(unwrapped, u_V):
        raise RecordingError(
            path,
            "the velocity is never negative, and as large after negative drives as after positive ones: its sign is "
            "missing",
            "log the velocity with its sign, or better the position",
        )
    if (end := log_mends.cut_off_at(unwrapped)) is not None:
        raise RecordingError(
            path,
            f"the velocity jumps to {end:.5g} again and again, and stays there to the last digit: it is cut off",
            "record with smaller drives, let the sensor or its number reach farther, or log the position",
        )
    scale = log.scale("velocity", column.unit)
    summed = log_mends.summed_up(scale * unwrapped, t_s, notes, 0.5 * abs(scale) * log_mends.last_digit(unwrapped))
    if not summed.is_of_counter and log_mends.is_of_one_count(unwrapped, t_s):
        raise RecordingError(
            path,
            "each velocity is one count over the time that it took, and stands until the next one, or is a few ticks: "
            "between counts nobody can tell how the shaft turned",
            "log the counts themselves, or the time between counts with a finer clock and a finer encoder",
        )
    return summed


def _drive_V(path: Path, u: Floats, one: LogColumn, log: LogFormat, rows: Sequence[int], notes: list[str]) -> Floats:
    """The drives in V, with their signs. Raises RecordingError for one that no bridge gives."""
    most = log.most(one.unit)
    u = log_mends.signed(u, most, "drives", notes)
    if most is not None and float(np.abs(u).max()) > most * _OVER + (one.unit == "pwm"):
        k = int(np.argmax(np.abs(u)))
        largest = abs(float(u[k]))
        if one.unit == "pwm":
            full = next((size for size in _FULL if size >= largest), math.ceil(largest))
            cause, cure = f"and --full says {most:g}", f"give the number that means full drive, such as --full {full:g}"
        else:
            cause, cure = f"and in {one.unit} full drive is {most:g}", "give the unit that it is in"
            if one.unit == "duty" and largest <= 100.0 * _OVER:
                cure += ", such as per cent: --drive COLUMN:percent"
        raise RecordingError(
            path,
            f"the drive is {u[k]:g}, {cause}",
            f"{cure}; or, if this is a command that the bridge limits, log what the bridge gave",
            rows[k],
        )
    largest = float(np.abs(u).max())
    if most is not None and most >= _NO_DUTY and largest <= 1.0 and u.size >= FIT_ROWS and np.any(u != np.round(u)):
        cause = f"the drive is a fraction, at most {largest:g}, and in {one.unit} full drive is {most:g}"
        raise RecordingError(path, cause, "give the unit that it is in, such as --drive COLUMN:duty", rows[0])
    if most is not None and one.unit == "pwm" and largest in _FULL and largest < most:
        notes.append(
            f"the drive is {largest:g} at most, full drive in {int(largest).bit_length()} bits, and --full says "
            f"{most:g}: is it --full {largest:g}? Then K is {largest / most:.2g} times as large"
        )
    return np.asarray(log.scale("drive", one.unit) * u)


def _refuse_several(text: CsvText, rows: Sequence[int], t: Floats, others: set[int]) -> None:
    """Refuse a log in which each time stands in several rows, and another column tells these apart: several motors."""
    each = int(np.argmax(np.diff(t, append=np.inf) != 0.0)) + 1
    if each == 1 or t.size < 2 * each or np.any(np.diff(t[: t.size // each * each].reshape(-1, each)) != 0.0):
        return
    seen = [text.fields(row) for row in rows[: 3 * each]]
    for k in sorted(others):
        words = [fields[k] for fields in seen]
        if len(set(words[:each])) == each and all(word == words[n % each] for n, word in enumerate(words)):
            called = shown(text.names[k]) if text.names else str(k + 1)
            above, mark = text.line - (0 if text.names else 1), text.delimiter
            kept = words[0] if is_number(words[0]) else f'"{words[0]}"'
            one = quote(f"NR <= {above} || ${k + 1} == {kept}")
            raise RecordingError(
                text.path, f"column {called} says {each} things at each time: {each} motors in turn, or more",
                f"keep one of them: awk -F {quote(mark)} {one} {quote(str(text.path))} > one.csv", rows[0],
            )  # fmt: skip


def _refuse_middle(path: Path, u: Floats, y: Floats, full: float | None, rows: Sequence[int]) -> None:
    """Refuse a drive evenly about half of full drive, or 1500 us of a pulse, never near 0, that turns both ways."""
    middle = 0.5 * (float(u.min()) + float(u.max()))
    if full is None or u.size < FIT_ROWS or u.min() < _SIGNED * full:
        return
    zeros = (0.5 * full, _PULSE_US) if _PULSE_US < full < 2.0 * _PULSE_US else (0.5 * full,)
    if all(abs(middle - zero) > _HALF * full for zero in zeros):
        return
    moved = np.diff(y)
    moved = np.where(np.isfinite(moved), moved, 0.0)
    to_and_fro = min(float(moved[moved > 0.0].sum()), -float(moved[moved < 0.0].sum()))
    away = float(np.hypot.reduce(u[:-1] - middle) * np.hypot.reduce(moved))
    if to_and_fro > _TO_AND_FRO * float(np.abs(moved).sum()) and abs(float((u[:-1] - middle) @ moved)) > _TURNS * away:
        raise RecordingError(
            path, f"the drive lies evenly about {middle:g}, and turns the shaft both ways: that is its 0 V",
            f"subtract {middle:g} from it, and say what is left at full drive: --full {abs(full - middle):g}", rows[0],
        )  # fmt: skip


def _runs(
    path: Path, table: CsvTable, header: int | None, raw: Columns, rows: Sequence[int], log: LogFormat, notes: list[str]
) -> list[Integers]:
    """The rows of each run in the file, counted from 0. Raises RecordingError."""
    if log.run is not None:
        names = _words(path, table.text, header, rows, "run", log.run)
        found, begins, counts = np.unique(names, return_index=True, return_counts=True)
        if counts.min() < MIN_ROWS:
            k = int(np.argmin(counts))
            cause = f"column {shown(log.run)} says {shown(str(found[k]))} in fewer than {MIN_ROWS} rows: that is no run"
            cure = "give the column that says which run a row is of: --run COLUMN; or delete these lines"
            raise RecordingError(path, cause, cure, rows[int(begins[k])])
        return [np.flatnonzero(names == found[k]) for k in np.argsort(begins)]
    if log.period_s is None:
        motion = raw["y_rad"] if "y_rad" in raw else raw["v_rad_per_s"]
        second = 1.0 if log.time is None else 1.0 / log.scale("time", log.time.unit)
        times = log_mends.unwrapped_clock(raw["t_s"], motion, second, [])
        runs = log_mends.runs_of(times)
        if log.time_row:  # the first time is another row's
            runs[0] = slice(0, runs[0].stop)
        elif (gone := runs[0].start) > 0:
            notes.append(f"the time begins anew in line {rows[gone]}: {gone} rows before it were left out")
    else:
        position = raw.get(
            "y_rad", np.full(len(rows), np.nan)
        )  # a velocity is where it began whenever the shaft stands
        runs = log_mends.runs_without_time(position, table.text.interrupted(rows), table.others(rows))
        if len(runs) > 1:
            lines = ", ".join(str(rows[run.start]) for run in runs)
            notes.append(f"{len(runs)} runs, one after the other, begin in lines {lines}")
    return [np.arange(run.start, run.stop) for run in runs]


def _words(
    path: Path, text: CsvText, header: int | None, rows: Sequence[int], option: str, column: str
) -> NDArray[np.str_]:
    """What a column that somebody named or numbered says in each of these lines. Raises RecordingError."""
    line = rows[0] if header is None else header
    place = _named_place(path, line, text.header, header is not None, option, column)
    return np.array([fields[place] if place < len(fields) else "" for fields in map(text.fields, rows)])


def _ways(
    path: Path, words: NDArray[np.str_], u_V: Floats, column: str, rows: Sequence[int], notes: list[str]
) -> Floats:
    """1 or -1 for each row: which way its drive acts, by a column of two words; what stands at no drive says nothing.

    The larger number is the positive way, or the word that is not reverse, backward, ccw or a minus. A word that most
    rows lack was written where it changed. A log of one way may have one word. Raises RecordingError.
    """
    back = ("R", "B", "-", "CC", "LO", "FALSE", "OFF", "NEG")  # reverse, backward, counter-clockwise, low
    words = np.array([f"{float(word) + 0.0:g}" if is_number(word) else word for word in words.tolist()])
    lacks, drives = np.isin(words, ("", "nan")), (u_V != 0.0) | (not np.any(u_V))
    if float(np.mean(lacks)) > EVENTS:
        words = words[np.maximum.accumulate(np.where(lacks, 0, np.arange(words.size)))]
        lacks = np.isin(words, ("", "nan"))
    lacks &= drives
    if lacks.any():
        raise RecordingError(
            path, f"column {column}: is empty", "fill it in or delete this line", rows[int(np.argmax(lacks))]
        )
    there = sorted(
        set(words[drives].tolist()),
        key=lambda word: (float(word) if is_number(word) else 0.0, not word.upper().startswith(back), word),
    )
    if len(there) == 1 and there[0] != "0":
        is_back = there[0].upper().startswith(back)
        notes.append(
            f"the drive is {'negative' if is_back else 'positive'}: column {column} says {there[0]} throughout"
        )
        return np.full(words.size, -1.0 if is_back else 1.0)
    if len(there) != 2 and not (len(there) == 3 and there[1] == "0"):
        cause = f"column {shown(column)} says {len(there)} things, such as {', '.join(map(shown, there[:3]))}"
        raise RecordingError(path, cause, "give the column that says one of two directions: --direction COLUMN")
    notes.append(f"the drive is positive where column {column} says {there[-1]}, and negative where {there[0]}")
    return np.where(words == there[-1], 1.0, np.where(words == there[0], -1.0, 0.0))


def _directed(path: Path, u_V: Floats, ways: Floats, column: str, rows: Sequence[int]) -> Floats:
    """Drives with the sign that a column of directions gives. Raises RecordingError where they have another one."""
    against = ways * u_V < -_SIGNED * float(np.abs(u_V).max())
    if against.any() and u_V.min() < 0.0:
        cause = f"the drive has a sign of its own, and column {shown(column)} says the other way here"
        cure = "leave --direction out; or, if that column is right, log the drive without its sign"
        raise RecordingError(path, cause, cure, rows[int(np.argmax(against))])
    return np.asarray(ways * np.abs(u_V))


def _refuse_other_units(
    path: Path, line: int, choices: Mapping[str, LogColumn], said_of: Mapping[str, tuple[str, str]]
) -> None:
    """Refuse a column that says another unit than the one given, unless somebody said which column it is.

    said_of  of each quantity, the name of its column and what a row of units says of it
    """
    for quantity, (name, of_units) in said_of.items():
        given = choices[quantity]
        said = units_of_column(name, of_units, quantity)
        if given.column is None and said and given.unit not in said:
            units = " or ".join(sorted(said))
            by_row = said != units_said(name, quantity)
            words = (
                f"column {shown(name)} {f'is in {units}, by the row of units' if by_row else f'sounds like {units}'}"
            )
            raise RecordingError(
                path,
                f"{words}, and --{quantity} says {given.unit}",
                f"type --{quantity} {min(said)}; or, if it is in {given.unit}: --{quantity} "
                + quote(f"{name}:{given.unit}"),
                line,
            )


def _refuse_other_clock(path: Path, t_s: Floats, given: LogColumn) -> None:
    """Refuse times in a unit in which no log of a motor has its samples, where another unit would do."""
    period_s = float(np.median(np.diff(t_s)))
    if t_s.size < FIT_ROWS or _SHORTEST_PERIOD_S <= period_s <= _LONGEST_PERIOD_S:
        return
    units = {unit: s for unit, s in UNITS["time"].items() if s is not None}
    scaled = {unit: period_s * s / units[given.unit] for unit, s in units.items()}
    others = [unit for unit, s in scaled.items() if _SHORTEST_PERIOD_S <= s <= _LONGEST_PERIOD_S]
    if others:
        column = "" if given.column is None else f"{given.column}:"
        types = " or ".join(f"--time {column}{unit}" for unit in others)
        raise RecordingError(path, f"in {given.unit} its samples are {period_s:.3g} s apart", f"type {types}")


def _places(
    path: Path, line: int, first: Sequence[str], has_names: bool, choices: Mapping[str, LogColumn]
) -> dict[str, int]:
    """The place of each quantity's column, from 0. Raises RecordingError."""
    if not has_names and all(one.column is None for one in choices.values()) and len(first) == len(choices):
        return {quantity: k for k, quantity in enumerate(choices)}
    if len(first) < len(choices):
        named = f" ({', '.join(map(shown, first))})" if has_names else ""
        cause = f"has {len(first)} columns{named}, and {', '.join(choices)} are {len(choices)}"
        cure = "add what is missing: a drive that stayed as it was is a column, too"
        raise RecordingError(path, cause, cure, line)
    places: dict[str, int] = {}
    # columns that are named come first: others are looked for among what is left
    for quantity, one in sorted(choices.items(), key=lambda item: item[1].column is None):
        if one.column is None and not has_names:
            raise RecordingError(
                path, f"has {len(first)} columns without names", f"number them from 1: {_numbered(choices)}", line
            )
        place = (
            _usual_place(path, line, first, quantity, one, set(places.values()))
            if one.column is None
            else _named_place(path, line, first, has_names, quantity, one.column)
        )
        if place in places.values():
            other = next(name for name, taken in places.items() if taken == place)
            raise RecordingError(
                path, f"{shown(first[place])} is both {other} and {quantity}", _say_which(quantity, first), line
            )
        places[quantity] = place
    return {quantity: places[quantity] for quantity in choices}


def _named_place(path: Path, line: int, first: Sequence[str], has_names: bool, quantity: str, column: str) -> int:
    """The place of a column that the user named or numbered."""
    if has_names and column in first:
        if list(first).count(column) > 1:
            unit = ":UNIT" if quantity in UNITS else ""
            raise RecordingError(path, f"has column {column} twice", f"number it: --{quantity} 1{unit}", line)
        return list(first).index(column)
    if column.isdecimal() and 1 <= int(column) <= len(first):
        return int(column) - 1
    there = f"there are: {', '.join(map(shown, first[:20]))}" if has_names else f"it has {len(first)}, without names"
    raise RecordingError(
        path, f"has no column {column}; {there}", _say_which(quantity, first if has_names else ()), line
    )


def _usual_place(path: Path, line: int, first: Sequence[str], quantity: str, one: LogColumn, taken: set[int]) -> int:
    """The place of the only column with a usual name of this quantity."""
    free = [k for k in range(len(first)) if k not in taken]
    usual = usual_places(["" if k in taken else name for k, name in enumerate(first)], quantity, one.unit)
    if len(usual) == 1:
        return usual[0]
    currents = [first[k] for k in free if quantity == "drive" and says_current(first[k])]
    if currents and not usual:
        raise RecordingError(path, f"column {shown(currents[0])}: {CURRENT_CAUSE}", CURRENT_CURE, line)
    if usual:
        cause = f"several columns may be the {quantity}: {', '.join(shown(first[k]) for k in usual[:20])}"
    else:
        cause = f"no column is called like a {quantity}; there are: {', '.join(map(shown, first[:20]))}"
    raise RecordingError(path, cause, _say_which(quantity, [first[k] for k in usual or free]), line)


def _say_which(quantity: str, names: Sequence[str]) -> str:
    """What to type to name a column."""
    known = USUAL_NAMES.get(quantity, ())
    usual = [name for name in names if any(len(word) > 1 and word in known for word in words_of(name))]
    rivals = {"time", "drive", "position"} - {quantity}  # no velocity: many a sketch calls its PWM speed
    free = [name for name in names if not any(sounds_like(name, rival) for rival in rivals)]
    name = next((name for name in (*usual, *free, *names) if name), "1")
    if quantity not in UNITS:  # a direction, or a run
        return f"say which, for example --{quantity} {quote(name)}"
    named, units = quote(f"{name}:UNIT"), ", ".join(UNITS[quantity])
    cure = f"say which, for example --{quantity} {named}, with one of the units {units}"
    if quantity == "time" and not usual:
        return f"type --period 10ms, with your own time from row to row, in place of --time; or {cure}"
    return cure


def _numbered(choices: Mapping[str, LogColumn]) -> str:
    return " ".join(f"--{quantity} {k}:{one.unit}" for k, (quantity, one) in enumerate(choices.items(), 1))


def _taken(called: Mapping[str, str], log: LogFormat) -> str:
    """One sentence: which column is what, in which unit."""
    beside = {
        "pwm": f"{log.full:g} is {log.supply_V:g} V" if log.full and log.supply_V else "",
        "duty": f"1 is {log.supply_V:g} V" if log.supply_V else "",
        "percent": f"100 is {log.supply_V:g} V" if log.supply_V else "",
        "counts": f"{log.counts_per_turn:g} a turn" if log.counts_per_turn else "",
        "counts/s": f"{log.counts_per_turn:g} counts a turn" if log.counts_per_turn else "",
    }
    parts = [] if log.period_s is None else [f"each row is {log.period_s:g} s after the one before"]
    for quantity, one in log.columns().items():
        more = f" ({beside[one.unit]})" if beside.get(one.unit) else ""
        parts.append(f"{quantity} is column {called[quantity]}, {one.unit}{more}")
    parts += ["reversed"] if log.reversed else []
    for name, rows in (("drive", log.drive_row), ("time", log.time_row)):
        if rows:
            parts.append(f"the {name} was moved {'up' if rows < 0 else 'down'} by {abs(rows)}")
    return "; ".join(parts)
