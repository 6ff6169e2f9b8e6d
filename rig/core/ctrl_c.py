"""A Ctrl-C that comes while rig is loading or checking, and that somebody else's code swallows, is not forgotten."""

from __future__ import annotations

import signal
from types import FrameType


class CtrlC:
    """Python's own answer to SIGINT, a KeyboardInterrupt, and a note that it came.

    Python drops an exception that is raised within a finaliser, so the KeyboardInterrupt may be lost there.
    """

    def __init__(self) -> None:
        self.came = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take the signal. Raises KeyboardInterrupt."""
        self.came = True
        signal.default_int_handler(number, frame)


def begin() -> None:
    """Note each Ctrl-C from now on, unless whoever started this process has it ignored."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, CtrlC())


def raise_if_it_came(handler: object) -> None:
    """Before something may move. Raises KeyboardInterrupt where ``handler`` took a Ctrl-C that went no further."""
    if isinstance(handler, CtrlC) and handler.came:
        raise KeyboardInterrupt
