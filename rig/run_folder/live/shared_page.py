"""A small file that two processes map: one of them writes it, the other reads it without ever waiting for a disk."""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import secrets
import sys
from pathlib import Path
from typing import Final

from rig.core.copies import keep_from_copies, no_longer_own
from rig.core.memory_file import allocate
from rig.core.plain_file import open_folder, open_plain

SIZE: Final = 4096
_NEW: Final = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
_RENAMES_OPEN_FILES: Final = sys.platform != "win32"


class MappedPage:
    """The page as its owner has it: mapped to be read, and locked for as long as the owner lives.

    The lock is the kernel's: whatever ends the owner, ``is_owned`` says so. The page appears under its name with its
    content, locked. Systems without such a lock have the page, but there nobody can tell whether the owner lives.

    path     must not exist
    content  its first bytes
    folder   descriptor of the folder in which ``path`` is; None: the present one
    Raises OSError, e.g. where the disk is full or read-only.
    """

    def __init__(self, path: Path, content: bytes, folder: int | None = None) -> None:
        self._path = path
        self._folder = None if folder is None else os.dup(folder)
        first = path.with_name(f".{path.name}.{secrets.token_hex(8)}") if _RENAMES_OPEN_FILES else path
        try:
            self._descriptor = os.open(first, _NEW, 0o666, dir_fd=self._folder)
        except OSError:
            self._leave_folder()
            raise
        try:
            allocate(self._descriptor, SIZE)
            self.write(0, content)
            _lock(self._descriptor)
            self._map = mmap.mmap(self._descriptor, SIZE, access=mmap.ACCESS_READ)
            if first != path:
                os.rename(first, path, src_dir_fd=self._folder, dst_dir_fd=self._folder)
        except OSError:
            os.close(self._descriptor)
            with contextlib.suppress(OSError):
                os.unlink(first, dir_fd=self._folder)
            self._leave_folder()
            raise
        keep_from_copies(self._descriptor, self._map)

    def read(self, at: int, size: int) -> bytes:
        """The bytes from this place on, from memory; fewer where somebody has cut the file short."""
        if not hasattr(os, "pread"):
            return self._map[at : at + size]  # on Windows nobody can cut a mapped file short
        return os.pread(self._descriptor, size, at)  # to touch the map of a file that was cut short kills the process

    def write(self, at: int, data: bytes) -> None:
        """Write bytes from this place on. This may wait for the disk: not while the loop runs. Raises OSError."""
        os.lseek(self._descriptor, at, os.SEEK_SET)
        os.write(self._descriptor, data)

    def move(self, path: Path) -> None:
        """Put the file at another path on the same disk, in no link; who has it open sees on.

        Raises OSError, also where it is not at its path any more: what stands there instead is not moved.
        """
        if not self._is_at_its_path(os.fstat(self._descriptor)):
            raise OSError(errno.ENOENT, "somebody has put something else in its place", str(self._path))
        folder = open_folder(path.parent)
        there = path if folder is None else Path(path.name)
        try:
            os.rename(self._path, there, src_dir_fd=self._folder, dst_dir_fd=folder)
        except OSError:
            if folder is not None:
                os.close(folder)
            raise
        self._leave_folder()
        self._path, self._folder = there, folder

    def close(self) -> None:
        """Delete the file: nobody owns it any more."""
        status = os.fstat(self._descriptor)
        if _RENAMES_OPEN_FILES:
            self._delete(status)
        self._map.close()
        no_longer_own(self._descriptor)
        os.close(self._descriptor)
        if not _RENAMES_OPEN_FILES:
            self._delete(status)
        self._leave_folder()

    def _delete(self, mine: os.stat_result) -> None:
        """Delete the file, but not what somebody has put in its place."""
        with contextlib.suppress(OSError):  # a read-only disk: nobody holds the lock any more, and that says the same
            if self._is_at_its_path(mine):
                os.unlink(self._path, dir_fd=self._folder)

    def _is_at_its_path(self, mine: os.stat_result) -> bool:
        return os.path.samestat(os.stat(self._path, dir_fd=self._folder, follow_symlinks=False), mine)

    def _leave_folder(self) -> None:
        if self._folder is not None:
            os.close(self._folder)
            self._folder = None


class OthersPage:
    """The page of another process, open to be read, or to be written, too.

    folder  descriptor of the folder in which ``path`` is; None: the present one
    Raises OSError where there is no such file, or this user may not open it; ValueError where it is no such page.
    """

    def __init__(self, path: Path, *, writes: bool = False, folder: int | None = None) -> None:
        self._descriptor = open_plain(path, os.O_RDWR if writes else os.O_RDONLY, folder=folder)
        if os.fstat(self._descriptor).st_size != SIZE:
            os.close(self._descriptor)
            raise ValueError(f"{path} is no page of rig: it is no file of {SIZE} bytes")

    def __enter__(self) -> OthersPage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._descriptor)

    @property
    def is_owned(self) -> bool:
        """Whether the process that made the page lives; False, too, on a system that cannot tell."""
        return _is_locked(self._descriptor)

    @property
    def has_no_name(self) -> bool:
        """Whether the file was deleted; one that was only moved has a name."""
        return os.fstat(self._descriptor).st_nlink == 0

    def is_below(self, folder: Path) -> bool:
        """Whether the file is somewhere below this folder; True, too, on a system that cannot tell."""
        try:
            where = Path(f"/proc/self/fd/{self._descriptor}").readlink()
        except OSError:
            return True
        return where.is_relative_to(folder.resolve())

    @property
    def is_of_this_user(self) -> bool:
        """Whether the file is this user's; True on a system that cannot tell."""
        return not hasattr(os, "geteuid") or os.fstat(self._descriptor).st_uid == os.geteuid()

    def read(self, at: int, size: int) -> bytes:
        """The bytes from this place on."""
        os.lseek(self._descriptor, at, os.SEEK_SET)
        return os.read(self._descriptor, size)

    def write(self, at: int, data: bytes) -> None:
        """Write bytes from this place on. Raises OSError, e.g. on a read-only disk."""
        os.lseek(self._descriptor, at, os.SEEK_SET)
        os.write(self._descriptor, data)


def _lock(descriptor: int) -> None:
    try:
        import fcntl  # Windows does not have it
    except ImportError:
        return
    fcntl.flock(descriptor, fcntl.LOCK_EX)


def _is_locked(descriptor: int) -> bool:
    try:
        import fcntl
    except ImportError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False
