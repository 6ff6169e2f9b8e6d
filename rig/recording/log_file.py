"""Reads somebody's own log: a CSV file with any columns and units, with or without a line of column names.

For any content of the file the result is a ``Recording``, or a ``RecordingError`` with file, line and one cure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from rig.recording.csv_table import CsvTable, CsvText, is_number, shown
from rig.recording.errors import RecordingError
from rig.recording.log_format import LARGEST, OWN_NAMES, UNITS, LogColumn, LogFormat, sounds_like, units_said
from rig.recording.recording import MIN_ROWS, Columns, Floats, Recording, assembled

_LONGEST_PERIOD_S, _SHORTEST_PERIOD_S = 0.5, 20e-6  # between samples; rig/identify/plausibility.py refuses others
_FEWEST_ROWS = 22  # fewer are no recording to be fitted
_FEW_STEPS, _FEWEST_MOVES = 10.5, 10  # of a counter, between two rows, for a velocity to show them
_CLOCK_TURNS: Final = 2.0**32  # millis() and micros() of an Arduino
_COUNTER_TURNS: Final = 2.0**16  # counts in an int of a small chip


def read_log(path: Path, log: LogFormat) -> Recording:
    """Read a CSV file whose columns are those of ``log``; other columns are not read.

    Separators, comments and decimal commas are as for ``read_csv``. Without a line of names the columns are numbered
    from 1; if there are no others than those of ``log``, they are time, drive, and position or velocity, in this order.
    A first line with fewer fields than the second is torn, and is left out. A clock of 32 bits may begin anew, a
    counter of 16 bits may wrap, and so may an angle within one turn. A velocity is summed up to a position.

    The notes say which column was taken for what. Raises RecordingError.
    """
    text = CsvText.of(path)
    numbers, notes = text.numbers, list[str]()
    if len(numbers) > 1 and len(text.fields(numbers[0])) < len(text.fields(numbers[1])):
        notes.append(f"line {numbers[0]}, the first, is torn and was left out")
        numbers = numbers[1:]
    first = text.fields(numbers[0])
    has_names = not all(is_number(field) for field in first if field)
    rows = numbers[1:] if has_names else numbers
    if len(rows) < MIN_ROWS:
        raise RecordingError(path, f"has {len(rows)} rows", f"record at least {MIN_ROWS}", numbers[0])
    text = text.with_decimal_points(rows)
    choices = log.columns()
    places = _places(path, numbers[0], first, has_names, choices)
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
        _refuse_other_units(path, numbers[0], choices, said)
    raw = table.columns()
    for name, values in raw.items():
        if float(np.abs(values).max()) > LARGEST:
            row = int(np.argmax(np.abs(values)))
            column = table.called[table.names.index(name)]
            raise RecordingError(path, f"column {column}: {values[row]:g} is too large", "correct this line", rows[row])
    notes = [*text.notes, *notes, _taken(choices, {q: called[place] for q, place in places.items()}, log)]
    columns = _in_own_units(raw, choices, log, notes)
    names = tuple(columns)
    try:
        recording = assembled(path, columns, rows, notes=tuple(notes), columns_present=names, units_stated=True)
    except RecordingError as error:
        if has_names or any(one.column is not None for one in choices.values()):
            raise
        cure = f"{error.cure}; or, if the columns have another order, number them: {_numbered(choices)}"
        raise RecordingError(path, error.cause, cure, error.line) from error
    _refuse_other_clock(path, columns["t_s"], choices["time"])
    return recording


def _refuse_other_units(
    path: Path, line: int, choices: Mapping[str, LogColumn], said_of: Mapping[str, tuple[str, str]]
) -> None:
    """Refuse a column that says another unit than the one given, unless somebody said which column it is.

    said_of  of each quantity, the name of its column and what a row of units says of it
    """
    for quantity, (name, of_units) in said_of.items():
        given = choices[quantity]
        said = {of_units} & UNITS[quantity].keys()
        said = said or units_said(name, quantity)
        if given.column is None and said and given.unit not in said:
            raise RecordingError(
                path,
                f"column {shown(name)} sounds like {' or '.join(sorted(said))}, and --{quantity} says {given.unit}",
                f"type --{quantity} {min(said)}; or, if it is in {given.unit}: --{quantity} "
                + (f"'{name}:{given.unit}'" if " " in name else f"{name}:{given.unit}"),
                line,
            )


def _refuse_other_clock(path: Path, t_s: Floats, given: LogColumn) -> None:
    """Refuse times in a unit in which no log of a motor has its samples, where another unit would do."""
    period_s = float(np.median(np.diff(t_s)))
    if t_s.size < _FEWEST_ROWS or _SHORTEST_PERIOD_S <= period_s <= _LONGEST_PERIOD_S:
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
    places: dict[str, int] = {}
    # columns that are named come first: others are looked for among what is left
    for quantity, one in sorted(choices.items(), key=lambda item: item[1].column is None):
        if one.column is None and not has_names:
            raise RecordingError(
                path,
                f"has {len(first)} columns without names",
                f"number them from 1: {_numbered(choices)}",
                line,
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
            raise RecordingError(path, f"has column {column} twice", f"number it: --{quantity} 1:UNIT", line)
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
    exact = [k for k in free if first[k] in (OWN_NAMES[quantity], one.unit)]
    usual = exact or [k for k in free if sounds_like(first[k], quantity)]
    if len(usual) == 1:
        return usual[0]
    if usual:
        cause = f"several columns may be the {quantity}: {', '.join(shown(first[k]) for k in usual[:20])}"
    else:
        cause = f"no column is called like a {quantity}; there are: {', '.join(map(shown, first[:20]))}"
    raise RecordingError(path, cause, _say_which(quantity, [first[k] for k in usual or free]), line)


def _say_which(quantity: str, names: Sequence[str]) -> str:
    """What to type to name a column."""
    usual = [name for name in names if sounds_like(name, quantity)]
    name = next((name for name in (*usual, *names) if name), "1")
    quoted = f"'{name}:UNIT'" if " " in name else f"{name}:UNIT"
    return f"say which, for example --{quantity} {quoted}, with one of the units {', '.join(UNITS[quantity])}"


def _numbered(choices: Mapping[str, LogColumn]) -> str:
    return " ".join(f"--{quantity} {k}:{one.unit}" for k, (quantity, one) in enumerate(choices.items(), 1))


def _taken(choices: Mapping[str, LogColumn], called: Mapping[str, str], log: LogFormat) -> str:
    """One sentence: which column is what, in which unit."""
    beside = {
        "pwm": f"{log.full:g} is {log.supply_V:g} V" if log.full and log.supply_V else "",
        "duty": f"1 is {log.supply_V:g} V" if log.supply_V else "",
        "percent": f"100 is {log.supply_V:g} V" if log.supply_V else "",
        "counts": f"{log.counts_per_turn:g} a turn" if log.counts_per_turn else "",
        "counts/s": f"{log.counts_per_turn:g} counts a turn" if log.counts_per_turn else "",
    }
    parts = []
    for quantity, one in choices.items():
        more = f" ({beside[one.unit]})" if beside.get(one.unit) else ""
        parts.append(f"{quantity} is column {called[quantity]}, {one.unit}{more}")
    return "; ".join(parts) + ("; reversed" if log.reversed else "")


def _in_own_units(raw: Columns, choices: Mapping[str, LogColumn], log: LogFormat, notes: list[str]) -> Columns:
    """The columns in s, V and rad, unwrapped; a velocity summed up to a position."""
    scaled = {quantity: log.scale(quantity, one.unit) for quantity, one in choices.items()}
    t_s = scaled["time"] * _unwrapped_clock(raw["t_s"], choices["time"].unit, notes)
    columns: Columns = {"t_s": t_s, "u_V": scaled["drive"] * raw["u_V"]}
    if "velocity" in choices:
        columns["y_rad"] = _summed_up(scaled["velocity"] * raw["v_rad_per_s"], t_s, notes)
    else:
        unit = choices["position"].unit
        turn = 2.0 * np.pi / abs(scaled["position"])
        columns["y_rad"] = scaled["position"] * _unwrapped_position(raw["y_rad"], unit, turn, notes)
    return columns


def _summed_up(v_rad_per_s: Floats, t_s: Floats, notes: list[str]) -> Floats:
    """The position from velocities, rad, from 0 on.

    A velocity is the mean since the row before if it comes from a counter: then each row moves by whole steps. Else it
    is a sample, and in between it changes evenly.
    """
    periods_s = np.diff(t_s, prepend=t_s[0])
    moved = v_rad_per_s * periods_s
    steps = np.abs(moved[moved != 0.0])
    of_counter = False
    if steps.size:
        one = float(np.median(steps[steps < 1.5 * steps.min()]))
        few = steps[steps < _FEW_STEPS * one] / one
        of_counter = few.size >= _FEWEST_MOVES and float(np.mean(np.abs(few - np.round(few)) < 0.1)) > 0.9
    if of_counter:
        notes.append("the position is the sum of the velocities, from 0: each is the mean since the row before")
        return np.asarray(np.cumsum(moved))
    notes.append("the position is the integral of the velocities, from 0: each is a sample, as of a tachometer")
    middle = 0.5 * (v_rad_per_s[1:] + v_rad_per_s[:-1])
    return np.concatenate(([0.0], np.cumsum(middle * periods_s[1:])))


def _unwrapped_clock(t: Floats, unit: str, notes: list[str]) -> Floats:
    """Times of a clock of 32 bits that may have begun anew."""
    back = np.flatnonzero(np.diff(t) < -0.5 * _CLOCK_TURNS)
    if unit == "s" or back.size == 0 or t.max() >= _CLOCK_TURNS:
        return t
    notes.append("the clock, of 32 bits, began anew: the times go on")
    turns = np.zeros(t.size)
    turns[back + 1] = _CLOCK_TURNS
    return np.asarray(t + np.cumsum(turns))


def _unwrapped_position(y: Floats, unit: str, turn: float, notes: list[str]) -> Floats:
    """Positions without the jumps of a counter of 16 bits, or of an angle that begins anew after one turn."""
    low, high = float(y.min()), float(y.max())
    largest = float(np.abs(np.diff(y)).max())
    whole = bool(np.all(y == np.round(y)))
    if whole and unit == "counts" and largest > 0.5 * _COUNTER_TURNS and high - low < _COUNTER_TURNS:
        notes.append("the counter, of 16 bits, wrapped: the positions go on")
        return np.asarray(np.unwrap(y, period=_COUNTER_TURNS))
    if largest > 0.5 * turn and high - low <= turn * (1.0 + 1e-9):
        notes.append(
            "the positions stay within one turn and jump by most of it: they are an angle that wraps, and go on"
        )
        return np.asarray(np.unwrap(y, period=turn))
    return y
