"""Whether this machine stood still: a process beside a run in real time that sees nothing of the run.

On each core that it may use it sleeps on an absolute grid, and notes when it came late. Its priority is above all that
rig has, and it prints nothing before its end: so it takes neither rig's sums nor its own waits for the machine's. A
pseudo-terminal's bytes are carried by workers of the kernel, which may have to wait where no process of that priority
does: with ``pty`` it also sends itself a byte at each tick, and notes how long that was under way.

``python witness.py PTY``, PTY 0 or 1: prints ``ready``; when its standard input ends, a line for each stall: when it
began, s of the monotonic clock, and its length, s.
"""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

TICK_S = 0.005
SEEN_S = 0.010  # shorter ones are not noted
PRIORITY = 75  # rig's loop has 60, its keeper 61, emulated devices have 70


class Stall(NamedTuple):
    """When it began, s of the monotonic clock, and how long it lasted, s."""

    began_s: float
    lasted_s: float


class Witness:
    """The process, for the block.

    pty  also of a pseudo-terminal's bytes
    """

    def __init__(self, *, pty: bool = False) -> None:
        self._command = [sys.executable, "-I", "-S", str(Path(__file__).resolve()), f"{pty:d}"]
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        if self._process.stdout.readline() != "ready\n":
            self._process.communicate()
            raise RuntimeError(f"the witness did not begin, exit status {self._process.returncode}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._process is not None:
            self.seen()

    def seen(self) -> list[Stall]:
        """What it saw, in order; it ends."""
        process, self._process = self._process, None
        if process is None:
            raise ValueError("the witness has ended, or was not begun")
        written, _ = process.communicate()
        return sorted(Stall(*map(float, line.split())) for line in written.splitlines())


def longest_s(stalls: list[Stall]) -> float:
    """The longest of them, s; 0.0: none."""
    return max((stall.lasted_s for stall in stalls), default=0.0)


def _watch(core: int, over: threading.Event, done_s: Callable[[], float], stalls: list[Stall]) -> None:
    """Sleep on the grid on that core, and note what came late. ``done_s``: when the tick is done, s."""
    os.sched_setaffinity(0, {core})  # of this thread
    due_s = time.monotonic()
    while not over.is_set():
        due_s += TICK_S
        time.sleep(max(due_s - time.monotonic(), 0.0))
        late_s = done_s() - due_s
        if late_s > SEEN_S:
            stalls.append(Stall(due_s, late_s))
            due_s += late_s


def _own_pty() -> Callable[[], float]:
    """Sends a byte through a pseudo-terminal, waits for it, and tells the time."""
    device, port = pty.openpty()
    raw = termios.tcgetattr(port)
    raw[0] = raw[1] = raw[3] = 0
    termios.tcsetattr(port, termios.TCSANOW, raw)

    def done_s() -> float:
        os.write(device, b"w")
        select.select([port], [], [])
        os.read(port, 1)
        return time.monotonic()

    return done_s


def main() -> None:
    """Watch until standard input ends."""
    try:  # all threads alike: one that holds the interpreter is not to wait for an ordinary process
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        sys.stderr.write("no real-time priority: the witness sees what an ordinary process sees\n")
    over, stalls = threading.Event(), list[Stall]()
    cores = sorted(os.sched_getaffinity(0))
    watched: list[tuple[int, Callable[[], float]]] = [(core, time.monotonic) for core in cores]
    if sys.argv[1] == "1":
        watched.append((cores[0], _own_pty()))
    threads = [threading.Thread(target=_watch, args=(core, over, done_s, stalls)) for core, done_s in watched]
    os.write(1, b"ready\n")
    for thread in threads:
        thread.start()
    sys.stdin.read()
    over.set()
    for thread in threads:
        thread.join()
    for stall in stalls:
        print(f"{stall.began_s:.6f} {stall.lasted_s:.6f}")


if __name__ == "__main__":
    main()
