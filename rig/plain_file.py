"""Opens plain files, and nothing else: no pipe that waits for a writer, no device, no folder, and a link only if asked.

A file's name says nothing about what stands there. Whoever may write into the folder can put a link or a pipe in its
place, also between a look and the opening. So what was opened is looked at again.
"""

from __future__ import annotations

import errno
import os
import stat
from os import PathLike
from typing import BinaryIO, Final

_NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0)
_ALWAYS: Final = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


class NotPlainError(OSError):
    """Something else stands in the place of a plain file. ``strerror`` says what, and what to do."""

    def __init__(self, path: str | PathLike[str], words: str) -> None:
        super().__init__(errno.EINVAL, words, os.fspath(path))


class TooLargeError(OSError):
    """A file has more bytes than rig reads of its kind. ``strerror`` says how many, and what to do."""

    def __init__(self, path: str | PathLike[str], most_bytes: int) -> None:
        words = f"is larger than {_size(most_bytes)}, the most that rig reads of such a file: replace or delete it"
        super().__init__(errno.EFBIG, words, os.fspath(path))


def open_plain(
    path: str | PathLike[str], flags: int = os.O_RDONLY, *, follows_links: bool = False, folder: int | None = None
) -> int:
    """A descriptor of a plain file.

    flags          as for ``os.open``; a file that is made gets mode 0600
    follows_links  whether the last part of ``path`` may be a link
    folder         descriptor of the folder that ``path`` is in; None: the present one

    Raises NotPlainError for anything but a plain file, OSError where it cannot be opened.
    """
    try:  # opening a device may already do something: a serial port resets its board
        _require_plain(os.stat(path, dir_fd=folder, follow_symlinks=follows_links), path)
    except FileNotFoundError:
        if not flags & os.O_CREAT:
            raise
    try:
        descriptor = os.open(path, flags | _ALWAYS | (0 if follows_links else _NO_LINK), 0o600, dir_fd=folder)
    except OSError as error:
        if error.errno == errno.ELOOP and not follows_links:
            raise NotPlainError(path, _IS_A_LINK) from error
        raise
    try:
        _require_plain(os.fstat(descriptor), path)
    except NotPlainError:
        os.close(descriptor)
        raise
    return descriptor


def read_plain(path: str | PathLike[str], most_bytes: int, *, follows_links: bool = False) -> bytes:
    """The content of a plain file of at most ``most_bytes``, as far as it has grown by now.

    Raises NotPlainError and OSError as ``open_plain``; TooLargeError.
    """
    with os.fdopen(open_plain(path, follows_links=follows_links), "rb") as file:
        return read_open(file, path, most_bytes)


def read_open(file: BinaryIO, path: str | PathLike[str], most_bytes: int) -> bytes:
    """The content of an open file of at most ``most_bytes``. Raises TooLargeError; OSError."""
    if os.fstat(file.fileno()).st_size <= most_bytes:  # before a byte is read: it may be a file full of holes
        content = file.read(most_bytes + 1)
        if len(content) <= most_bytes:
            return content
    raise TooLargeError(path, most_bytes)


_IS_A_LINK: Final = "is a link, and rig follows none here: put the file itself in its place, or delete the link"


def _require_plain(status: os.stat_result, path: str | PathLike[str]) -> None:
    mode = status.st_mode
    if stat.S_ISREG(mode):
        return
    if stat.S_ISLNK(mode):
        raise NotPlainError(path, _IS_A_LINK)
    kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
    kind = next((name for is_kind, name in kinds if is_kind(mode)), "a device")
    raise NotPlainError(path, f"is {kind}, not a file: name a file, or put one in its place")


def _size(count: int) -> str:
    return f"{count / 2**20:.3g} MiB" if count >= 2**20 else f"{count // 1024} KiB"
