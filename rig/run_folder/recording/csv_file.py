"""Reads a CSV file with at least the columns t_s, u_V and y_rad: samples.csv, or any other.

For any content of the file the result is a ``Recording``, or a ``RecordingError`` with file, line and one cure.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Final

import numpy as np

from rig.run_folder.recording.csv_table import CsvTable, CsvText
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_format import (
    CURRENT_CAUSE,
    CURRENT_CURE,
    OWN_NAMES,
    UNITS,
    USUAL_NAMES,
    says_current,
    sounds_like,
    units_of_column,
    units_said,
    usual_places,
    words_of,
)
from rig.run_folder.recording.log_lines import is_date, is_number, shown
from rig.run_folder.recording.log_mends import in_order, once, runs_of, unwrapped_clock
from rig.run_folder.recording.recording import FIT_ROWS, MIN_ROWS, Columns, Recording, assembled, require_rising
from rig.run_folder.recording.sample_columns import COLUMNS

REQUIRED: Final = ("t_s", "u_V", "y_rad")
_OR_SAY: Final = "say what the columns are (docs/any-csv.md), such as"
# What else a unit takes.
_FURTHER: Final = {
    "pwm": "--full 255 --supply-V 12",
    "duty": "--supply-V 12",
    "percent": "--supply-V 12",
    "counts": "--counts-per-turn 1440",
}
# Other common names of these columns, for "did you mean".
_OTHER_NAMES: Final = {
    "t_s": ("t", "time", "time_s", "times", "seconds", "sec", "timestamp", "t_ms", "time_ms"),
    "u_V": ("u", "voltage", "volt", "volts", "input", "drive", "command", "v_in", "control"),
    "y_rad": ("y", "position", "pos", "angle", "theta", "theta_rad", "output", "y_deg", "angle_deg", "phi"),
}


def read_csv(path: Path, *, own: bool = False, known: Recording | None = None) -> Recording:
    """Read a CSV file: a line of column names, then at least three rows; comma, semicolon, tab, | or blanks
    between.

    The file needs t_s, u_V and y_rad. It may have any other column of samples.csv, in any order. The names may stand
    behind a #, and a row of units may follow. The reader skips blank lines, lines that begin with #, and ``sep=``. It
    reads decimal commas if no comma separates columns and no decimal point occurs. A last line without a line end is
    torn: the reader leaves it out and notes that.
    own    whether the file is of a run folder: then it is no link; and it ends where its time stands still or goes
           back, with a note, because the device's clock did so
    known  this file as read earlier, perhaps with fewer rows: these are not parsed again
    Raises RecordingError.
    """
    columns, row_numbers, notes, header = _parsed(path, own, known)
    return assembled(path, columns, row_numbers, header, notes)


def read_csv_runs(path: Path) -> list[Recording]:
    """Read a CSV file as ``read_csv`` does; where its time begins again, another run begins.

    The drive stays where it is missing, and positions may be rarer than drives. Raises RecordingError.
    """
    columns, row_numbers, notes, header = _parsed(path, False, None)
    columns["t_s"] = unwrapped_clock(columns["t_s"], columns["y_rad"], 1.0, notes)
    runs = runs_of(columns["t_s"])
    recordings = []
    for number, run in enumerate(runs, 1):
        source = path if len(runs) == 1 else path.with_name(f"{path.name} (run {number} of {len(runs)})")
        heard = notes if number == 1 else []
        own = once(
            {"line": np.array(row_numbers[run]), **{name: values[run] for name, values in columns.items()}}, heard
        )
        own, lines = in_order(own, own.pop("line").tolist(), heard)
        require_rising(source, own["t_s"], lines)
        seen = np.flatnonzero(np.isfinite(own["y_rad"]))
        steps = None if seen.size == len(lines) else (own["t_s"], own["u_V"])
        if steps is not None:
            own, lines = {name: values[seen] for name, values in own.items()}, [lines[k] for k in seen.tolist()]
        recordings.append(replace(assembled(source, own, lines, header, heard), drive_steps=steps))
    return recordings


def _parsed(
    path: Path, own: bool, known: Recording | None
) -> tuple[Columns, Sequence[int], list[str], tuple[str, ...]]:
    """The columns, the lines of their rows, notes and the names of all columns; as in ``read_csv``."""
    text = CsvText.of(path, own=own)
    row_numbers = text.rows
    header = _parse_header(text)
    if len(row_numbers) < MIN_ROWS:
        raise RecordingError(path, f"has {len(row_numbers)} rows", f"record at least {FIT_ROWS}", text.line)
    text = text.with_decimal_points()
    _refuse_other_units(text, header)
    table = CsvTable(text, header, header, row_numbers, frozenset(REQUIRED))
    notes = list(text.notes)

    if known is not None and known.columns_present == header and len(known) <= len(row_numbers):
        read_before = {name: getattr(known, name) for name in header if name in COLUMNS}
        added = table.columns(len(known))
        columns = {
            name: np.concatenate([values, added[name]]) if added else values.copy()
            for name, values in read_before.items()
        }
    elif own:
        columns = table.columns()
    else:
        columns, row_numbers = table.of_log(notes)
    if own:
        columns = _while_time_rises(columns, row_numbers, notes)
        row_numbers = row_numbers[: len(columns["t_s"])]
    return columns, row_numbers, notes, header


def _parse_header(text: CsvText) -> tuple[str, ...]:
    """The names of the columns. Raises RecordingError."""
    path, line_number = text.path, text.line
    names = tuple(text.header)
    missing = [name for name in REQUIRED if name not in names]
    if missing and (is_number(names[0]) or (is_date(names[0]) and all(map(is_number, names[1:])))):
        timed = "--time ms" if is_number(names[0]) else "--period 10ms"
        raise RecordingError(
            path,
            "the first line has no column names",
            f"put t_s,u_V,y_rad (as they are) above; or {_OR_SAY} {timed} --drive pwm --position counts",
            line_number,
        )
    if missing:
        raise _lacking(text, names, missing)
    for name in names:
        if name in COLUMNS and names.count(name) > 1:
            raise RecordingError(path, f"has column {name} twice", "delete or rename one", line_number)
    return names


def _lacking(text: CsvText, names: Sequence[str], missing: Sequence[str]) -> RecordingError:
    """The error for columns that are not there: what they may be called, and what to type."""
    there = ", ".join(shown(name) for name in names[:20])
    own = {name: quantity for quantity, name in OWN_NAMES.items()}
    guesses = {name: guess for name in missing if (guess := _did_you_mean(name, own[name], names))}
    cause, line_number = f"has no column {', '.join(missing)}; there are: {there}", text.line
    currents = [name for name, unit in _with_units(names, text.units) if says_current(name, unit)]
    drives = [name for name in names if name not in currents and sounds_like(name, "drive")]
    if "u_V" in missing and "u_V" not in guesses and currents and not drives:
        return RecordingError(text.path, f"column {shown(currents[0])}: {CURRENT_CAUSE}", CURRENT_CURE, line_number)
    first_row = text.fields(text.rows[0]) if text.rows else []
    dates = "t_s" in guesses and any(map(is_date, first_row[names.index(guesses["t_s"]) :][:1]))
    options = {name: _option(own[name], guess, names, text.units) for name, guess in guesses.items()}
    free = [name for name in names if name not in (*COLUMNS, *guesses.values(), *currents)]
    if "y_rad" in missing and "y_rad" not in guesses:
        others = [name for name in free if not sounds_like(name, "goal")]
        speeds = [name for name in others if sounds_like(name, "velocity")]
        speeds += [name for name in others if (USUAL_NAMES["velocity"] - {"v"}).intersection(words_of(name))]
        speeds.sort(key=lambda name: not units_said(name, "velocity"))  # a PWM may be called speed, but no rpm
        options |= {"y_rad": _option("velocity", speeds[0], names, text.units)} if speeds else {}
        free = [name for name in free if name not in speeds[:1]]
    if options and free:  # what nothing tells is asked for, too
        left = free[0] if len(free) == 1 and len(names) == len(REQUIRED) else "COLUMN"
        options = {name: f"--{own[name]} {quote(f'{left}:UNIT')}" for name in missing if name != "t_s"} | options
        options = {name: options[name] for name in missing if name in options}
    if dates:  # a date is read as seconds
        options["t_s"] = f"--time {quote(guesses['t_s'] + ':s')}"
    hints = [f"{shown(guess)} for {name}" for name, guess in guesses.items()]
    cure = f"did you mean {', '.join(hints)}? Rename and use s, V, rad" if hints else "name them t_s, u_V, y_rad"
    if "t_s" in missing and "t_s" not in guesses:
        if len(missing) > 1 and not options:
            options = {"": "--drive pwm --position counts"}
        words = f"type {' '.join(['--period 10ms', *options.values()])}, with your own time from row to row"
        cure = f"{words}: no column is called like a time; or log the time"
    else:
        cure += f"; or {_OR_SAY} {' '.join(options.values()) or '--time ms --drive pwm --position counts'}"
    unsaid = [option.split()[0].strip("-") for option in options.values() if option.endswith(("UNIT", "UNIT'"))]
    if unsaid:
        cure += f", with the column's own unit for UNIT: of {', of '.join(map(_units_of, unsaid))}"
    typed = [option.rpartition(" ")[2].strip("'").rpartition(":")[2] for option in options.values()]
    further = [f"of {unit} also {_FURTHER[unit]}" for unit in typed if unit in _FURTHER]
    if further:
        cure += f"; {', '.join(further)}, with your own numbers"
    return RecordingError(text.path, cause, cure, line_number)


def _with_units(names: Sequence[str], units: Sequence[str]) -> list[tuple[str, str]]:
    """Each column's name with what the row of units says of it, empty without such a row."""
    return list(zip(names, units or [""] * len(names), strict=True))


def _refuse_other_units(text: CsvText, header: Sequence[str]) -> None:
    """Refuse a row of units that denies the unit in a column's name."""
    for name, unit in zip(header, text.units, strict=False):
        if name == "u_V" and says_current(name, unit):
            raise RecordingError(text.path, f"column u_V is in {unit}: {CURRENT_CAUSE}", CURRENT_CURE, text.line + 1)
        quantity = next((key for key, own in OWN_NAMES.items() if own == name), "")
        if name in REQUIRED and unit in UNITS[quantity] and not name.endswith(f"_{unit}"):
            cause = f"column {name} is in {shown(unit)}, by the row of units"
            cure = f"if it is, type --{quantity} {name}:{unit}; else correct the row of units"
            raise RecordingError(text.path, cause, cure, text.line + 1)


def _did_you_mean(name: str, quantity: str, there: Sequence[str]) -> str | None:
    """The column that may be ``name``: by a usual name, by a unit in its name, or by its spelling."""
    unclaimed = {other.lower(): other for other in there if other not in COLUMNS}
    if quantity == "drive":
        unclaimed = {key: other for key, other in unclaimed.items() if not says_current(other)}
    for other in (name.lower(), *_OTHER_NAMES[name]):
        if other in unclaimed:
            return unclaimed[other]
    of_name = [other for other in unclaimed.values() if sounds_like(other, quantity)]
    rivals = [q for q in USUAL_NAMES if q != quantity]
    free = [other for other in unclaimed.values() if not any(sounds_like(other, q) for q in rivals)]
    of_unit = [other for other in free if units_said(other, quantity)]
    for found in (of_name, of_unit):
        if len(found) == 1:
            return found[0]
    close = difflib.get_close_matches(name.lower(), [other[:100].lower() for other in free], n=1, cutoff=0.5)
    return unclaimed.get(close[0]) if close else None


def _option(quantity: str, name: str, names: Sequence[str], units: Sequence[str]) -> str:
    """The option that takes this column, in the unit that it says. No guess: a wrong one makes wrong numbers."""
    said = units_of_column(name, dict(_with_units(names, units))[name], quantity)
    unit = min(said) if len(said) == 1 else "UNIT"
    if unit != "UNIT" and [names[k] for k in usual_places(names, quantity, unit)] == [name]:
        return f"--{quantity} {unit}"
    return f"--{quantity} {quote(f'{name}:{unit}')}"


def _units_of(quantity: str) -> str:
    *others, last = UNITS[quantity]
    return f"{quantity} {', '.join(others)} or {last}"


def _while_time_rises(columns: Columns, numbers: Sequence[int], notes: list[str]) -> Columns:
    """The rows before the first one whose time does not rise; all rows if that would leave too few."""
    t_s = columns["t_s"]
    bad = np.flatnonzero(t_s[1:] <= t_s[:-1])
    if len(bad) == 0 or bad[0] + 1 < MIN_ROWS:
        return columns
    kept = int(bad[0]) + 1
    notes.append(
        f"line {numbers[kept]}: t_s = {t_s[kept]:.9g} after {t_s[kept - 1]:.9g}: the device's clock stood still or "
        f"went back; from there on {len(t_s) - kept} rows are left out"
    )
    return {name: values[:kept] for name, values in columns.items()}
