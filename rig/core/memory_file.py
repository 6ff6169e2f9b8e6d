"""Files whose bytes are memory that two processes map."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def create_file(size: int) -> int:
    """Descriptor of a file without a name, of ``size`` bytes, all allocated; in memory if the system offers that.

    Raises OSError, e.g. if there is no room.
    """
    in_memory = Path("/dev/shm")  # write-back to a disk could hold up the loop's memory writes
    with tempfile.TemporaryFile(dir=in_memory if in_memory.is_dir() else None) as file:
        allocate(file.fileno(), size)
        return os.dup(file.fileno())


def create_named_file(size: int) -> tuple[int, Path]:
    """``create_file`` with a name: for systems that cannot pass a descriptor to another process.

    Returns descriptor and path. The caller deletes the file. Raises OSError as ``create_file`` does.
    """
    descriptor, name = tempfile.mkstemp(prefix="rig-", suffix=".memory")
    try:
        allocate(descriptor, size)
    except OSError:
        os.close(descriptor)
        Path(name).unlink(missing_ok=True)
        raise
    return descriptor, Path(name)


def allocate(descriptor: int, size: int) -> None:
    """Allocate ``size`` bytes for an empty file. Raises OSError if the disk does not have them."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, size)
        return
    zeros = bytes(1 << 20)  # setting the length alone would leave a hole
    while size > 0:
        size -= os.write(descriptor, zeros[:size])
