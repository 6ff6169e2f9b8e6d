"""The interface of a law, which turns each sample into a drive; and the two simplest laws."""

from __future__ import annotations

import math
from typing import Protocol

from rig.signals import Sample


class Law(Protocol):
    """A control law. The loop calls ``step`` once a tick until ``finished``.

    z_rad_s (integral of the position) and yd_rad (reference) are recorded beside the drive; nan if the law has none.
    """

    finished: bool
    z_rad_s: float
    yd_rad: float

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V. Raises Fault if the law finds something wrong with the bench."""
        ...


class Rest:
    """0 V for a given time, s: the shaft coasts to a stop."""

    z_rad_s = math.nan
    yd_rad = math.nan

    def __init__(self, duration_s: float) -> None:
        self.duration_s = duration_s
        self.finished = False
        self._start_s = math.nan

    def step(self, sample: Sample) -> float:
        """Return 0 V; finished once ``duration_s`` has passed since the first sample."""
        if math.isnan(self._start_s):
            self._start_s = sample.t_s
        self.finished = sample.t_s - self._start_s >= self.duration_s
        return 0.0


class Constant:
    """A constant drive for a given time: `rig jog`."""

    z_rad_s = math.nan
    yd_rad = math.nan

    def __init__(self, u_V: float, duration_s: float) -> None:
        self.u_V = u_V
        self._rest = Rest(duration_s)
        self.finished = False

    def step(self, sample: Sample) -> float:
        """Return the constant drive, V, and 0 V once the time is over."""
        self._rest.step(sample)
        self.finished = self._rest.finished
        return 0.0 if self.finished else self.u_V
