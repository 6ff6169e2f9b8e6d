"""Recordings as arrays: a run folder, or any CSV file with at least the columns t_s, u_V and y_rad.

For any content of the file the result is a ``Recording``, or a ``RecordingError`` with file, line and one cure.
"""

from __future__ import annotations

import csv
import difflib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from rig.recording.columns import COLUMNS, KINDS, SampleRow
from rig.recording.errors import RecordingError
from rig.recording.folder import CONFIG, META, RESULT
from rig.recording.path_kind import no_recording, no_run
from rig.recording.writer import EVENTS, SAMPLES
from rig.results import Part, RunEvent, RunMeta, RunResult
from rig.results.reading import DamagedError, parsed, remarks
from rig.signals import plain

__all__ = [
    "Recording",
    "RecordingError",
    "from_columns",
    "read",
    "read_csv",
    "read_result",
    "read_run",
    "whole_content",
]

_P = TypeVar("_P", bound=Part)

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

REQUIRED: Final = ("t_s", "u_V", "y_rad")
MIN_ROWS: Final = 3
MAX_BYTES: Final = 256 * 2**20
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


@dataclass(frozen=True, eq=False)
class Recording:
    """Rows of one recording; every array has one entry a row and is read-only.

    t_s          time of the sample y, s; strictly rising
    t_u_s        time at which u took effect, s; nan if unknown
    y_rad, u_V   position; drive that acts from t_u_s until t_u_s of the next row
    v_rad_per_s, z_rad_s, yd_rad, late_us, io_us   as in ``columns``; nan if absent
    tick         as recorded, else 0, 1, 2, ...
    seq, y_counts   as recorded, else -1
    flags        as recorded, else 0
    stage        name of each row's stage, else ""
    columns_present   all columns of the file, in its order, also those that rig does not know
    meta, config_text, events   of a run folder; RunMeta(), None and () for a plain CSV file
    notes        defects that the reader put up with, as sentences: a torn last line, a missing meta.json
    first_row    number of the first row in the file; not 0 in a selection of rows
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
    meta: RunMeta
    config_text: str | None
    events: tuple[RunEvent, ...]
    notes: tuple[str, ...]
    first_row: int = 0

    def __len__(self) -> int:
        return len(self.t_s)

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
    columns: dict[str, NDArray[Any]] = {"t_s": t_s, "u_V": u_V, "y_rad": y_rad}
    columns |= {} if t_u_s is None else {"t_u_s": t_u_s}
    columns |= {} if late_us is None else {"late_us": late_us}
    present = tuple(columns)
    columns = {name: np.array(values, dtype=np.float64) for name, values in columns.items()}
    _check_time(source, columns["t_s"], range(1, t_s.size + 1))
    _add_absent(columns, t_s.size)
    for array in columns.values():
        array.setflags(write=False)
    return Recording(
        **columns,
        columns_present=present,
        source=source,
        meta=meta or RunMeta(),
        config_text=None,
        events=(),
        notes=(),
        first_row=0,
    )


def read(path: Path) -> Recording:
    """Read a run folder or a CSV file, whichever ``path`` is. Raises RecordingError."""
    mistaken = no_recording(path)
    if mistaken is not None:
        raise mistaken
    return read_run(path) if _is_folder(path) else read_csv(path)


def read_run(folder: Path, known: Recording | None = None) -> Recording:
    """Read a run folder. ``notes`` say what a killed run did not write.

    known  this run as read earlier: its rows are not parsed again

    Raises RecordingError if this is not a run (see `no_run`), if samples.csv is unusable, or if another file of the
    folder is broken.
    """
    if not _is_folder(folder) or not (folder / SAMPLES).exists():
        raise no_run(folder)
    recording = read_csv(folder / SAMPLES, own=True, known=known)
    notes = list(recording.notes)

    meta = _read_part(folder / META, RunMeta)
    if meta is not None:
        notes.extend(f"{META}: {remark}" for remark in remarks(meta))
    else:
        meta = RunMeta()
        notes.append(f"{META} is missing")
    config = folder / CONFIG
    config_text = _text(config, _bytes(config)) if config.exists() else None
    events: list[RunEvent] = []
    if (folder / EVENTS).exists():
        events = _read_events(folder / EVENTS, notes)
    return replace(
        recording, source=folder, meta=meta, config_text=config_text, events=tuple(events), notes=tuple(notes)
    )


def read_result(folder: Path) -> RunResult | None:
    """The content of a run folder's result.json; None without that file. Raises RecordingError if it is broken."""
    return _read_part(folder / RESULT, RunResult)


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
    whole, notes = _without_torn_line(path, _with_line_feeds(content))
    notes = [*moved, *notes]
    lines = _text(path, whole).split("\n")
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
    chunks: list[dict[str, NDArray[Any]]] = []
    parsed = 0
    if known is not None and known.columns_present == header and len(known) <= len(row_numbers):
        chunks, parsed = [{name: getattr(known, name) for name in names}], len(known)
    for k in range(parsed, len(row_numbers), _ROWS_AT_ONCE):
        chunks.append(_parse_rows(path, header, delimiter, lines, row_numbers[k : k + _ROWS_AT_ONCE]))
    columns = {name: np.concatenate([chunk[name] for chunk in chunks]) for name in names}
    if own:
        columns = _while_time_rises(columns, row_numbers, notes)
        row_numbers = row_numbers[: len(columns["t_s"])]
    _check_time(path, columns["t_s"], row_numbers)
    _add_absent(columns, len(row_numbers))
    for array in columns.values():
        array.setflags(write=False)
    return Recording(
        **columns,
        columns_present=header,
        source=path,
        meta=RunMeta(),
        config_text=None,
        events=(),
        notes=tuple(notes),
        first_row=0,
    )


# -- files to text ----------------------------------------------------------------------------------------------------


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError as error:
        raise _unreadable(path, error) from error


def _bytes(path: Path) -> bytes:
    """The content of a regular file of at most MAX_BYTES."""
    try:
        if path.exists() and not path.is_file():
            raise RecordingError(path, "is not a file", "give a run folder or a CSV file")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: an impossible path
        raise _unreadable(path, error) from error
    if len(content) > MAX_BYTES:
        raise RecordingError(path, f"is larger than {MAX_BYTES // 2**20} MiB", "cut it to the rows of the experiment")
    return content


def _unreadable(path: Path, error: Exception) -> RecordingError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return RecordingError(path, f"cannot be read: {reason}", "check the path and its permissions")


def whole_content(path: Path) -> tuple[bytes, list[str]]:
    """The content of a file of a run, joined with the parts beside it (see ``writer``), and a note on each part.

    Raises RecordingError if it cannot be read.
    """
    content, notes = _bytes(path), []
    beside = [(part, part.name.rpartition(".from-")[2]) for part in path.parent.glob(f"{escape(path.name)}.from-*")]
    for part, number in sorted(((part, int(text)) for part, text in beside if text.isdecimal()), key=lambda p: p[1]):
        missing = number - len(content)
        notes.append(f"the disk failed: from byte {number} on it is {part.name}")
        if missing > 0:
            content = content[: content.rfind(b"\n") + 1]
            notes.append(f"it is torn before that: {missing} bytes are lost")
        content = content[:number] + _bytes(part)
    return content, notes


def _check_magic(path: Path, content: bytes) -> None:
    for magic, (cause, cure) in _NO_CSV.items():
        if content.startswith(magic):
            raise RecordingError(path, cause, cure)


def _with_line_feeds(content: bytes) -> bytes:
    """The content with line feeds, if its lines end in carriage returns alone."""
    return content if b"\n" in content else content.replace(b"\r", b"\n")


def _without_torn_line(path: Path, content: bytes) -> tuple[bytes, list[str]]:
    """The complete lines, and a note about a last line without an end."""
    if not content:
        raise RecordingError(path, "is empty", "nothing was recorded: record again")
    written = content.rstrip(b"\0")  # a power cut can leave zeros behind the last block
    end = written.rfind(b"\n") + 1
    if end == len(content):
        return content, []
    line = written.count(b"\n", 0, end) + 1
    return written[:end], [f"line {line}, the last, is torn and was left out ({len(content) - end} bytes)"]


def _text(path: Path, content: bytes) -> str:
    zero = content.find(b"\0")
    if zero >= 0:
        raise RecordingError(
            path, "is a binary file", "give a text file, saved as CSV in UTF-8", content.count(b"\n", 0, zero) + 1
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise RecordingError(path, "is not UTF-8 text", "save it as CSV in UTF-8", line) from error


# -- text to columns --------------------------------------------------------------------------------------------------


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
        cure = f"did you mean {', '.join(hints)}? Rename and use s, V, rad" if hints else "name the columns so"
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
) -> dict[str, NDArray[Any]]:
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


def _parse_column(name: str, texts: Sequence[str]) -> NDArray[Any]:
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


def _broken_row(
    path: Path, header: Sequence[str], fields: Sequence[Sequence[str]], numbers: Sequence[int]
) -> RecordingError:
    """The error for the first row that breaks a rule."""
    for row, number in zip(fields, numbers, strict=True):
        if len(row) != len(header):
            return RecordingError(
                path, f"has {len(row)} fields, not {len(header)}", "correct or delete this line", number
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


def _while_time_rises(
    columns: dict[str, NDArray[Any]], numbers: Sequence[int], notes: list[str]
) -> dict[str, NDArray[Any]]:
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


def _check_time(path: Path, t_s: Floats, numbers: Sequence[int]) -> None:
    bad = np.flatnonzero(t_s[1:] <= t_s[:-1])
    if len(bad):
        k = int(bad[0]) + 1
        what = "repeats the time before it" if t_s[k] == t_s[k - 1] else "goes back in time"
        raise RecordingError(
            path,
            f"{what} (t_s = {t_s[k]:.9g} after {t_s[k - 1]:.9g})",
            "keep one run in a file, with its rows in order and one row for each sample",
            numbers[k],
        )


def _add_absent(columns: dict[str, NDArray[Any]], count: int) -> None:
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


# -- JSON -------------------------------------------------------------------------------------------------------------


def _read_events(path: Path, notes: list[str]) -> list[RunEvent]:
    content, moved = whole_content(path)
    if not content:
        return []
    whole, torn = _without_torn_line(path, content)
    notes.extend(f"{EVENTS}: {note}" for note in [*moved, *torn])
    lines = _text(path, whole).split("\n")
    return [_typed(path, RunEvent, line, number) for number, line in enumerate(lines, 1) if line.strip()]


def _read_part(path: Path, kind: type[_P]) -> _P | None:
    """The content of a JSON file; None without the file."""
    return _typed(path, kind, _text(path, _bytes(path)), None) if path.exists() else None


def _typed(path: Path, kind: type[_P], text: str, line: int | None) -> _P:
    try:
        return parsed(kind, _parse_object(path, text, line))
    except DamagedError as error:
        raise RecordingError(path, error.cause, "correct it, or take that key out of the file", line) from error


def _parse_object(path: Path, text: str, line: int | None) -> dict[str, Any]:
    try:
        value = json.loads(text, parse_constant=_no_such_number)
    except (ValueError, RecursionError) as error:
        if line is None and isinstance(error, json.JSONDecodeError):
            line = error.lineno
        raise RecordingError(path, f"is broken JSON ({error})", "delete or correct it", line) from error
    if not isinstance(value, dict):
        raise RecordingError(path, "is no JSON object", "delete or correct it", line)
    return {plain(key): printable(item) for key, item in value.items()}


def printable(value: Any) -> Any:
    """A JSON value with its texts made safe for a terminal. A traceback keeps its lines."""
    if isinstance(value, str):
        return "\n".join(plain(line) for line in value.split("\n"))
    if isinstance(value, dict):
        return {plain(key): printable(item) for key, item in value.items()}
    return [printable(item) for item in value] if isinstance(value, list) else value


def _no_such_number(text: str) -> float:
    raise ValueError(f"{text} is no JSON number")
