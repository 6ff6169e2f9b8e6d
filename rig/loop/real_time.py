"""Real-time set-up of the loop's process: each measure where the machine allows it, and in words where it refuses."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

PRIORITY = 60
_MCL_CURRENT, _MCL_FUTURE = 1, 2


@contextmanager
def real_time() -> Iterator[list[str]]:
    """Within the block: SCHED_FIFO and locked memory, as far as allowed. Yields one line for each measure."""
    if not sys.platform.startswith("linux"):
        yield ["real-time scheduling: not tried, this is not Linux"]
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    libc = ctypes.CDLL(None, use_errno=True)
    lines: list[str] = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        lines.append(f"SCHED_FIFO at priority {PRIORITY}")
    except PermissionError:
        lines.append("SCHED_FIFO refused: add `@realtime - rtprio 90` to /etc/security/limits.conf, and yourself to it")
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0:
        lines.append("memory locked")
    else:
        lines.append(f"memory not locked: {os.strerror(ctypes.get_errno())}")
    try:
        yield lines
    finally:
        libc.munlockall()
        os.sched_setscheduler(0, *before)
