"""What a shaft that is driven must do: a reading that does not show it is frozen, or the drive is dead."""

from __future__ import annotations

import math
from collections import deque

from rig.faults import Fault
from rig.model.cycle_detector import DetectedCycle
from rig.signals import Sample


class Standstill:
    """How long a reading has kept within a span: since it last left it, at the start since the first sample."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin anew at the next sample."""
        self._since_s = math.nan
        self.low_rad = math.inf
        self.high_rad = -math.inf

    def step(self, t_s: float, y_rad: float, span_rad: float) -> float:
        """Time for which the reading has stood at this sample, s: readings nearer than ``span_rad`` are one place."""
        self.low_rad, self.high_rad = min(self.low_rad, y_rad), max(self.high_rad, y_rad)
        if self.high_rad - self.low_rad >= span_rad or math.isnan(self._since_s):
            self._since_s, self.low_rad, self.high_rad = t_s, y_rad, y_rad
        return t_s - self._since_s


class Gain:
    """The speed that a lasting drive has given a shaft, which it cannot lose while the drive lasts.

    Under a constant drive u above friction the speed goes to K (u - f), from below or from above and never back. One
    that has risen by some amount since the drive began is below that end, and stays at least as high. Where friction
    falls with speed the end is higher still.

    settling_s     time at the drive's begin that counts as before it: for the latency, and for the lag of the velocity
    """

    FALLEN = 0.9  # a drive below this part of its largest is another drive

    def __init__(self, settling_s: float) -> None:
        self.settling_s = settling_s
        self.restart()

    def restart(self) -> None:
        """Another drive begins at the next sample."""
        self.speed_rad_s = 0.0
        self._since_s = math.nan
        self._largest_V = 0.0
        self._before_rad_s = 0.0

    def step(self, t_s: float, v_rad_s: float, u_V: float) -> float:
        """Speed in the drive's direction that this drive has given so far, rad/s, >= 0."""
        along = math.copysign(v_rad_s, v_rad_s * u_V)
        if abs(u_V) < self.FALLEN * self._largest_V:
            self.restart()
        self._largest_V = max(self._largest_V, abs(u_V))
        if math.isnan(self._since_s):
            self._since_s = t_s
        if t_s - self._since_s <= self.settling_s:
            self._before_rad_s = max(self._before_rad_s, along)
        self.speed_rad_s = max(self.speed_rad_s, along - self._before_rad_s)
        return self.speed_rad_s


class CycleWatch:
    """A settled limit cycle never stands still much longer than it did before.

    The shaft stands where it turns, and moves everywhere else, whatever the relays drive there. The longest stand of
    the last periods is learned; ``LONGER`` times that is allowed, and the part ``LEAST`` of a period in any case.

    min_amplitude_rad  smallest amplitude of a limit cycle; a quarter of it, or the part ``SPAN`` of the amplitude, is
                       what a reading keeps within while the shaft stands
    """

    LONGER = 3.0
    LEAST = 1.0 / 6.0
    SPAN = 0.05
    PERIODS = 3

    def __init__(self, min_amplitude_rad: float) -> None:
        self.still_s = 0.0
        self.longest_s = 0.0
        self.allowed_s = math.inf
        self._span_rad = self._least_rad = 0.25 * min_amplitude_rad
        self._standstill = Standstill()
        self._running_s = 0.0
        self._last: deque[tuple[float, float]] = deque(maxlen=self.PERIODS)

    def step(self, sample: Sample) -> None:
        """Take one sample."""
        self.still_s = self._standstill.step(sample.t_s, sample.y_rad, self._span_rad)
        self._running_s = max(self._running_s, self.still_s)

    def end_period(self, cycle: DetectedCycle) -> None:
        """A period is over: learn from it."""
        self._last.append((self._running_s, cycle.period_s))
        self._running_s = 0.0
        self._span_rad = max(self._least_rad, self.SPAN * cycle.amplitude_rad)
        self.longest_s = max(still_s for still_s, _ in self._last)
        self.allowed_s = max(self.LONGER * self.longest_s, self.LEAST * max(period_s for _, period_s in self._last))

    def check(self, u_V: float) -> None:
        """Raises Fault SENSOR_STUCK where the reading has stood too long. ``u_V`` is what drives, for the message."""
        if self.still_s > self.allowed_s:
            raise Fault(
                "SENSOR_STUCK",
                f"the reading has stood for {self.still_s:.2f} s, at {u_V:+.2f} V; in the cycles before it never stood "
                f"longer than {self.longest_s:.2f} s",
            )
