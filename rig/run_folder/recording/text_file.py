"""The files of a run, or given by a user, as text: of a bounded size, with their torn ends and moved parts noted."""

from __future__ import annotations

from glob import escape
from pathlib import Path
from shlex import quote
from typing import Final

from rig.core.plain_file import TooLargeError, UnfitError, read_plain
from rig.run_folder.recording.errors import RecordingError

MAX_BYTES: Final = 256 * 2**20
MOST_LINES: Final = 4_000_000  # 11 hours at 10 ms, or 256 MiB of rows
LONGEST_LINE: Final = 2**20  # characters
MOST_PARTS: Final = 30  # of a file of a run: one for each disk that failed; each costs a copy of all


def is_folder(path: Path) -> bool:
    """Whether a path is a folder. Raises RecordingError if it cannot be looked at."""
    try:
        return path.is_dir()
    except OSError as error:
        raise RecordingError(path, *_unreadable(error)) from error


def content_of(path: Path, most_bytes: int = MAX_BYTES, *, own: bool = False) -> bytes:
    """The content of a plain file of at most ``most_bytes``.

    own  whether it is of a run folder: then it may be no link
    Raises RecordingError.
    """
    try:
        return read_plain(path, most_bytes, follows_links=not own)
    except (OSError, ValueError) as error:  # ValueError: an impossible path
        raise RecordingError(path, *_unreadable(error)) from error


def _unreadable(error: Exception) -> tuple[str, str]:
    """Cause and cure."""
    if isinstance(error, UnfitError):
        return error.cause, error.cure
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return f"cannot be read: {reason}", "check the path and its permissions"


def whole_content(path: Path, *, own: bool = False) -> tuple[bytes, list[str]]:
    """The content of a file of a run, joined with the parts beside it (see ``writer``), and a note on each part.

    own  as for ``content_of``
    Raises RecordingError if it cannot be read, also for what is larger than MAX_BYTES as a whole.
    """
    content, notes = content_of(path, own=own), []
    beside = [(part, part.name.rpartition(".from-")[2]) for part in path.parent.glob(f"{escape(path.name)}.from-*")]
    if len(beside) > MOST_PARTS:
        raise RecordingError(
            path, f"goes on in more than {MOST_PARTS} files {path.name}.from-*", "delete what is not of it"
        )
    for part, number in sorted(((part, int(text)) for part, text in beside if text.isdecimal()), key=lambda p: p[1]):
        missing = number - len(content)
        notes.append(f"the disk failed: from byte {number} on it is {part.name}")
        if missing > 0:
            content = content[: content.rfind(b"\n") + 1]
            notes.append(f"it is torn before that: {missing} bytes are lost")
        content = content[:number] + content_of(part, own=True)
        if len(content) > MAX_BYTES:
            raise RecordingError(path, *_unreadable(TooLargeError(path, MAX_BYTES)))
    return content, notes


def without_torn_line(path: Path, content: bytes) -> tuple[bytes, list[str]]:
    """The complete lines, and a note about a last line without an end. Raises RecordingError for an empty file."""
    if not content:
        raise RecordingError(path, "is empty", "nothing was recorded: record again")
    written = content.rstrip(b"\0")  # a power cut can leave zeros behind the last block
    end = written.rfind(b"\n") + 1
    if end == len(content):
        return content, []
    line = written.count(b"\n", 0, end) + 1
    return written[:end], [f"line {line}, the last, is torn and was left out ({len(content) - end} bytes)"]


def text_of(path: Path, content: bytes) -> str:
    """The content of a file as text. Raises RecordingError with the line that is no UTF-8."""
    zero = content.find(b"\0")
    if zero >= 0:
        raise RecordingError(
            path,
            "is a binary file",
            "give a text file: export time, drive and position as CSV",
            content.count(b"\n", 0, zero) + 1,
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise RecordingError(
            path, "is not UTF-8 text", f"iconv -f LATIN1 -t UTF-8 {quote(str(path))} > plain.csv", line
        ) from error


def line_of(path: Path, content: bytes, number: int) -> str:
    """One line of a file as text. Raises RecordingError as ``lines_of``, with the line's number."""
    try:
        if len(content) > LONGEST_LINE:
            raise RecordingError(path, f"the line has {len(content)} characters", "correct or delete it")
        return text_of(path, content)
    except RecordingError as error:
        raise RecordingError(path, error.cause, error.cure, number) from error


def lines_of(path: Path, content: bytes) -> list[str]:
    """The lines of a file's content. Raises RecordingError as ``text_of``, for too many lines, and for one too long."""
    if content.count(b"\n") > MOST_LINES:
        raise RecordingError(path, f"has more than {MOST_LINES} lines", "cut it to the rows of the experiment")
    lines = text_of(path, content).split("\n")
    longest = max(map(len, lines))
    if longest > LONGEST_LINE:
        number = 1 + next(k for k, line in enumerate(lines) if len(line) == longest)
        raise RecordingError(path, f"the line has {longest} characters", "correct or delete it", number)
    return lines
