"""What asks a run to stop: a signal, another process by the run's stop flag, or nobody being there any more.

The loop looks once a tick. A law of a user's own may never return to it: a signal raises out of that law.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

from rig.control.law import Stopped, is_of_own_law
from rig.core import ctrl_c
from rig.core.faults import Fault
from rig.run_folder.live.law_lease import LawLease
from rig.run_folder.live.stop_flag import StopFlag

STOP_SIGNALS: Final[tuple[signal.Signals, ...]] = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP")  # Ctrl-\ and Ctrl-Z would leave a drive on
    if hasattr(signal, name)
)

# whoever has it ignored, as nohup, wants a run that outlives the terminal
_NOHUP: Final = next((number for number in STOP_SIGNALS if number.name == "SIGHUP"), None)

Gone = Callable[[], str]


class StopRequest:
    """Keeps in ``reason`` what asked for a stop: the name of a signal, or who set the stop flag; None: nothing did.

    flag  of what drives; None: only signals count, as in a simulation
    gone  says who has to be there while it drives and is not: the reason; empty: all is well
    """

    def __init__(self, flag: StopFlag | None = None, gone: Gone | None = None) -> None:
        self.reason: str | None = None
        self.flag = flag
        self.held: dict[signal.Signals, StopRequest | signal.Handlers] = {}  # what takes each signal meanwhile
        self.lease: LawLease | None = None  # where a keeper sees that the loop goes on
        self._gone = gone

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take the signal; the first one counts. Each raises ``Stopped`` out of a user's own law that is at work."""
        if self.reason is None:
            self.reason = signal.Signals(number).name
        if is_of_own_law(frame):
            raise Stopped(Fault("INTERRUPTED", self.reason))

    def tell_drive(self, *, is_on: bool) -> None:
        """Tell others whether a drive may be on. Raises Fault as ``StopFlag.tell_drive``."""
        if self.lease is not None:
            self.lease.tell_drive(is_on=is_on)
        if self.flag is not None:
            self.flag.tell_drive(is_on=is_on)

    def tell_idle(self, *, is_idle: bool) -> None:
        """Tell a keeper whether the loop waits for nothing but its tick: then it may soon be called stuck."""
        if self.lease is not None:
            self.lease.tell_idle(is_idle=is_idle)

    def take_signals(self) -> None:
        """Take the signals back from others' code in this process, which may have taken or blocked them, also in C."""
        for number, handler in self.held.items():
            signal.signal(number, handler)
        if self.held and hasattr(signal, "pthread_sigmask"):
            signal.pthread_sigmask(signal.SIG_UNBLOCK, self.held)

    @property
    def is_for_all(self) -> bool:
        """Whether every Stop was told of what drives."""
        return self.flag is not None and self.flag.is_tried

    def look(self) -> str | None:
        """The reason, after a look at the flag, and at whether those are there who have to be."""
        if self.lease is not None:
            self.lease.look()
        # a signal may come during a look: what it asked for must stay
        if self.reason is None and self.flag is not None and (by := self.flag.asked_by()):
            self.reason = f"Stop by {by}"
        if self.reason is None and self._gone is not None and (gone := self._gone()):
            self.reason = gone
        return self.reason


@contextmanager
def stop_on_signals(flag: StopFlag | None = None, gone: Gone | None = None) -> Iterator[StopRequest]:
    """Within the block each of ``STOP_SIGNALS`` sets the request, and neither ends nor stops the process.

    But a SIGHUP that is ignored when the block begins, as after `nohup`, stays ignored.

    flag, gone  as of ``StopRequest``
    Raises KeyboardInterrupt, before the block, where a Ctrl-C had come that nobody heeded.
    """
    request = StopRequest(flag, gone)
    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    for number, handler in before.items():
        is_ignored = number == _NOHUP and handler is signal.SIG_IGN
        request.held[number] = signal.SIG_IGN if is_ignored else request
    request.take_signals()
    try:
        ctrl_c.raise_if_it_came(before[signal.SIGINT])
        yield request
    finally:
        request.held = {}
        for number, handler in before.items():
            signal.signal(number, handler)
