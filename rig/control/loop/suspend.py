"""Notices that the machine was suspended: the host's clock then stood still, and the device's went on.

Every time of the device would be late by the length of the suspend; from 35 minutes on it would look as if the device
had restarted (``rig.backends.serial.device_clock``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rig.backends.driver import Clock
from rig.core.faults import Fault

NOTICED_S = 0.01  # no machine sleeps for less
EXPLAINED = frozenset(  # faults that a suspend brings about
    {
        "DEVICE_NOT_ARMED",
        "DEVICE_RESET",
        "DEVICE_WATCHDOG",
        "LATE",
        "LINK_GAP",
        "LINK_LOST",
        "LINK_REPLY",
        "LINK_TIMEOUT",
        "RECORDER_DEAD",
        "SAMPLE_STALE",
        "SENSOR_JUMP",
    }
)


class SuspendWatch:
    """Asks a clock whether the machine was suspended since the clock was made.

    clock  has a method ``asleep_s`` if it can tell; any other one has not been suspended
    """

    def __init__(self, clock: Clock) -> None:
        self._asleep_s: Callable[[], float] = getattr(clock, "asleep_s", lambda: 0.0)

    def check(self, then: str = "") -> None:
        """Raise Fault SUSPENDED if the machine was suspended; ``then``: what came of it."""
        asleep_s = self._asleep_s()
        if asleep_s > NOTICED_S:
            raise Fault("SUSPENDED", f"for {asleep_s:.1f} s" + (f"; then {then}" if then else ""))

    @contextmanager
    def told(self) -> Iterator[None]:
        """For the block, a fault that a suspend explains is raised as SUSPENDED, with what it was."""
        try:
            yield
        except Fault as fault:
            if fault.code in EXPLAINED:
                try:
                    self.check(str(fault))
                except Fault as suspended:
                    raise suspended from fault
            raise
