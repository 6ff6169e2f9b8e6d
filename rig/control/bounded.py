"""A law that something else may end at any tick, and the bounds that end it at the latest."""

from __future__ import annotations

import math

from rig.control.law import Law
from rig.control.motion import Swings
from rig.control.unshown import UnshownMotion
from rig.core.faults import Fault
from rig.core.signals import Sample


class Bounds:
    """When the tests end whatever is known.

    longest_s    time from the first sample, s
    most_cycles  swings to and fro
    least_rad    a way back shorter than this is no turning point

    elapsed_s    time since the first sample, s
    """

    def __init__(self, longest_s: float, most_cycles: int, least_rad: float) -> None:
        self.longest_s = longest_s
        self.most_cycles = most_cycles
        self._swings = Swings(least_rad)
        self._start_s = math.nan
        self.elapsed_s = 0.0

    @property
    def cycles(self) -> int:
        """Swings to and fro so far."""
        return self._swings.count // 2

    def take(self, sample: Sample) -> None:
        """Take a sample of a test."""
        if math.isnan(self._start_s):
            self._start_s = sample.t_s
        self.elapsed_s = sample.t_s - self._start_s
        self._swings.step(sample.y_rad)

    @property
    def reached(self) -> str:
        """The bound that is reached, in words; empty if none is."""
        if self.elapsed_s >= self.longest_s:
            return f"relay.until.longest_s, {self.longest_s:g} s, is over"
        if self.cycles >= self.most_cycles:
            return f"relay.until.most_cycles, {self.most_cycles}, are driven"
        return ""


class Bounded:
    """A law that something else may end at any tick: ``finished`` may be set from outside. It feeds the bounds.

    unshown  gives the law up where the reading stands still under its drives; None: nothing does

    last_V  the law's last drive, V
    failed  why the law itself gave up, in words: this test does not work on this motor; empty if it did not
    """

    def __init__(self, law: Law, bounds: Bounds | None, unshown: UnshownMotion | None = None) -> None:
        self._law = law
        self._bounds = bounds
        self._unshown = unshown
        self.last_V = 0.0
        self.failed = ""
        self.finished = False
        self.z_rad_s, self.yd_rad = law.z_rad_s, law.yd_rad

    def step(self, sample: Sample) -> float:
        """The law's drive, V; 0 V where it gives up. Raises Fault as the law, but for NO_CYCLE, and as ``unshown``."""
        if self._bounds is not None:
            self._bounds.take(sample)
        try:
            u_V = self._law.step(sample)
        except Fault as fault:
            if fault.code != "NO_CYCLE":
                raise
            self.failed, self.finished = fault.detail, True
            return 0.0
        self.z_rad_s, self.yd_rad = self._law.z_rad_s, self._law.yd_rad
        self.last_V = u_V
        stood = "" if self._unshown is None else self._unshown.step(sample, u_V)
        if stood:
            self.failed, self.finished = stood, True
            return 0.0
        self.finished = self.finished or self._law.finished
        return u_V
