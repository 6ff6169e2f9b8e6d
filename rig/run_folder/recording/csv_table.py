"""A CSV file as a table: its lines, what separates them into fields, its column names, and its columns as arrays.

For any content of the file the result is an array, or a ``RecordingError`` with file, line and one cure.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Final

import numpy as np

from rig.core.signals import plain
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_format import ALL_UNITS, USUAL_NAMES, sounds_like
from rig.run_folder.recording.recording import Column, Columns
from rig.run_folder.recording.sample_columns import COLUMNS, KINDS
from rig.run_folder.recording.text_file import lines_of, whole_content, without_torn_line

MAX_STAGE_LENGTH: Final = 64
_MAX_INTEGER: Final = 2.0**53  # a float cannot hold every integer beyond
_ROWS_AT_ONCE: Final = 4096
_COMMENTS: Final = "#%"
_NO_UNIT: Final = {"", "-", "1"}
_DELIMITERS: Final = (",", ";", "\t", "|")
_DATE: Final = re.compile(r"\d{4}-\d\d?-\d\d?|\d\d?\.\d\d?\.\d{4}|\d\d?:\d\d")  # the begin of a date or a time of day
_WITH_UNIT: Final = re.compile(r"([+-]?[0-9.]+(e[+-]?[0-9]+)?)\s*([^\W\d_]+|%|°)", re.IGNORECASE)
_FEWEST_COLUMNS: Final = 3
_BLANKS: Final = " "  # the delimiter if none of those is in the first line; any number of blanks
# First bytes of files that people often give in place of a CSV file: what the file is, and how to get a CSV file.
_NO_CSV: Final = {
    b"\x1f\x8b": ("is compressed (gzip)", "unpack it first: gunzip"),
    b"PK\x03\x04": ("is an Excel workbook or a zip file", "export the sheet as CSV in UTF-8, or unpack it"),
    b"\xff\xfe": ("is UTF-16 text", "iconv -f UTF-16 -t UTF-8 {path} > plain.csv"),
    b"\xfe\xff": ("is UTF-16 text", "iconv -f UTF-16 -t UTF-8 {path} > plain.csv"),
    b"PAR1": (
        "is parquet, as LeRobot's data sets are",
        'pip install pandas pyarrow, and python -c "import sys, pandas as p; t = p.read_parquet(sys.argv[1]); '
        "p.concat([p.DataFrame(t[c].tolist()).add_prefix(c + '.') if t[c].dtype == object else t[c] for c in t], "
        "axis=1).to_csv('plain.csv', index=False)\" {path}; the first motor is then --position "
        "observation.state.0:deg --goal action.0:deg --time timestamp:s",
    ),
    b"\x89HDF": ("is an HDF5 file", "export t_s, u_V and y_rad as CSV"),
}


@dataclass(frozen=True)
class CsvText:
    """The lines of a CSV file that are neither empty nor comments.

    lines    all lines of the file
    numbers  numbers of the lines that count, from 1; at least one
    notes    what the reader put up with, as sentences
    units    of the columns, from a row of units below the names, without brackets; empty: there is none
    """

    path: Path
    lines: Sequence[str]
    numbers: Sequence[int]
    notes: tuple[str, ...]
    units: tuple[str, ...] = ()

    @classmethod
    def of(cls, path: Path, *, own: bool = False) -> CsvText:
        """The text of a file. A last line without a line end is torn: it is left out and noted.

        own  whether the file is of a run folder
        Raises RecordingError.
        """
        content, moved = whole_content(path, own=own)
        _check_magic(path, content)
        whole, torn = without_torn_line(path, _with_line_feeds(content))
        lines = lines_of(path, whole)
        numbers = [k for k, line in enumerate(lines, 1) if line.strip() and not line.startswith((*_COMMENTS, "sep="))]
        if not numbers:
            raise RecordingError(path, "holds no rows", "give a CSV file with a line of column names and rows below it")
        text = cls(path, lines, numbers, (*moved, *torn))
        return text if own else text._with_names()._with_units()._without_last_delimiter()

    def _with_names(self) -> CsvText:
        """With the names of the columns, if these stand behind a # or % above rows of numbers or of units.

        numpy writes them so. Of several such lines the last one with names counts.
        """
        first = self.numbers[0]
        rows = self.fields(first)
        if not all(is_number(field) for field in rows if field) and _units_of(rows) is None:
            return self
        found: dict[int, list[str]] = {}
        for above in range(first - 1, 0, -1):
            words = self.lines[above - 1].lstrip(_COMMENTS).strip()
            most = max(_DELIMITERS, key=words.count)
            names = [name.strip() for name in words.split(most)] if most in words else words.split()
            known = [name for name in names if name in COLUMNS or any(sounds_like(name, q) for q in USUAL_NAMES)]
            if (
                self.lines[above - 1].startswith(tuple(_COMMENTS)) and len(names) == len(rows) and len(known) > 1
            ):  # no remark
                found[above] = names
        if not found:
            return self
        place = next((k for k, names in found.items() if _units_of(names) is None), max(found))
        lines = list(self.lines)
        lines[place - 1] = self.delimiter.join(found[place])
        return replace(self, lines=lines, numbers=[place, *self.numbers])

    def _with_units(self) -> CsvText:
        """Without a row of units below the names, which becomes ``units``, with a note."""
        if len(self.numbers) < 2:
            return self
        names, units = self.fields(self.numbers[0]), _units_of(self.fields(self.numbers[1]))
        if units is None or len(units) != len(names) or any(is_number(field) for field in names):
            return self
        words = f"line {self.numbers[1]} was read as the units: {', '.join(map(shown, units[:20]))}"
        return replace(self, numbers=[self.numbers[0], *self.numbers[2:]], notes=(*self.notes, words), units=units)

    def _without_last_delimiter(self) -> CsvText:
        """Without the delimiter behind the last column, if all rows have it and the names have not; with a note."""
        rows = self.numbers[1:]
        mark = self.delimiter
        if not rows or mark == _BLANKS or any(not self.lines[row - 1].rstrip().endswith(mark) for row in rows):
            return self
        if len(self.fields(rows[0])) != len(self.fields(self.numbers[0])) + 1:
            return self
        lines = list(self.lines)
        for row in rows:
            lines[row - 1] = lines[row - 1].rstrip()[:-1]
        words = f"{shown(mark)} behind the last column of each row was left out"
        return replace(self, lines=lines, notes=(*self.notes, words))

    @property
    def delimiter(self) -> str:
        """What separates the columns, by the first line."""
        first = self.lines[self.numbers[0] - 1]
        most = max(_DELIMITERS, key=first.count)
        if most in first:
            return most
        fields = first.split()
        return _BLANKS if len(fields) >= _FEWEST_COLUMNS or all(map(is_number, fields)) else most

    def fields(self, number: int) -> list[str]:
        """The fields of the line of this number. Raises RecordingError."""
        return _split(self.path, number, self.lines[number - 1], self.delimiter)

    def with_decimal_points(self, rows: Sequence[int]) -> CsvText:
        """With decimal commas as decimal points, and a note, if no comma separates columns and no row has a point."""
        if self.delimiter == "," or not _has_decimal_commas(self.lines, rows):
            return self
        lines = [line.replace(",", ".") for line in self.lines]
        return replace(self, lines=lines, notes=(*self.notes, "decimal commas were read as decimal points"))


@dataclass(frozen=True)
class CsvTable:
    """Rows of a CSV file under named columns.

    names      of all columns: those of ``sample_columns.COLUMNS`` are read, others are not
    called     what the file calls each of them, for messages
    rows       numbers of their lines, from 1
    required   names of columns that must have a number in each row
    """

    text: CsvText
    names: tuple[str, ...]
    called: tuple[str, ...]
    rows: Sequence[int]
    required: frozenset[str]

    def columns(self, first: int = 0) -> Columns:
        """Arrays of the known columns from row ``first`` on, counted from 0. Raises RecordingError."""
        names = [name for name in self.names if name in COLUMNS]
        chunks: list[Columns] = [
            _parse_rows(self, self.rows[k : k + _ROWS_AT_ONCE]) for k in range(first, len(self.rows), _ROWS_AT_ONCE)
        ]
        return {name: np.concatenate([chunk[name] for chunk in chunks]) for name in names} if chunks else {}


def _units_of(fields: Sequence[str]) -> tuple[str, ...] | None:
    """A row of units without its brackets; None if it is no such row. What stands in brackets may be anything."""
    units = tuple(field.strip("()[]") for field in fields)
    said = [unit for field, unit in zip(fields, units, strict=True) if field == unit and unit not in _NO_UNIT]
    if any(is_number(field) and field not in _NO_UNIT for field in fields) or set(units) <= _NO_UNIT:
        return None
    return units if all(unit.lower() in ALL_UNITS for unit in said) else None


def is_number(text: str) -> bool:
    """Whether a field is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def is_date(text: str) -> bool:
    """Whether a field is a date or a time of day."""
    return _DATE.match(text) is not None


def shown(text: str) -> str:
    """A text of the file, quoted, for a message."""
    return repr(text if len(text) <= 40 else text[:40] + "...")


def _fields(count: int) -> str:
    """How many fields, in words."""
    return "1 field" if count == 1 else f"{count} fields"


def _check_magic(path: Path, content: bytes) -> None:
    for magic, (cause, cure) in _NO_CSV.items():
        if content.startswith(magic):
            raise RecordingError(path, cause, cure.format(path=quote(str(path))))


def _with_line_feeds(content: bytes) -> bytes:
    """The content with line feeds, if its lines end in carriage returns alone."""
    return content if b"\n" in content else content.replace(b"\r", b"\n")


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


def _parse_rows(table: CsvTable, numbers: Sequence[int]) -> Columns:
    """Arrays of the known columns, from the lines with these numbers: by columns, and on any error line by line."""
    path, lines, delimiter = table.text.path, table.text.lines, table.text.delimiter
    rows = [lines[number - 1] for number in numbers]
    unquoted = delimiter != _BLANKS and not any('"' in row for row in rows)
    fields = [
        row.split(delimiter) if unquoted else _split(path, number, row, delimiter)
        for number, row in zip(numbers, rows, strict=True)
    ]
    if any(len(row) != len(table.names) for row in fields):
        raise _broken_row(table, fields, numbers)
    by_column = zip(table.names, zip(*fields, strict=True), strict=True)
    try:
        return {
            name: _parse_column(name, texts, name in table.required) for name, texts in by_column if name in COLUMNS
        }
    except ValueError as error:
        raise _broken_row(table, fields, numbers) from error


def _parse_column(name: str, texts: Sequence[str], required: bool) -> Column:
    """One column as an array. Raises ValueError if a field breaks a rule of ``_complaint``."""
    if KINDS[name] == "name":
        if max(map(len, texts)) > MAX_STAGE_LENGTH:
            raise ValueError(name)
        return np.array([plain(text.strip()) for text in texts])
    may_be_empty = not required and KINDS[name] != "integer"
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


def _broken_row(table: CsvTable, fields: Sequence[Sequence[str]], numbers: Sequence[int]) -> RecordingError:
    """The error for the first row that breaks a rule."""
    path, header = table.text.path, table.names
    for row, number in zip(fields, numbers, strict=True):
        if len(row) != len(header):
            first = "header" if table.text.numbers[0] not in table.rows else "first line"
            return RecordingError(
                path,
                f"the line has {_fields(len(row))}, and the {first} {len(header)}",
                _cure_of_count(table.text, number, len(row), len(header)),
                number,
            )
        for name, called, text in zip(header, table.called, row, strict=True):
            complaint = _complaint(name, text.strip(), name in table.required) if name in COLUMNS else ""
            if complaint:
                cure = _cure(path, name, text.strip())
                return RecordingError(path, f"column {called}: {complaint}", cure, number)
    return RecordingError(path, "cannot be read as numbers", "save it as plain CSV", numbers[0])


def _complaint(name: str, text: str, required: bool) -> str:
    """What is wrong with one field; empty if it is right."""
    if KINDS[name] == "name":
        return f"a name of {len(text)} characters" if len(text) > MAX_STAGE_LENGTH else ""
    if not text:
        return "is empty" if required or KINDS[name] == "integer" else ""
    if not is_number(text):
        return f"{shown(text)} is not a number"
    value = float(text)
    if math.isinf(value) or (math.isnan(value) and (required or KINDS[name] == "integer")):
        return f"{shown(text)} is not a finite number"
    if KINDS[name] == "integer" and not (value == math.trunc(value) and abs(value) < _MAX_INTEGER):
        return f"{shown(text)} is not an integer"
    return ""


def _cure_of_count(text: CsvText, number: int, there: int, wanted: int) -> str:
    """What to do about a line with another number of fields than the names have."""
    line, mark = text.lines[number - 1], text.delimiter
    others = [other for other in _DELIMITERS if other != mark and line.count(other) == wanted - 1]
    if there == 1 and others:
        return f"the names stand between {shown(mark)}, and the rows between {shown(others[0])}: make them alike"
    if mark != "," or there <= wanted or "." in line or not all(map(is_number, line.split(","))):
        return "correct or delete it"
    cure = "if decimal commas stand between commas, save it with semicolons between the columns"
    if there != 2 * wanted:
        return cure
    command = f"sed -E '{text.numbers[0] + 1},$ s/([0-9]+),([0-9]+)/\\1.\\2/g' {quote(str(text.path))} > plain.csv"
    return f"{cure}; or, if each number has one: {command}"


def _cure(path: Path, name: str, text: str) -> str:
    if not text:
        return "fill it in or delete this line"
    if name == "t_s" and is_date(text):
        return "it is a date: write seconds; or, if the rows came evenly, --period 10ms in place of --time"
    if text.endswith("%") and is_number(text[:-1].strip()):
        return f"take the % out: sed 's/%//g' {quote(str(path))} > plain.csv; then --drive percent"
    if (found := _WITH_UNIT.fullmatch(text)) and is_number(found[1]) and found[3].lower() in ALL_UNITS:
        return f"write the number alone, without {found[3]}"
    if "," in text and is_number(text.replace(",", ".")):
        return "use a decimal point"
    return "correct or delete this line"
