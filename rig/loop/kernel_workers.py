"""Raises the priority of the kernel's worker threads, in a process of its own: it restores them even if the loop dies.

``python kernel_workers.py PRIORITY PROC`` raises them, prints one line, waits for the end of its standard input, and
restores them. It imports nothing of rig, so that it starts fast: the loop waits for it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

PROC = Path("/proc")
NAME = b"kworker/u"  # the workers that are bound to no core


def workers(proc: Path = PROC) -> Iterator[int]:
    """Ids of the worker threads that are bound to no core. ``proc``: the folder that stands for /proc."""
    for comm in proc.glob("[0-9]*/comm"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has just ended
            if comm.read_bytes().startswith(NAME):
                yield int(comm.parent.name)


@contextlib.contextmanager
def raised_workers(priority: int, proc: Path = PROC) -> Iterator[tuple[int, str]]:
    """Give the workers SCHED_FIFO at ``priority``, 1 to 99, for the block. Yields how many, and why not all.

    It raises the workers that exist now, and restores them even if something else had raised them before.
    Raises OSError if the process cannot start.
    """
    command = [sys.executable, "-I", "-S", __file__, str(priority), str(proc)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as keeper:
        assert keeper.stdout is not None
        count, _, refusal = keeper.stdout.readline().strip().partition(" ")
        yield int(count or 0), refusal if count else "the process that raises them has ended"
        # leaving the block, or the end of this process, ends its standard input


def main(arguments: Sequence[str]) -> int:
    """Raise the workers, print how many and why no more, wait, restore them."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):  # only the end of its standard input ends it
        signal.signal(number, signal.SIG_IGN)
    priority, proc = int(arguments[0]), Path(arguments[1])
    raised: list[int] = []
    refusal = ""
    try:
        for worker in workers(proc):
            try:
                os.sched_setscheduler(worker, os.SCHED_FIFO, os.sched_param(priority))
                raised.append(worker)
            except ProcessLookupError:
                continue
            except OSError as error:
                refusal = error.strerror or str(error)
                break
        print(len(raised), refusal, flush=True)  # noqa: T201 - the loop's process reads it
        sys.stdin.read()
    finally:
        for worker in raised:
            with contextlib.suppress(OSError):  # it may have ended
                os.sched_setscheduler(worker, os.SCHED_OTHER, os.sched_param(0))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
