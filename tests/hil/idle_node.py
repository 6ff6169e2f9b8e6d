"""Processes of node, for one emulated chip after the other: to start one takes longer than most tests."""

from __future__ import annotations

import atexit
import subprocess
from typing import Any


class IdleNode:
    """Those that no chip is in; they end with this process."""

    def __init__(self) -> None:
        self._idle: list[subprocess.Popen[Any]] = []
        atexit.register(self._end)

    def take(self) -> subprocess.Popen[Any] | None:
        """One of them, if there is one."""
        return self._idle.pop() if self._idle else None

    def keep(self, process: subprocess.Popen[Any]) -> None:
        """For the next chip, if it has not ended."""
        if process.poll() is None:
            self._idle.append(process)

    def _end(self) -> None:
        for process in self._idle:
            process.communicate()  # they end with their standard input
