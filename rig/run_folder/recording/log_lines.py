"""Finds the table in a text that others wrote: which lines are its rows, and what its columns are called.

A sketch greets before its first row, starts again in the middle, or is torn where somebody pulled the plug. An
instrument writes a page about itself first. A serial monitor puts the time of day before each row; a plotter, or JSON,
the name before each number. What is no row is left out, and a note says so.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from typing import Final

from rig.run_folder.recording.log_format import ALL_UNITS, USUAL_NAMES, sounds_like
from rig.run_folder.recording.sample_columns import COLUMNS

BLANKS: Final = " "  # any number of them
DELIMITERS: Final = (",", ";", "\t", "|")
COMMENTS: Final = "#%"
_NO_UNIT: Final = {"", "-", "1"}
# The begin of a date or a time of day; and one as a whole: perhaps a date, then the time of day, perhaps with a zone.
_DATE: Final = re.compile(r"\d{4}-\d\d?-\d\d?|\d\d?[./]\d\d?[./]\d{4}|\d\d?:\d\d")
_STAMP: Final = re.compile(
    r"(?:(\d+)[-./](\d+)[-./](\d+)[T ]+)?((?:\d\d?:){1,2}\d\d?(?:[.,]\d*)?)(?: ?([AaPp])[Mm]|Z|[+-]\d\d:?\d\d)?"
)
_EPOCH: Final = date(2000, 1, 1).toordinal()
_MONITOR: Final = re.compile(r"\s*\d\d?:\d\d:\d\d[.,]\d+\s*->\s?")  # what a serial monitor puts before a line
_BRACKETED: Final = re.compile(r"\s*[\[(]+[^\[\](){}]+[\])]+,?\s*")  # as Python prints a list, a tuple or an array
_NAMED: Final = re.compile(r'"?([^\W\d][^":=,;{}]*?)"?\s*[:=]\s*"?([-+.\w]*)"?\s*(?:[,;\s}]+|$)')
_MOSTLY: Final = 0.5  # share of rows that have a number in a column of numbers
_LOOKED_AT: Final = 200  # lines, from all over the text, that tell what a row is
_FEWEST_NUMBERS, _FEWEST_ROWS = 2, 3  # numbers in a row, rows in a table
_TORN: Final = 0.01  # share of rows: so many lines may have lost something; with more, the first of them is an error


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


def seconds_of(text: str) -> float:
    """A date with a time of day, or this alone, in s from any zero. Raises ValueError."""
    found = _STAMP.fullmatch(text.strip())
    if found is None:
        raise ValueError(text)
    seconds = 0.0
    for part in found[4].replace(",", ".").split(":"):
        seconds = 60.0 * seconds + float(part)
    if found[5] is not None:
        seconds = seconds % 43200.0 + (43200.0 if found[5] in "Pp" else 0.0)
    if found[1] is None:
        return seconds
    first, second, third = int(found[1]), int(found[2]), int(found[3])
    year, month, day = (first, second, third) if len(found[1]) == 4 else (third, second, first)
    if "/" in text and len(found[1]) < 4:
        month, day = day, month
    return seconds + 86400.0 * (date(year, month, day).toordinal() - _EPOCH)


def is_stamp(text: str) -> bool:
    """Whether ``seconds_of`` can read it."""
    try:
        seconds_of(text)
    except ValueError:
        return False
    return True


def shown(text: str) -> str:
    """A text of the file, quoted, for a message."""
    return repr(text if len(text) <= 40 else text[:40] + "...")


def units_of(fields: Sequence[str]) -> tuple[str, ...] | None:
    """A row of units without its brackets; None if it is no such row. What stands in brackets may be anything."""
    units = tuple(field.strip("()[]") for field in fields)
    said = [unit for field, unit in zip(fields, units, strict=True) if field == unit and unit not in _NO_UNIT]
    if any(is_number(field) and field not in _NO_UNIT for field in fields) or set(units) <= _NO_UNIT:
        return None
    return units if all(unit.lower() in ALL_UNITS for unit in said) else None


def split(line: str, delimiter: str) -> list[str]:
    """The fields of one line, without quotes and outer blanks. Raises csv.Error for broken quotes."""
    if delimiter == BLANKS:
        line = " ".join(line.split())
    if '"' not in line:
        return [field.strip() for field in line.split(delimiter)]
    return [field.strip() for field in next(csv.reader([line.strip()], delimiter=delimiter, strict=True))]


@dataclass(frozen=True)
class Found:
    """A table in a text.

    lines      of the text, as they are to be read
    delimiter  between its columns
    names      of its columns; empty: it has none
    line       number of the line of names, else of the first row, from 1
    rows       numbers of the lines of its rows
    torn       numbers of lines that were rows, and have lost something: few, and left out
    units      of its columns, from a row of units, without brackets; empty: there is none
    notes      what was left out, as sentences
    other      number of a line below the rows' begin that names other columns, as of another table; 0: there is none
    """

    lines: Sequence[str]
    delimiter: str
    names: tuple[str, ...]
    line: int
    rows: Sequence[int]
    torn: Sequence[int]
    units: tuple[str, ...]
    notes: tuple[str, ...]
    other: int


def table_in(given: Sequence[str]) -> Found | None:
    """The table in these lines; None where no three of them are alike and have two numbers."""
    lines, names = _plain(given)
    numbers = [k for k, line in enumerate(lines, 1) if line.strip() and not line.startswith((*COMMENTS, "sep="))]
    shape = _shape_of([lines[k - 1] for k in numbers])
    rows = [] if shape is None else [k for k in numbers if shape.fits(lines[k - 1])]
    if shape is None or len(rows) < _FEWEST_ROWS:
        return None
    units: tuple[str, ...] = ()
    line, notes, used = rows[0], list[str](), set[int]()
    head = (shape.heading(line, below_names=True) or () for line in lines[: rows[0] - 1])
    named = next((k for k, fields in enumerate(head, 1) if any(map(_is_known, fields))), rows[0])
    for k in range(rows[0] - 1, 0, -1):
        fields = None if names else shape.heading(lines[k - 1], bool(units), below_names=named < k)
        said = None if fields is None else units_of(fields)
        if said is not None and not units and k > 1:
            units = said
            notes.append(f"line {k} was read as the units: {', '.join(map(shown, units[:20]))}")
        elif fields is not None:
            names, line = tuple(fields), k
        used |= set() if fields is None else {k}
    if not names and rows[0] > numbers[0] and _is_heading(lines[rows[0] - 2]):
        return None  # of another number of columns: that is said elsewhere
    first = set(numbers) - used - set(rows)
    other = min((k for k in first if k > rows[0] and shape.names_others(lines[k - 1], names)), default=0)
    torn = [k for k in first if k > rows[0] and any(map(is_number, shape.fields(lines[k - 1])))]
    if len(torn) > _TORN * len(rows):
        rows, first, torn = sorted([*rows, *torn]), first - set(torn), []
    if first:
        many = (
            f"line {min(first)} is no row, and was" if len(first) == 1 else f"{len(first)} lines are no rows, and were"
        )
        notes.append(f"{many} left out: {', '.join(shown(lines[k - 1]) for k in sorted(first)[:3])}")
    return Found(lines, shape.delimiter, names, line, rows, sorted(torn), units, tuple(notes), other)


@dataclass(frozen=True)
class _Shape:
    """What rows have in common: what stands between the columns, how many there are, and which of them are numbers."""

    delimiter: str
    count: int
    of_numbers: tuple[int, ...]
    ends_empty: bool

    def fields(self, line: str) -> list[str]:
        """The fields of a line; one where its quotes are broken."""
        try:
            return split(line, self.delimiter)
        except csv.Error:
            return [line]

    def fits(self, line: str) -> bool:
        """Whether a line is a row. A number may be missing."""
        fields = self.fields(line)
        return len(fields) == self.count and all(
            not fields[k] or _is_value(fields[k], self.delimiter) for k in self.of_numbers
        )

    def heading(self, line: str, has_units: bool = False, *, below_names: bool = False) -> list[str] | None:
        """The names, or units, in a line above the rows; None where it is neither.

        numpy writes the names behind a #, ROS behind a %. LabVIEW names a column of comments that rows do not have.
        """
        is_remark = line.startswith(tuple(COMMENTS))
        words = line.lstrip(COMMENTS).strip()
        most = max(DELIMITERS, key=words.count)
        mark = (most if most in words else BLANKS) if is_remark else self.delimiter
        try:
            names = split(words if is_remark else line, mark)
        except csv.Error:
            return None
        if len(names) == self.count - 1 and self.ends_empty:
            names.append("")
        if len(names) == self.count + 1 and names[-1].lower() in ("", "comment"):
            names.pop()
        known = sum(_is_known(name) for name in names)
        # of few words one may be a known one by chance
        may_name = known == 1 and not below_names and not any(" " in name for name in names)
        remarks = is_remark and known < 2 and not may_name
        torn = not has_units and 2 * sum(map(is_number, names)) >= len(names)
        return None if len(names) != self.count or remarks or torn or all(map(is_number, names)) else names

    def names_others(self, line: str, names: Sequence[str]) -> bool:
        """Whether a line below the names has other names, or these in another order."""
        fields = self.heading(line, has_units=False)
        if fields is None or not names or tuple(fields) == tuple(names) or any(map(is_number, fields)):
            return False
        return units_of(fields) is None and sum(map(_is_known, fields)) > 1


def _is_known(name: str) -> bool:
    return name in COLUMNS or any(sounds_like(name, quantity) for quantity in USUAL_NAMES)


def _is_heading(line: str) -> bool:
    names = split(line.replace('"', ""), max(DELIMITERS, key=line.count))
    return sum(map(_is_known, names)) > 1 and not any(map(is_number, names))


def _is_value(field: str, delimiter: str) -> bool:
    """Whether a field is a number, perhaps with a decimal comma, or a date."""
    return is_number(field if delimiter == "," else field.replace(",", ".")) or is_date(field)


def _shape_of(lines: Sequence[str]) -> _Shape | None:
    """What most of these lines have in common, if it has two numbers."""
    looked_at = lines[:: max(1, len(lines) // _LOOKED_AT)]
    shapes = Counter[tuple[str, int]]()
    for line in looked_at:
        ways = [
            (sum(_is_value(field, mark) for field in fields), mark, len(fields))
            for mark in (";", "\t", "|", ",", BLANKS)
            if mark in line and (fields := _Shape(mark, 0, (), False).fields(line))
        ]
        most = max(ways, key=lambda way: way[0], default=(0, "", 0))
        if most[0] >= _FEWEST_NUMBERS:
            shapes[most[1:]] += 1
    if not shapes:
        return None
    (delimiter, count), _ = shapes.most_common(1)[0]
    alike = [one for line in looked_at if len(one := _Shape(delimiter, 0, (), False).fields(line)) == count]
    share = [sum(_is_value(one[k], delimiter) for one in alike) / len(alike) for k in range(count)]
    of_numbers = tuple(k for k in range(count) if share[k] >= _MOSTLY)
    return _Shape(delimiter, count, of_numbers, not any(one[-1] for one in alike[-_FEWEST_ROWS:]))


def _plain(lines: Sequence[str]) -> tuple[Sequence[str], tuple[str, ...]]:
    """The lines without brackets or the times of a monitor; where each number has its name before it, these names."""
    written = [line for line in lines if line.strip()]
    looked_at = written[:: max(1, len(written) // _LOOKED_AT)]
    if 2 * sum(_MONITOR.match(line) is not None for line in looked_at) > len(looked_at):
        lines, looked_at = ([_MONITOR.sub("", line) for line in some] for some in (lines, looked_at))
    if 2 * sum(_BRACKETED.fullmatch(line) is not None for line in looked_at) > len(looked_at):
        return [line.strip(" []()\t\r").rstrip("]),") if _BRACKETED.fullmatch(line) else line for line in lines], ()
    labels = Counter(names for line in looked_at if len(names := _named(line)[0]) >= _FEWEST_NUMBERS)
    names, times = labels.most_common(1)[0] if labels else ((), 0)
    if 2 * times <= len(looked_at):
        return lines, ()
    read = ((line, _named(line)) for line in lines)
    return [",".join(_by_name(*named, names)) or line for line, named in read], names


def _by_name(own: tuple[str, ...], values: tuple[str, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    """The values in the order of these names; none where a line has others."""
    if own == names:
        return values
    of = dict(zip(own, values, strict=True))
    return tuple(of[name] for name in names) if sorted(own) == sorted(names) and len(of) == len(own) else ()


def _named(line: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names and the numbers of a line such as ``t:1,u:2`` or ``{"t": 1, "u": 2}``; none for another line."""
    found = _NAMED.findall(line)
    rest = _NAMED.sub("", line).strip("{ \r")
    return ((), ()) if rest else (tuple(name for name, _ in found), tuple(value for _, value in found))
