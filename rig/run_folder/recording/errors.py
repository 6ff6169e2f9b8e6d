"""The errors of recordings: which file, where in it, what is wrong, and what to do."""

from __future__ import annotations

from pathlib import Path

from rig.core.errors import CauseError, RigError


class RecordingError(RigError):
    """A recording cannot be written or cannot be read.

    path   the file or folder
    line   line in that file, counted from 1; None if the error has no line
    cause  what is wrong
    cure   one thing to do about it
    """

    def __init__(self, path: Path, cause: str, cure: str, line: int | None = None) -> None:
        from rig.core.signals import plain  # not before: the writer process starts fast, and dataclasses load slowly

        self.path = path
        self.line = line
        self.cause = cause = plain(cause)  # it may quote the file
        self.cure = cure = plain(cure)
        place = plain(str(path) if line is None else f"{path}:{line}")
        super().__init__(f"{place}: {cause}; {cure}")


class CannotWriteError(RecordingError):
    """The disk does not take a file. The request itself was right."""


class IdentifyError(CauseError):
    """A recording cannot be identified."""
