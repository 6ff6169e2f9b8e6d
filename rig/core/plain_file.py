"""Opens plain files, and nothing else: no pipe that waits for a writer, no device, no folder, and a link only if asked.

A file's name says nothing about what stands there. Whoever may write into the folder can put a link or a pipe in its
place, also between a look and the opening. So what was opened is looked at again.
"""

from __future__ import annotations

import errno
import os
import stat
from os import PathLike
from pathlib import Path
from typing import BinaryIO, Final

_NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0)
_NO_WAIT: Final = getattr(os, "O_NONBLOCK", 0)
_ALWAYS: Final = _NO_WAIT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


class UnfitError(OSError):
    """What stands under a name is no file that rig reads.

    cause, cure  what it is, and what to do; ``strerror`` has both
    """

    def __init__(self, path: str | PathLike[str], cause: str, cure: str) -> None:
        self.cause, self.cure = cause, cure
        super().__init__(errno.EINVAL, f"{cause}: {cure}", os.fspath(path))


class NotPlainError(UnfitError):
    """Something else stands in the place of a plain file."""


class TooLargeError(UnfitError):
    """A file has more bytes than rig reads of its kind."""

    def __init__(self, path: str | PathLike[str], most_bytes: int) -> None:
        super().__init__(path, f"is larger than {_size(most_bytes)}", "give a smaller one, or delete it")


def open_plain(
    path: str | PathLike[str],
    flags: int = os.O_RDONLY,
    mode: int = 0o600,
    *,
    follows_links: bool = False,
    folder: int | None = None,
    takes_pipe: bool = False,
) -> int:
    """A descriptor of a plain file.

    flags, mode    as for ``os.open``
    follows_links  whether the last part of ``path`` may be a link
    folder         descriptor of the folder that ``path`` is in; None: the present one
    takes_pipe     whether it may be a pipe, which waits for its writer: for what a user names on the command line

    Raises NotPlainError for anything but a plain file, OSError where it cannot be opened.
    """
    try:  # opening a device may already do something: a serial port resets its board
        status = os.stat(path, dir_fd=folder, follow_symlinks=follows_links)
        is_pipe = takes_pipe and stat.S_ISFIFO(status.st_mode)
        if not is_pipe:
            _require_plain(status, path)
    except FileNotFoundError:
        if not flags & os.O_CREAT:
            raise
        is_pipe = False
    always = _ALWAYS & ~_NO_WAIT if is_pipe else _ALWAYS
    try:
        descriptor = os.open(path, flags | always | (0 if follows_links else _NO_LINK), mode, dir_fd=folder)
    except OSError as error:
        if error.errno == errno.ELOOP and not follows_links:
            raise NotPlainError(path, *_LINK) from error
        raise
    try:
        status = os.fstat(descriptor)
        if not (is_pipe and stat.S_ISFIFO(status.st_mode)):
            _require_plain(status, path)
    except NotPlainError:
        os.close(descriptor)
        raise
    return descriptor


def open_folder(path: str | PathLike[str]) -> int | None:
    """A descriptor of a folder that others may want to swap for a link; None where the system opens no folders.

    Raises NotPlainError for a link, OSError where it cannot be opened.
    """
    if os.open not in os.supports_dir_fd:
        return None
    try:
        return os.open(path, os.O_RDONLY | os.O_DIRECTORY | _NO_LINK | _ALWAYS)
    except OSError as error:
        if Path(path).is_symlink():
            raise NotPlainError(path, *_LINK) from error
        raise


def read_plain(
    path: str | PathLike[str], most_bytes: int, *, follows_links: bool = False, takes_pipe: bool = False
) -> bytes:
    """The content of a plain file of at most ``most_bytes``, as far as it has grown by now.

    Raises NotPlainError and OSError as ``open_plain``; TooLargeError.
    """
    with os.fdopen(open_plain(path, follows_links=follows_links, takes_pipe=takes_pipe), "rb") as file:
        return read_open(file, path, most_bytes)


def read_open(file: BinaryIO, path: str | PathLike[str], most_bytes: int) -> bytes:
    """The content of an open file of at most ``most_bytes``. Raises TooLargeError; OSError."""
    is_larger = os.fstat(file.fileno()).st_size > most_bytes  # then nothing of it has to be read
    content = b"" if is_larger else file.read(most_bytes + 1)  # its size says nothing of what is appended meanwhile
    if is_larger or len(content) > most_bytes:
        raise TooLargeError(path, most_bytes)
    return content


_LINK: Final = ("is a link, and rig follows none here", "put what it leads to in its place, or delete the link")


def _require_plain(status: os.stat_result, path: str | PathLike[str]) -> None:
    mode = status.st_mode
    if stat.S_ISREG(mode):
        return
    if stat.S_ISLNK(mode):
        raise NotPlainError(path, *_LINK)
    kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
    kind = next((name for is_kind, name in kinds if is_kind(mode)), "a device")
    raise NotPlainError(path, f"is {kind}, not a file", "name a file, or put one in its place")


def _size(count: int) -> str:
    return f"{count / 2**20:.3g} MiB" if count >= 2**20 else f"{count // 1024} KiB"
