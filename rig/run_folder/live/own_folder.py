"""The folder ``.panel`` beside the run folders: what rig's processes of one user leave there for each other.

The folder of the runs may be one that others write in, too. So nothing here is taken by its name alone: the folder is
this user's, nobody else may enter it, it is opened once, and what is in it is reached through it. No link is followed,
and a file counts only if it is a plain one of this user with one name.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from rig.core.plain_file import NotPlainError, open_plain, read_open

NAME: Final = ".panel"
START_LOCK: Final = "start.lock"
_AGAIN_S: Final = 0.02


class NotOwnError(OSError):
    """What stands in the place of rig's folder, or of a file in it, is not rig's. ``strerror``: what, and the cure."""

    def __init__(self, path: Path, words: str) -> None:
        super().__init__(errno.EPERM, words, str(path))


class HeldError(OSError):
    """Another process holds a lock."""

    def __init__(self, path: Path) -> None:
        super().__init__(errno.EWOULDBLOCK, "another process of rig holds it: wait for it, or end it", str(path))


class OwnFolder:
    """rig's own folder in ``runs``, open for the block. Its mode becomes 0700.

    makes       whether it is made where it is missing
    descriptor  of the folder, for calls that take one
    Raises NotOwnError for a link, for what is no folder, and for the folder of another user; OSError where it is
    missing, or cannot be made. Not for Windows.
    """

    def __init__(self, runs: Path, *, makes: bool = True) -> None:
        self.path = runs / NAME
        if makes:
            runs.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileExistsError):
                self.path.mkdir(0o700)
        try:
            self.descriptor = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError as error:
            if error.errno not in (errno.ELOOP, errno.ENOTDIR):
                raise
            what = "a link" if self.path.is_symlink() else "no folder"
            raise NotOwnError(
                self.path, f"{self.path} is {what}, and rig wants a folder of its own there: move it away"
            ) from error
        try:
            status = os.fstat(self.descriptor)
            if status.st_uid != os.geteuid():
                raise NotOwnError(
                    self.path,
                    f"{self.path} belongs to user {status.st_uid}, not to you: use another folder of runs (--out), "
                    "or have it deleted",
                )
            if stat.S_IMODE(status.st_mode) != 0o700:
                os.fchmod(self.descriptor, 0o700)
        except OSError:
            os.close(self.descriptor)
            raise

    def __enter__(self) -> OwnFolder:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self.descriptor)

    def names(self) -> list[str]:
        """The names of what is in it."""
        with os.scandir(self.descriptor) as entries:
            return sorted(entry.name for entry in entries)

    def open(self, name: str, flags: int = os.O_RDONLY) -> int:
        """A descriptor of a file in it. Raises NotOwnError for what is not rig's, OSError where it cannot be opened."""
        path = self.path / name
        try:
            descriptor = open_plain(name, flags, folder=self.descriptor)
        except NotPlainError as error:
            raise NotOwnError(path, f"{path} {error.strerror}") from error
        status = os.fstat(descriptor)
        if status.st_uid != os.geteuid() or status.st_nlink > 1:
            os.close(descriptor)
            whose = "has another name, too" if status.st_uid == os.geteuid() else f"belongs to user {status.st_uid}"
            raise NotOwnError(path, f"{path} {whose}, so it is not rig's: move it away")
        return descriptor

    def read(self, name: str, most_bytes: int) -> bytes:
        """The content of a file in it. Raises OSError, as ``open``, and for a file that is larger."""
        with os.fdopen(self.open(name), "rb") as file:
            return read_open(file, self.path / name, most_bytes)

    def write(self, name: str, content: bytes) -> None:
        """Put a file with this content into it: it appears whole, or not at all. Raises OSError."""
        first = f".{secrets.token_hex(8)}"
        with os.fdopen(self.open(first, os.O_WRONLY | os.O_CREAT | os.O_EXCL), "wb") as file:
            file.write(content)
        os.rename(first, name, src_dir_fd=self.descriptor, dst_dir_fd=self.descriptor)

    def delete(self, name: str) -> None:
        """Delete a file of rig's in it. Raises OSError, as ``open``: what is not rig's stays."""
        os.close(self.open(name))
        os.unlink(name, dir_fd=self.descriptor)

    @contextlib.contextmanager
    def locked(self, name: str, wait_s: float) -> Iterator[None]:
        """For the block no other process has this lock: an empty file, which stays.

        Raises HeldError if another one has it for ``wait_s``; OSError as ``open``.
        """
        import fcntl  # Windows does not have it

        descriptor = self.open(name, os.O_RDWR | os.O_CREAT)
        try:
            until_s = time.monotonic() + wait_s
            while True:
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError as error:
                    if time.monotonic() > until_s:
                        raise HeldError(self.path / name) from error
                    time.sleep(_AGAIN_S)
            yield
        finally:
            os.close(descriptor)
