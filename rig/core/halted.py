"""Whether a process that this one has started works for it: it may have ended, or somebody may have stopped it."""

from __future__ import annotations

import math
import os
import subprocess
import time
from typing import Final

_WAKES_S: Final = 0.1  # one that was stopped together with this process may go on so much later
_STOPPED: Final = getattr(os, "CLD_STOPPED", 5)  # not on Windows
_ENDED: Final = -1
# 0 on macOS before Python 3.13, which tells of no stop, and on Windows
_LOOKS: Final = os.WSTOPPED | os.WEXITED | os.WNOHANG | os.WNOWAIT if hasattr(os, "waitid") else 0


def end_within(process: subprocess.Popen[bytes] | subprocess.Popen[str], longest_s: float) -> None:
    """Wait for the end of a child; one that takes longer is killed."""
    try:
        process.wait(longest_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


class Halts:
    """Looks at a child, the keeper of a device or of a law."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process, self._since_s = process, math.inf

    @property
    def is_stopped(self) -> bool:
        """Whether it is stopped now, as by SIGSTOP; False where it has ended, and where the system does not tell."""
        return self.event() == _STOPPED

    @property
    def words(self) -> str:
        """Why it does nothing any more; empty while it works, or may go on with a machine that stood still.

        To be asked often: one system call while it works.
        """
        if (event := self.event()) is None:
            return ""
        if event != _STOPPED:
            return f"the keeper ended with status {self._process.poll()}"
        now_s = time.monotonic()
        self._since_s = min(self._since_s, now_s)
        return "somebody has stopped the keeper, as by SIGSTOP" if now_s - self._since_s > _WAKES_S else ""

    def event(self) -> int | None:
        """_STOPPED, _ENDED or another code of SIGCHLD that says so; None: it goes on."""
        if not _LOOKS:
            return None if self._process.poll() is None else _ENDED
        try:
            told = os.waitid(os.P_PID, self._process.pid, _LOOKS)
        except ChildProcessError:  # somebody has waited for it
            return _ENDED
        if told is None:
            self._since_s = math.inf
            return None
        return told.si_code
