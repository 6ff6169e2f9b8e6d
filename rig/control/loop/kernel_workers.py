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
from typing import NamedTuple, Self

PROC = Path("/proc")
NAME = b"kworker/u"  # the workers that are bound to no core
PF_KTHREAD = 0x00200000  # of the kernel's own threads; a process can take any name, but not this flag
_FLAGS, _START = 6, 19  # fields of /proc/PID/stat after the name: flags, and clock ticks from boot to its start


class Worker(NamedTuple):
    """A thread of the kernel. A number is given to another process later, so its start belongs to it."""

    number: int
    start: int

    @classmethod
    def of(cls, number: int, proc: Path) -> Self | None:
        """The worker of that number; None if there is none: it has ended, or it is something else."""
        try:
            stat = (proc / str(number) / "stat").read_bytes()
        except (FileNotFoundError, ProcessLookupError):
            return None
        # the name is in brackets, and may hold brackets itself
        name, _, rest = stat.partition(b"(")[2].rpartition(b")")
        fields = rest.split()
        is_worker = name.startswith(NAME) and int(fields[_FLAGS]) & PF_KTHREAD
        return cls(number, int(fields[_START])) if is_worker else None

    def schedule(self, proc: Path, policy: int, priority: int) -> bool:
        """Give it that policy and priority if it is still the same. Returns whether it was.

        Raises OSError where the system refuses.
        """
        if Worker.of(self.number, proc) != self:
            return False
        try:
            os.sched_setscheduler(self.number, policy, os.sched_param(priority))
        except ProcessLookupError:
            return False
        return True


def workers(proc: Path = PROC) -> Iterator[Worker]:
    """The worker threads that are bound to no core. ``proc``: the folder that stands for /proc."""
    for stat in proc.glob("[0-9]*/stat"):
        worker = Worker.of(int(stat.parent.name), proc)
        if worker is not None:
            yield worker


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
    raised: list[Worker] = []
    refusal = ""
    try:
        for worker in workers(proc):
            try:
                if worker.schedule(proc, os.SCHED_FIFO, priority):
                    raised.append(worker)
            except OSError as error:
                refusal = error.strerror or str(error)
                break
        print(len(raised), refusal, flush=True)  # noqa: T201 - the loop's process reads it
        sys.stdin.read()
    finally:
        for worker in raised:
            with contextlib.suppress(OSError):  # the others have to be given back, too
                worker.schedule(proc, os.SCHED_OTHER, 0)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
