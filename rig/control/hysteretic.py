"""One run of the hysteretic relay from rest: the experiment for the least-squares method (docs/theory.md 5.1)."""

from __future__ import annotations

import math

from rig.control.law import BareLaw
from rig.control.relay import HystereticRelay
from rig.core.faults import Fault
from rig.core.signals import Sample


class HystereticRun(BareLaw):
    """Rest at 0 V, then run the relay until it has switched ``switchings`` times.

    The rest is recorded, too: it shows where the run starts, and that it starts from rest.

    relay       a fresh relay; its first drive is +d_V
    rest_s      time at 0 V before, s; the shaft must be at zero already
    switchings  number of switchings after which the run ends; the method needs only the first
    timeout_s   longest wait for a switching, s: before the first it raises Fault NO_SWITCHING, later the run just ends

    Results: ``first_switching_s``, time of the sample at the first switching (nan before); ``seen``, switchings so far.
    Raises ValueError for ``switchings`` below 1, and for a time-out that is not > 0.
    """

    def __init__(self, relay: HystereticRelay, rest_s: float, switchings: int, timeout_s: float) -> None:
        if switchings < 1 or not timeout_s > 0.0:
            raise ValueError("a run needs at least one switching and a time-out > 0 s")
        self.relay = relay
        self.rest_s = rest_s
        self.switchings = switchings
        self.timeout_s = timeout_s
        self.first_switching_s = math.nan
        self.seen = 0
        self._since_s = math.nan  # since the first drive, or the last switching
        self._last_V = relay.d_V

    def step(self, sample: Sample) -> float:
        """Drive of the relay at this sample, V; 0 V while resting and when the run is over."""
        t_s = sample.t_s
        if self._elapsed_s(sample) < self.rest_s:
            return 0.0
        if math.isnan(self._since_s):
            self._since_s = t_s
        u_V = self.relay.step(sample)
        if u_V != self._last_V:
            self.seen += 1
            self._last_V, self._since_s = u_V, t_s
            if self.seen == 1:
                self.first_switching_s = t_s
        elif t_s - self._since_s > self.timeout_s:
            if self.seen == 0:
                raise Fault(
                    "NO_SWITCHING",
                    f"{self.relay.d_V:+.2f} V for {self.timeout_s:.0f} s, y = {sample.y_rad:+.3f} rad, "
                    f"eps = {self.relay.eps_rad:.3f} rad",
                )
            self.finished = True
        self.finished = self.finished or self.seen >= self.switchings
        return 0.0 if self.finished else u_V
