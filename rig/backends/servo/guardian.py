"""The keeper of a servo as its driver sees it: who stops it if the driver's process dies or hangs."""

from __future__ import annotations

from typing import Protocol

from rig.core.faults import Fault


class Guardian(Protocol):
    """Who stops the servo if this process dies or hangs."""

    @property
    def has_acted(self) -> bool:
        """Whether it has stopped the servo because this process was silent."""

    def beat(self) -> None:
        """The process lives, and may drive. Raises Fault SERVO_UNWATCHED where nobody hears it."""

    def waits(self) -> None:
        """The process lives, and asks: a wait for an answer is no silence. Says nothing while nothing drives."""

    def rest(self) -> None:
        """Nothing drives: silence is no sign of anything."""

    def end(self, *, restored: bool) -> None:
        """It is needed no more."""


def beat(guardian: Guardian) -> None:
    """Tell it that this process lives, right before it drives.

    Whether it has acted is looked at last: this process may have stood still anywhere ahead of that.
    Raises Fault SERVO_UNWATCHED, or that of ``stopped_by_keeper``.
    """
    guardian.beat()
    if guardian.has_acted:
        raise stopped_by_keeper()


def stopped_by_keeper() -> Fault:
    """DEVICE_WATCHDOG: what to raise where it has acted."""
    return Fault("DEVICE_WATCHDOG", "rig's keeper has heard nothing for too long, and stopped the servo")
