"""The error of this room: what is wrong with which file, where in it, and what to do."""

from __future__ import annotations

from pathlib import Path

from rig.errors import RigError
from rig.signals import plain


class RecordingError(RigError):
    """A recording that cannot be made or cannot be read.

    path   the file or folder
    line   line in that file, counted from 1; None where no line is to blame
    cause  what is wrong
    cure   one thing to do about it
    """

    def __init__(self, path: Path, cause: str, cure: str, line: int | None = None) -> None:
        self.path = path
        self.line = line
        self.cause = cause = plain(cause)  # it may quote the file
        self.cure = cure = plain(cure)
        place = plain(str(path) if line is None else f"{path}:{line}")
        super().__init__(f"{place}: {cause}; {cure}")


class CannotWriteError(RecordingError):
    """A file that the disk does not take: no fault of what was asked for."""


class IdentifyError(RigError):
    """A recording that cannot be identified: one line of cause, one of cure."""

    def __init__(self, cause: str, cure: str) -> None:
        self.cause = cause
        self.cure = cure
        super().__init__(f"{cause}\n{cure}")
