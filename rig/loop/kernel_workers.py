"""The kernel's worker threads, raised by a process of its own, which gives them back whatever ends the loop's.

``python kernel_workers.py PRIORITY PROC``: raises them, says so in a line, waits for the end of its standard input, and
makes them ordinary again. Nothing of rig is imported here: it has to be there before the loop begins.
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
NAME = b"kworker/u"  # of those that are bound to no core


def workers(proc: Path = PROC) -> Iterator[int]:
    """Ids of the worker threads that are bound to no core. ``proc``: the folder that stands for /proc."""
    for comm in proc.glob("[0-9]*/comm"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has just ended
            if comm.read_bytes().startswith(NAME):
                yield int(comm.parent.name)


@contextlib.contextmanager
def raised_workers(priority: int, proc: Path = PROC) -> Iterator[tuple[int, str]]:
    """Within the block the workers have SCHED_FIFO at ``priority``, 1 to 99: (how many, why not all).

    Those that are there now, also where they have been left raised. Raises OSError where no process can be started.
    """
    command = [sys.executable, "-I", "-S", __file__, str(priority), str(proc)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as keeper:
        assert keeper.stdout is not None
        count, _, refusal = keeper.stdout.readline().strip().partition(" ")
        yield int(count or 0), refusal if count else "their keeper has ended"
        # its standard input ends here, or with this process


def main(arguments: Sequence[str]) -> int:
    """Raise, say how many and why no more, wait, give back."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):  # it ends when the loop does
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
