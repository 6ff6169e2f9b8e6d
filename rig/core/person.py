"""Who sits at the terminal, where somebody does: a device may need a hand before it is driven."""

from __future__ import annotations

from collections.abc import Callable

Asks = Callable[[str, Callable[[], bool]], bool]  # says what to do, and waits until it is seen; whether it was in time

asks: Asks | None = None  # set by a command on a terminal; None: nobody can be asked
