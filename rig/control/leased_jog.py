"""A drive that somebody has to promise anew all the time: `rig jog --leased`."""

from __future__ import annotations

from collections.abc import Callable

from rig.control.law import BareLaw, Rest
from rig.core.signals import Sample

IDLE_S = 30.0


class LeasedDrive(BareLaw):
    """The drive that is promised at each tick, and 0 V where none is.

    It ends when nobody will promise any more, after ``longest_s``, or after ``idle_s`` without any drive, s.

    promised  the drive that is promised now, V; 0.0: none; None: nobody will promise any more
    changed   called with each new promise, before its drive goes out
    """

    def __init__(
        self,
        promised: Callable[[], float | None],
        changed: Callable[[float | None], None],
        longest_s: float,
        idle_s: float = IDLE_S,
    ) -> None:
        self._promised = promised
        self._changed = changed
        self._idle_s = idle_s
        self._whole = Rest(longest_s)
        self._idle = Rest(idle_s)
        self._last: float | None = 0.0

    def step(self, sample: Sample) -> float:
        """Return the drive that is promised, V."""
        promised = self._promised()
        if promised != self._last:
            self._last = promised
            self._changed(promised)
        self._whole.step(sample)
        if promised:
            self._idle = Rest(self._idle_s)
        else:
            self._idle.step(sample)
        self.finished = promised is None or self._whole.finished or self._idle.finished
        return 0.0 if self.finished or promised is None else promised
