"""What a shaft that is driven must do: a reading that does not show it is frozen, or the drive is dead."""

from __future__ import annotations

import math
from collections import deque

from rig.faults import Fault
from rig.model.cycle_detector import DetectedCycle
from rig.signals import Sample


def is_obeyed(asked_V: float, acting_V: float) -> bool:
    """Whether the drive that a device reports is the one asked for, as far as its steps allow.

    Half a percent and 50 mV are more than steps of 8 bits can explain.
    """
    return abs(acting_V - asked_V) <= 0.05 + 0.005 * abs(asked_V)


class Standstill:
    """How long a reading has kept within a span: since it last left it, at the start since the first sample.

    still_s           that time, s
    low_rad, high_rad readings meanwhile
    same_s            time for which the reading has not changed at all, s
    longest_s         longest stand so far that the reading has left, s
    """

    def __init__(self) -> None:
        self.longest_s = 0.0
        self.restart()

    def restart(self) -> None:
        """Begin anew at the next sample."""
        self.still_s = 0.0
        self.same_s = 0.0
        self.low_rad = math.inf
        self.high_rad = -math.inf
        self._since_s = math.nan
        self._changed_s = math.nan
        self._last_rad = math.nan

    def step(self, t_s: float, y_rad: float, span_rad: float) -> float:
        """Time for which the reading has stood at this sample, s: readings nearer than ``span_rad`` are one place."""
        self.low_rad, self.high_rad = min(self.low_rad, y_rad), max(self.high_rad, y_rad)
        leaves = self.high_rad - self.low_rad >= span_rad
        if leaves:
            self.longest_s = max(self.longest_s, t_s - self._since_s)
        if leaves or math.isnan(self._since_s):
            self._since_s, self.low_rad, self.high_rad = t_s, y_rad, y_rad
        if y_rad != self._last_rad:
            self._changed_s, self._last_rad = t_s, y_rad
        self.still_s, self.same_s = t_s - self._since_s, t_s - self._changed_s
        return self.still_s

    def words(self) -> str:
        """What the readings of a stand that should not be say about its cause, as far as they can."""
        if self.same_s < 0.3 * self.still_s:
            return "the reading still flickers, so the sensor lives: look at the drive's supply and the coupling first"
        return (
            f"the reading has not changed at all for {self.same_s:.2f} s: "
            "if it flickers at rest, look at the wiper's wire first"
        )


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
    """A cycle of the relays that goes on never stands still for long, whatever the relays drive.

    The shaft stands where it turns, a little longer where the drive before it is below friction, and moves everywhere
    else. The longest stand of the last periods is learned, and ``LONGER`` times that is allowed; but not less than a
    part ``LEAST`` of the longest of these periods, nor more than ``MOST`` of it. A cycle goes on where both last
    periods were accepted, are nearly alike, and the amplitude keeps or grows: one that dies away may well stand, and is
    not judged. Where another drive has acted than the relays asked for (the guard has braked), the shaft may stop
    anywhere, and an inner level below friction leaves it there until the integral turns: what was learned is forgotten.

    min_amplitude_rad  smallest amplitude of a limit cycle; a quarter of it, or the part ``SPAN`` of the amplitude, is
                       what a reading keeps within while the shaft stands
    """

    LONGER = 3.0
    LEAST = 0.6
    MOST = 1.0
    SPAN = 0.05
    PERIODS = 3  # the last ones
    KEEPS = 0.9  # an amplitude of at least this part of the one before
    ALIKE = 0.3  # largest relative difference of two periods
    ASKED = 4  # last drives asked for, of which one acts: some may get lost, or be told of later

    def __init__(self, min_amplitude_rad: float) -> None:
        self.longest_s = 0.0  # stand of the last periods
        self.allowed_s = math.inf
        self._granted_s = math.inf
        self._span_rad = self._least_rad = 0.25 * min_amplitude_rad
        self.standstill = Standstill()
        self._running_s = 0.0
        self._last: deque[tuple[DetectedCycle, float]] = deque(maxlen=self.PERIODS)  # with its longest stand
        self._asked_V: deque[float] = deque(maxlen=self.ASKED)

    def step(self, sample: Sample, u_V: float) -> None:
        """Take one sample, and what the relays ask for on it. Raises Fault SENSOR_STUCK where it stands too long."""
        # a relay in the device tells of no effect here: its rows have been compared with what the law decides
        if math.isfinite(sample.t_u_s) and not any(is_obeyed(asked_V, sample.u_V) for asked_V in self._asked_V):
            self._last.clear()
            self.allowed_s = self._granted_s = math.inf
        self._asked_V.append(u_V)
        still_s = self.standstill.step(sample.t_s, sample.y_rad, self._span_rad)
        self._running_s = max(self._running_s, still_s)
        if still_s == 0.0:
            self._granted_s = self.allowed_s  # for this stand, also where the relays' integral ends a period meanwhile
        if still_s > self._granted_s:
            raise Fault(
                "SENSOR_STUCK",
                f"the reading has stood for {still_s:.2f} s, at {u_V:+.2f} V; in the cycles before it never stood "
                f"longer than {self.longest_s:.2f} s; {self.standstill.words()}",
            )

    def end_period(self, cycle: DetectedCycle) -> None:
        """A period is over: learn from it."""
        before = self._last[-1][0] if self._last else None
        self._last.append((cycle, self._running_s))
        self._running_s = 0.0
        self._span_rad = max(self._least_rad, self.SPAN * cycle.amplitude_rad)
        self.longest_s = max(still_s for _, still_s in self._last)
        goes_on = (
            before is not None
            and before.accepted
            and cycle.accepted
            and cycle.amplitude_rad > self.KEEPS * before.amplitude_rad
            and abs(cycle.period_s / before.period_s - 1.0) < self.ALIKE
        )
        period_s = max(one.period_s for one, _ in self._last)
        self.allowed_s = (
            min(max(self.LONGER * self.longest_s, self.LEAST * period_s), self.MOST * period_s) if goes_on else math.inf
        )
