"""Who stops a servo if the process that drives it dies or hangs, as a driver sees it."""

from __future__ import annotations

from typing import Protocol


class Guardian(Protocol):
    """Who stops the servo if this process dies or hangs."""

    @property
    def has_acted(self) -> bool:
        """Whether it has stopped the servo because this process was silent."""
        ...

    def beat(self) -> None:
        """The process lives, and may drive. Raises Fault SERVO_UNWATCHED where nobody hears it."""
        ...

    def rest(self) -> None:
        """Nothing drives: silence is no sign of anything."""
        ...

    def end(self, *, restored: bool) -> None:
        """It is needed no more."""
        ...
