"""Whether somebody has stopped a process that this one has started, as by SIGSTOP: it lives, and does nothing."""

from __future__ import annotations

import math
import os
import time
from typing import Final

_WAKES_S: Final = 0.1  # one that was stopped together with this process may go on so much later
WORDS: Final = "somebody has stopped the keeper, as by SIGSTOP"


class Halts:
    """Looks at a child, whose number it is given."""

    def __init__(self, pid: int) -> None:
        self._pid, self._since_s = pid, math.inf

    @property
    def is_stopped(self) -> bool:
        """Whether it is stopped now; False for one that has ended, and where the system does not tell."""
        if not hasattr(os, "waitid"):  # not on macOS before Python 3.13
            return False
        try:
            return os.waitid(os.P_PID, self._pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is not None
        except ChildProcessError:
            return False

    @property
    def is_for_good(self) -> bool:
        """Whether it has been stopped for longer than a machine that goes on may leave it so; to be asked often."""
        if not self.is_stopped:
            self._since_s = math.inf
            return False
        now_s = time.monotonic()
        self._since_s = min(self._since_s, now_s)
        return now_s - self._since_s > _WAKES_S
