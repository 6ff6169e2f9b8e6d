"""The end of standard input. A helper process ends there: its parent has closed the pipe, or is gone."""

from __future__ import annotations

import contextlib
import os
import threading
from typing import Protocol


class EndOfInput(Protocol):
    """What can be waited for."""

    def wait(self, timeout: float) -> bool:
        """Wait for the end, at most ``timeout`` seconds. Returns whether it has come."""


def end_of_input() -> EndOfInput:
    """The end of this process's standard input. A thread reads it, because not every system can poll a pipe."""
    over = threading.Event()

    def read() -> None:
        with contextlib.suppress(OSError):
            while os.read(0, 4096):
                pass
        over.set()

    threading.Thread(target=read, daemon=True).start()
    return over
