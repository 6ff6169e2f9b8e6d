"""Reads a CSV file with at least the columns t_s, u_V and y_rad: samples.csv, or any other.

For any content of the file the result is a ``Recording``, or a ``RecordingError`` with file, line and one cure.
"""

from __future__ import annotations

import csv
import difflib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from rig.recording.columns import COLUMNS, KINDS
from rig.recording.errors import RecordingError
from rig.recording.recording import MIN_ROWS, Column, Columns, Recording, assembled
from rig.recording.text_file import text_of, whole_content, without_torn_line
from rig.signals import plain

REQUIRED: Final = ("t_s", "u_V", "y_rad")
MAX_STAGE_LENGTH: Final = 64
_MAX_INTEGER: Final = 2.0**53  # a float cannot hold every integer beyond
_ROWS_AT_ONCE: Final = 4096
_DELIMITERS: Final = (",", ";", "\t")
_BLANKS: Final = " "  # the delimiter if none of those is in the header; any number of blanks
# First bytes of files that people often give in place of a CSV file: what the file is, and how to get a CSV file.
_NO_CSV: Final = {
    b"\x1f\x8b": ("is compressed (gzip)", "unpack it first: gunzip"),
    b"PK\x03\x04": ("is an Excel workbook or a zip file", "export the sheet as CSV in UTF-8, or unpack it"),
    b"\xff\xfe": ("is UTF-16 text", "save it as CSV in UTF-8"),
    b"\xfe\xff": ("is UTF-16 text", "save it as CSV in UTF-8"),
    b"\x89HDF": ("is an HDF5 file", "export t_s, u_V and y_rad as CSV"),
}

# Other common names of these columns, for "did you mean".
_OTHER_NAMES: Final = {
    "t_s": ("t", "time", "time_s", "times", "seconds", "sec", "timestamp", "t_ms", "time_ms"),
    "u_V": ("u", "voltage", "volt", "volts", "input", "drive", "command", "v_in", "control"),
    "y_rad": ("y", "position", "pos", "angle", "theta", "theta_rad", "output", "y_deg", "angle_deg", "phi"),
}


def read_csv(path: Path, *, own: bool = False, known: Recording | None = None) -> Recording:
    """Read a CSV file: a line of column names, then at least three rows; comma, semicolon, tab or blanks between.

    The file needs t_s, u_V and y_rad. It may have any other column of samples.csv, in any order. The reader skips blank
    lines, lines that begin with #, and Excel's ``sep=``. It reads decimal commas if no comma separates columns and no
    decimal point occurs. A last line without a line end is torn: the reader leaves it out and notes that.
    own    whether the file is of a run folder: then it ends where its time stands still or goes back, with a note,
           because the device's clock did so
    known  this file as read earlier, perhaps with fewer rows: these are not parsed again
    Raises RecordingError.
    """
    content, moved = whole_content(path)
    _check_magic(path, content)
    whole, notes = without_torn_line(path, _with_line_feeds(content))
    notes = [*moved, *notes]
    lines = text_of(path, whole).split("\n")
    numbers = [k for k, line in enumerate(lines, 1) if line.strip() and not line.startswith(("#", "sep="))]
    if not numbers:
        raise RecordingError(path, "holds no rows", "give a CSV file with a line of column names and rows below it")
    header_line, row_numbers = numbers[0], numbers[1:]
    delimiter = _delimiter(lines[header_line - 1])
    header = _parse_header(path, header_line, lines[header_line - 1], delimiter)
    if len(row_numbers) < MIN_ROWS:
        raise RecordingError(path, f"has {len(row_numbers)} rows", f"record at least {MIN_ROWS}", header_line)
    if delimiter != "," and _has_decimal_commas(lines, row_numbers):
        lines = [line.replace(",", ".") for line in lines]
        notes.append("decimal commas were read as decimal points")

    names = [name for name in header if name in COLUMNS]
    chunks: list[Columns] = []
    known_rows = 0
    if known is not None and known.columns_present == header and len(known) <= len(row_numbers):
        chunks, known_rows = [{name: getattr(known, name) for name in names}], len(known)
    for k in range(known_rows, len(row_numbers), _ROWS_AT_ONCE):
        chunks.append(_parse_rows(path, header, delimiter, lines, row_numbers[k : k + _ROWS_AT_ONCE]))
    columns = {name: np.concatenate([chunk[name] for chunk in chunks]) for name in names}
    if own:
        columns = _while_time_rises(columns, row_numbers, notes)
        row_numbers = row_numbers[: len(columns["t_s"])]
    return assembled(path, columns, row_numbers, notes=tuple(notes), columns_present=header)


def _check_magic(path: Path, content: bytes) -> None:
    for magic, (cause, cure) in _NO_CSV.items():
        if content.startswith(magic):
            raise RecordingError(path, cause, cure)


def _with_line_feeds(content: bytes) -> bytes:
    """The content with line feeds, if its lines end in carriage returns alone."""
    return content if b"\n" in content else content.replace(b"\r", b"\n")


def _delimiter(header: str) -> str:
    most = max(_DELIMITERS, key=header.count)
    return most if most in header or len(header.split()) < len(REQUIRED) else _BLANKS


def _has_decimal_commas(lines: Sequence[str], numbers: Sequence[int]) -> bool:
    """Whether numbers have decimal commas: no comma separates the columns, and rows have commas but no points."""
    commas = False
    for number in numbers:
        if "." in lines[number - 1]:
            return False
        commas = commas or "," in lines[number - 1]
    return commas


def _split(path: Path, line_number: int, line: str, delimiter: str) -> list[str]:
    """The fields of one line, without quotes and outer blanks."""
    if delimiter == _BLANKS:
        line = " ".join(line.split())
    if '"' not in line:
        return [field.strip() for field in line.split(delimiter)]
    try:
        fields = next(csv.reader([line.strip()], delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise RecordingError(
            path, f"has broken quotes ({error})", "correct or delete this line", line_number
        ) from error
    return [field.strip() for field in fields]


def _parse_header(path: Path, line_number: int, line: str, delimiter: str) -> tuple[str, ...]:
    names = tuple(_split(path, line_number, line, delimiter))
    missing = [name for name in REQUIRED if name not in names]
    if missing and _is_number(names[0]):
        raise RecordingError(
            path, "the first line has no column names", "put t_s,u_V,y_rad (as they are) above, without #", line_number
        )
    if missing:
        there = ", ".join(_shown(name) for name in names[:20])
        guesses = {name: _did_you_mean(name, names) for name in missing}
        hints = [f"{_shown(guess)} for {name}" for name, guess in guesses.items() if guess]
        cure = f"did you mean {', '.join(hints)}? Rename and use s, V, rad" if hints else "name them t_s, u_V, y_rad"
        raise RecordingError(path, f"has no column {', '.join(missing)}; there are: {there}", cure, line_number)
    for name in names:
        if name in COLUMNS and names.count(name) > 1:
            raise RecordingError(path, f"has column {name} twice", "delete or rename one", line_number)
    return names


def _did_you_mean(name: str, there: Sequence[str]) -> str | None:
    unclaimed = {other.lower(): other for other in there if other not in COLUMNS}
    for other in (name.lower(), *_OTHER_NAMES[name]):
        if other in unclaimed:
            return unclaimed[other]
    close = difflib.get_close_matches(name.lower(), [other[:100] for other in unclaimed], n=1, cutoff=0.5)
    return unclaimed.get(close[0]) if close else None


def _parse_rows(
    path: Path, header: tuple[str, ...], delimiter: str, lines: Sequence[str], numbers: Sequence[int]
) -> Columns:
    """Arrays of the known columns, from the lines with these numbers: by columns, and on any error line by line."""
    rows = [lines[number - 1] for number in numbers]
    plain = delimiter != _BLANKS and not any('"' in row for row in rows)
    fields = [
        row.split(delimiter) if plain else _split(path, number, row, delimiter)
        for number, row in zip(numbers, rows, strict=True)
    ]
    if any(len(row) != len(header) for row in fields):
        raise _broken_row(path, header, fields, numbers)
    by_column = zip(header, zip(*fields, strict=True), strict=True)
    try:
        return {name: _parse_column(name, texts) for name, texts in by_column if name in COLUMNS}
    except ValueError as error:
        raise _broken_row(path, header, fields, numbers) from error


def _parse_column(name: str, texts: Sequence[str]) -> Column:
    """One column as an array. Raises ValueError if a field breaks a rule of ``_complaint``."""
    if KINDS[name] == "name":
        if max(map(len, texts)) > MAX_STAGE_LENGTH:
            raise ValueError(name)
        return np.array([plain(text.strip()) for text in texts])
    may_be_empty = name not in REQUIRED and KINDS[name] != "integer"
    if may_be_empty:
        texts = [text if text and not text.isspace() else "nan" for text in texts]
    if "_" in "".join(texts):  # Python would read 1_0 as 10
        raise ValueError(name)
    values = np.array(list(map(float, texts)))
    usable = ~np.isinf(values) if may_be_empty else np.isfinite(values)
    if KINDS[name] == "integer":
        usable &= (np.abs(values) < _MAX_INTEGER) & (np.trunc(values) == values)
    if not usable.all():
        raise ValueError(name)
    return values.astype(np.int64) if KINDS[name] == "integer" else values


def _fields(count: int) -> str:
    return "1 field" if count == 1 else f"{count} fields"


def _broken_row(
    path: Path, header: Sequence[str], fields: Sequence[Sequence[str]], numbers: Sequence[int]
) -> RecordingError:
    """The error for the first row that breaks a rule."""
    for row, number in zip(fields, numbers, strict=True):
        if len(row) != len(header):
            return RecordingError(
                path, f"the line has {_fields(len(row))}, and the header {len(header)}", "correct or delete it", number
            )
        for name, text in zip(header, row, strict=True):
            complaint = _complaint(name, text.strip()) if name in COLUMNS else ""
            if complaint:
                return RecordingError(path, f"column {name}: {complaint}", _cure(text.strip()), number)
    return RecordingError(path, "cannot be read as numbers", "save it as plain CSV", numbers[0])


def _complaint(name: str, text: str) -> str:
    """What is wrong with one field; empty if it is right."""
    if KINDS[name] == "name":
        return f"a name of {len(text)} characters" if len(text) > MAX_STAGE_LENGTH else ""
    if not text:
        return "is empty" if name in REQUIRED or KINDS[name] == "integer" else ""
    if not _is_number(text):
        return f"{_shown(text)} is not a number"
    value = float(text)
    if math.isinf(value) or (math.isnan(value) and (name in REQUIRED or KINDS[name] == "integer")):
        return f"{_shown(text)} is not a finite number"
    if KINDS[name] == "integer" and not (value == math.trunc(value) and abs(value) < _MAX_INTEGER):
        return f"{_shown(text)} is not an integer"
    return ""


def _cure(text: str) -> str:
    if not text:
        return "fill it in or delete this line"
    if "," in text and _is_number(text.replace(",", ".")):
        return "use a decimal point"
    return "correct or delete this line"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _shown(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:40] + "...")


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
