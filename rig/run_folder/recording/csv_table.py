"""A CSV file as a table: its lines, what separates them into fields, its column names, and its columns as arrays.

For any content of the file the result is an array, or a ``RecordingError`` with file, line and one cure.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from shlex import quote
from typing import Final

import numpy as np

from rig.core.signals import plain
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.log_format import ALL_UNITS
from rig.run_folder.recording.log_lines import (
    BLANKS,
    COMMENTS,
    DELIMITERS,
    is_date,
    is_number,
    is_stamp,
    seconds_of,
    shown,
    split,
    table_in,
)
from rig.run_folder.recording.recording import MIN_ROWS, Column, Columns, Floats
from rig.run_folder.recording.sample_columns import COLUMNS, KINDS
from rig.run_folder.recording.text_file import lines_of, whole_content, without_torn_line

MAX_STAGE_LENGTH: Final = 64
_MAX_INTEGER: Final = 2.0**53  # a float cannot hold every integer beyond
_ROWS_AT_ONCE: Final = 4096
_WITH_UNIT: Final = re.compile(r"([+-]?[0-9.]+(e[+-]?[0-9]+)?)\s*([^\W\d_]+|%|°)", re.IGNORECASE)
_MADE_A_DATE: Final = re.compile(r"\d{1,2}[-./ ]{1,2}[^\W\d_]{3,}\.?|[^\W\d_]{3,}[-./ ]{1,2}\d{1,2}")
_FIRST_LINES: Final = 100  # a factor of all numbers stands in these
_FACTOR: Final = re.compile(r"\s*\d\.\d+e[+-]\d+\s*\*\s*")
_QUOTED: Final = re.compile('"[^"]*"')
_ALL: Final = re.compile(".+")
_FEWEST_COLUMNS: Final = 3
_FEW: Final = 0.01  # share of rows that may lack a number, and are left out
EVENTS: Final = 0.5  # share of rows without a drive, from which on it was written where it changed
_CHANGES: Final = 0.9  # share of the drives that are given: so many differ from the one before where all do
# A drive ends where so many times the longest way between two drives, of so many or more, comes without one
_ENDS: Final = 3
_FEWEST_GIVEN: Final = 10
# First bytes of files that people often give in place of a CSV file: what the file is, and how to get a CSV file.
_NO_CSV: Final = {
    b"\x1f\x8b": ("is compressed (gzip)", "unpack it first: gunzip"),
    b"PK\x03\x04": ("is an Excel workbook or a zip file", "export the sheet as CSV in UTF-8, or unpack it"),
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
    """The table in a CSV file as text.

    lines      all lines of the file
    delimiter  what separates the columns
    names      of the columns; empty: there are none
    line       number of the line of names, else of the first row, from 1
    rows       numbers of the lines of the rows
    torn       numbers of lines that were rows, and are left out
    notes      what the reader put up with, as sentences
    units      of the columns, from a row of units below the names, without brackets; empty: there is none
    """

    path: Path
    lines: Sequence[str]
    delimiter: str
    names: tuple[str, ...]
    line: int
    rows: Sequence[int]
    notes: tuple[str, ...]
    torn: Sequence[int] = ()
    units: tuple[str, ...] = ()

    @classmethod
    def of(cls, path: Path, *, own: bool = False) -> CsvText:
        """The text of a file. A last line without a line end is torn: it is left out and noted.

        own  whether the file is of a run folder: then its first line has the names, and all others are rows
        Raises RecordingError.
        """
        content, notes = whole_content(path, own=own)
        _check_magic(path, content)
        content, encoded = (content, []) if own else _in_utf8(content)
        whole, torn = without_torn_line(path, content if b"\n" in content else content.replace(b"\r", b"\n"))
        notes = [*notes, *encoded, *torn]
        lines = lines_of(path, whole)
        found = None if own else table_in(lines)
        factor = next((k for k, line in enumerate(lines[:_FIRST_LINES], 1) if _FACTOR.fullmatch(line)), 0)
        if factor and not own:
            cause = (
                f"all numbers are to be taken times this, {lines[factor - 1].strip()}: they are rounded for a screen"
            )
            raise RecordingError(path, cause, "save them in full, in MATLAB: writematrix(data, 'log.csv')", factor)
        if found is not None and found.other:
            cause = f"the line names other columns than line {found.line}: another table begins"
            raise RecordingError(path, cause, "cut the file here: each table is a file of its own", found.other)
        if found is not None:
            return cls(path, found.lines, found.delimiter, found.names, found.line, found.rows,
                       (*notes, *found.notes), found.torn, found.units)  # fmt: skip
        numbers = [k for k, line in enumerate(lines, 1) if line.strip() and not line.startswith((*COMMENTS, "sep="))]
        if not numbers:
            raise RecordingError(path, "holds no rows", "give a CSV file with a line of column names and rows below it")
        delimiter = _delimiter(lines[numbers[0] - 1])
        first = _split(path, numbers[0], lines[numbers[0] - 1], delimiter)
        has_names = not all(is_number(field) or is_date(field) for field in first if field)
        names, rows = (tuple(first), numbers[1:]) if has_names else ((), numbers)
        return cls(path, lines, delimiter, names, numbers[0], rows, tuple(notes))

    @property
    def header(self) -> Sequence[str]:
        """The names of the columns, else the fields of the first row. Raises RecordingError."""
        return self.names or self.fields(self.rows[0])

    def fields(self, number: int) -> list[str]:
        """The fields of the line of this number. Raises RecordingError."""
        return _split(self.path, number, self.lines[number - 1], self.delimiter)

    def interrupted(self, rows: Sequence[int]) -> list[int]:
        """Places in these rows, from 0, before which stands another line: a greeting, or the names again."""
        torn, lines = set(self.torn), self.lines
        return [
            k
            for k, (before, line) in enumerate(pairwise(rows), 1)
            if any(lines[n - 1].strip(f"{COMMENTS} ") for n in range(before + 1, line) if n not in torn)
        ]

    def with_decimal_points(self) -> CsvText:
        """With decimal commas as decimal points, and a note, if fields have commas, in quotes or not, and no points."""
        of_commas = self.delimiter == ","
        may = [number for number in self.rows if not of_commas or '"' in self.lines[number - 1]]
        if not _has_decimal_commas(map(self.fields, may)):
            return self
        within = _QUOTED if of_commas else _ALL
        lines = [within.sub(lambda found: found[0].replace(",", "."), line) for line in self.lines]
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

    def of_log(self, notes: list[str]) -> tuple[Columns, Sequence[int]]:
        """The columns of a log, and the lines of its rows, without the few rows that lack a number; with notes.

        A drive that most rows lack was written where it changed: it stays as it was in between. Positions of a slower
        clock stay NaN in the rows between. Raises RecordingError.
        """
        columns, lines = self._driven(replace(self, required=frozenset()).columns(), notes)
        missing = {name: np.isnan(columns[name]) for name in self.names if name in self.required}
        share = {name: float(np.mean(lacks)) for name, lacks in missing.items()}
        if share.get("u_V", 0.0) > _FEW:
            given = np.flatnonzero(~missing["u_V"])
            beside = np.all([~lacks[given] for name, lacks in missing.items() if name != "u_V"], axis=0)
            changes = np.count_nonzero(np.diff(columns["u_V"][given])) >= _CHANGES * (given.size - 1)
            if np.mean(beside) < EVENTS or (changes and share["u_V"] > EVENTS):  # it has rows of its own, or came with
                held = np.maximum.accumulate(np.where(missing["u_V"], 0, np.arange(len(lines))))
                columns["u_V"], share["u_V"] = columns["u_V"][held], 0.0
                missing["u_V"] = np.isnan(columns["u_V"])
                notes.append(f"the drive is given in {given.size} rows: in between it is as it was")
        if share.get("y_rad", 0.0) > _FEW:
            seen = np.count_nonzero(~missing["y_rad"])
            missing["y_rad"] &= seen < MIN_ROWS
            notes.append(f"the position is given in {seen} rows of {len(lines)}: the others tell the drive")
            share["y_rad"] = float(np.mean(missing["y_rad"]))
        for name in missing:
            if share[name] > _FEW:
                line = lines[int(np.argmax(missing[name]))]
                count = np.count_nonzero(missing[name])
                raise self._is_empty(name, int(count), line) if count > 1 else self._broken(line)
        kept = np.flatnonzero(~np.any(list(missing.values()), axis=0))
        if kept.size < len(lines):
            notes.append(f"{len(lines) - kept.size} rows lack a number, and were left out")
        return {name: values[kept] for name, values in columns.items()}, [lines[k] for k in kept.tolist()]

    def others(self, rows: Sequence[int]) -> Iterator[Floats]:
        """Each column that is not read, and has a number in all of these rows."""
        for name, texts in zip(self.names, zip(*map(self.text.fields, rows), strict=False), strict=False):
            if not name and all(map(is_number, texts)):
                yield np.array(texts, dtype=np.float64)

    def _driven(self, columns: Columns, notes: list[str]) -> tuple[Columns, Sequence[int]]:
        """The columns, and their lines, without the rows before the first drive, and without those after the last one
        if none was given there for far longer than ever before; with a note. Raises RecordingError without a drive.
        """
        if "u_V" not in columns:
            return columns, self.rows
        given = np.flatnonzero(~np.isnan(columns["u_V"]))
        if not given.size:
            raise self._is_empty("u_V", len(self.rows), self.rows[0])
        first, stop = int(given[0]), len(self.rows)
        longest = int(np.diff(given).max(initial=1))
        if given.size >= _FEWEST_GIVEN and stop - 1 - given[-1] > _ENDS * longest:
            stop = int(given[-1]) + longest
            notes.append(
                f"the drive ends in line {self.rows[given[-1]]}: the {len(self.rows) - stop} rows that come later were "
                "left out"
            )
        if first:
            notes.append(f"{first} rows before the first drive were left out")
        return {name: values[first:stop] for name, values in columns.items()}, self.rows[first:stop]

    def _broken(self, line: int) -> RecordingError:
        """The error for this line."""
        return _broken_row(self, [self.text.fields(line)], [line])

    def _is_empty(self, name: str, count: int, line: int) -> RecordingError:
        """The error for a column that lacks numbers in so many rows, this line the first of them."""
        place = self.names.index(name)
        mark = self.text.delimiter
        path, called = self.text.path, self.called[place]
        cause = f"column {called} is empty in {count} rows of {len(self.rows)}, first here"
        if name != "u_V" or count == len(self.rows):
            return RecordingError(path, cause, "fill it in or delete these lines", line)
        column, above = f"${place + 1}", self.text.line - (0 if self.text.names else 1)
        fill = (
            f"NR <= {above} {{print; next}} tolower({column}) ~ /^ *(nan)? *$/ {{{column} = u}} {{u = {column}; print}}"
        )
        fill = f"awk -F '{mark}' -v OFS='{mark}' '{fill}' {quote(str(path))} > plain.csv"
        cause += ": nobody knows when it changed"
        cure = f"log it in each row; or, if it changed only in rows that have it, fill it in: {fill}"
        return RecordingError(path, cause, cure, line)


def _fields(count: int) -> str:
    """How many fields, in words."""
    return "1 field" if count == 1 else f"{count} fields"


def _check_magic(path: Path, content: bytes) -> None:
    for magic, (cause, cure) in _NO_CSV.items():
        if content.startswith(magic):
            raise RecordingError(path, cause, cure.format(path=quote(str(path))))


def _has_decimal_commas(rows: Iterable[Sequence[str]]) -> bool:
    """Whether numbers have decimal commas: fields have commas, but no points; dates and times of day may."""
    commas = False
    for field in (field for row in rows for field in row if not is_date(field)):
        if "." in field:
            return False
        commas = commas or "," in field
    return commas


def _in_utf8(content: bytes) -> tuple[bytes, list[str]]:
    """The content of a log in UTF-8, minus signs as ASCII has them; a note where it was not UTF-8.

    Only its names can have other letters.
    """
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", "replace").encode(), ["it was read as UTF-16"]
    try:
        content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1").encode(), ["it is not UTF-8: its names were read as Latin-1"]
    return content.replace("\N{MINUS SIGN}".encode(), b"-"), []


def _delimiter(first: str) -> str:
    """What separates the columns, by the first line."""
    most = max(DELIMITERS, key=first.count)
    fields = first.split()
    blanks = most not in first and (len(fields) >= _FEWEST_COLUMNS or all(map(is_number, fields)))
    return BLANKS if blanks else most


def _split(path: Path, line_number: int, line: str, delimiter: str) -> list[str]:
    """The fields of one line, without quotes and outer blanks."""
    try:
        return split(line, delimiter)
    except csv.Error as error:
        raise RecordingError(
            path, f"has broken quotes ({error})", "correct or delete this line", line_number
        ) from error


def _parse_rows(table: CsvTable, numbers: Sequence[int]) -> Columns:
    """Arrays of the known columns, from the lines with these numbers: by columns, and on any error line by line."""
    path, lines, delimiter = table.text.path, table.text.lines, table.text.delimiter
    rows = [lines[number - 1] for number in numbers]
    unquoted = delimiter != BLANKS and not any('"' in row for row in rows)
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
    dated = name == "t_s" and is_date(texts[0].strip())
    values = np.array(list(map(seconds_of if dated else float, texts)))
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
            first = "header" if table.text.names else "first line"
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
    if name == "t_s" and is_date(text):
        return "" if is_stamp(text) else f"{shown(text)} is no date with a time of day"
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
    others = [other for other in DELIMITERS if other != mark and line.count(other) == wanted - 1]
    if there == 1 and others:
        return f"the names stand between {shown(mark)}, and the rows between {shown(others[0])}: make them alike"
    if there < wanted and text.names and all(len(text.fields(row)) == there for row in text.rows):
        return f"so has every line: take the names without a column out of line {text.line}"
    if mark != "," or there <= wanted or "." in line or not all(map(is_number, line.split(","))):
        return "correct or delete it"
    cure = "if decimal commas stand between commas, save it with semicolons between the columns"
    if there != 2 * wanted:
        return cure
    command = f"sed -E '{text.line + 1},$ s/([0-9]+),([0-9]+)/\\1.\\2/g' {quote(str(text.path))} > plain.csv"
    return f"{cure}; or, if each number has one: {command}"


def _cure(path: Path, name: str, text: str) -> str:
    if not text:
        return "fill it in or delete this line"
    if name == "t_s" and is_date(text):
        return "write seconds; or, if the rows came evenly, --period 10ms in place of --time"
    if text.endswith("%") and is_number(text[:-1].strip()):
        return f"take the % out: sed 's/%//g' {quote(str(path))} > plain.csv; then --drive percent"
    if (found := _WITH_UNIT.fullmatch(text)) and is_number(found[1]) and found[3].lower() in ALL_UNITS:
        return f"write the number alone, without {found[3]}"
    if "," in text and is_number(text.replace(",", ".")):
        return "use a decimal point"
    if _MADE_A_DATE.fullmatch(text):
        return "a spreadsheet took a number such as 28.2 for a date: give the log as it was, or import it as text"
    return "correct or delete this line"
