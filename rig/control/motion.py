"""How a driven shaft must move. If the reading does not show that, the sensor is frozen or the drive is dead."""

from __future__ import annotations

import math
from collections import deque

from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.cycle_detector import DetectedCycle


class Gaps:
    """Finds gaps between readings: the host stood still, or a reply came late. The device held its drive meanwhile."""

    STEPS, LEAST_S = 3.0, 0.03  # times the last step that was none, and s: a longer step is a gap

    def __init__(self) -> None:
        self._last_s = math.nan
        self._step_s = math.nan  # between the last two readings that were no gap

    def step(self, t_s: float) -> float:
        """How much longer than the steps before the one to this reading was, s; 0.0: it was no gap."""
        since_s, self._last_s = t_s - self._last_s, t_s
        if since_s > max(self.STEPS * self._step_s, self.LEAST_S):
            return since_s - self._step_s
        if not math.isnan(since_s):
            self._step_s = since_s
        return 0.0


def is_obeyed(asked_V: float, acting_V: float) -> bool:
    """Whether the drive that a device reports is the one asked for, as far as its steps allow.

    Half a percent and 50 mV are more than steps of 8 bits can explain.
    """
    return abs(acting_V - asked_V) <= 0.05 + 0.005 * abs(asked_V)


class Standstill:
    """How long a reading has stood still: stayed within a span. A gap between two readings does not count.

    still_s           time since it last left the span, or since the first sample, s
    low_rad, high_rad lowest and highest reading in that time
    same_s            time for which the reading has not changed at all, s
    longest_s         longest standstill so far that has ended, s
    """

    def __init__(self) -> None:
        self.longest_s = 0.0
        self._gaps = Gaps()
        self.restart()

    def restart(self) -> None:
        """Start again at the next sample."""
        self.still_s = 0.0
        self.same_s = 0.0
        self.low_rad = math.inf
        self.high_rad = -math.inf
        self._since_s = math.nan
        self._changed_s = math.nan
        self._last_rad = math.nan

    def step(self, t_s: float, y_rad: float, span_rad: float) -> float:
        """How long the reading has stood still, s; readings within ``span_rad`` of each other count as one position."""
        unseen_s = self._gaps.step(t_s)  # the shaft may have gone to and fro
        self._since_s += unseen_s
        self._changed_s += unseen_s
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
        """The probable cause of a standstill that should not be, by its readings."""
        if self.same_s < 0.3 * self.still_s:
            return "the reading still flickers, so the sensor works: check the drive's supply and the coupling first"
        return (
            f"the reading has not changed at all for {self.same_s:.2f} s: "
            "if it flickers at rest, check the wiper's wire first"
        )


class Swings:
    """The turning points of a shaft that goes to and fro; noise makes none.

    least_rad      a way back shorter than this is no turn

    count          turning points so far
    last_turn_rad  the last turning point, rad; nan before the first
    half_way_rad   half of the way between the last two turning points, rad; nan before the second
    """

    def __init__(self, least_rad: float) -> None:
        self.least_rad = least_rad
        self.count = 0
        self.half_way_rad = math.nan
        self._low_rad, self._high_rad = math.inf, -math.inf  # since the last turning point
        self._way = 0
        self.last_turn_rad = math.nan

    def step(self, y_rad: float) -> bool:
        """Take a reading. Returns whether it shows that the shaft has turned."""
        self._low_rad, self._high_rad = min(self._low_rad, y_rad), max(self._high_rad, y_rad)
        fallen, risen = self._high_rad - y_rad, y_rad - self._low_rad
        if self._way == 0:
            if max(fallen, risen) >= self.least_rad:
                self._way = 1 if risen > fallen else -1
            return False
        turned = (fallen if self._way > 0 else risen) >= self.least_rad
        if turned:
            turn_rad = self._high_rad if self._way > 0 else self._low_rad
            self.half_way_rad = 0.5 * abs(turn_rad - self.last_turn_rad)
            self.last_turn_rad = turn_rad
            self._low_rad = self._high_rad = y_rad
            self._way = -self._way
            self.count += 1
        return turned


class CycleWatch:
    """Finds a frozen reading during a relay test: in a steady cycle the shaft never stands still for long.

    In a cycle the shaft stands still only where it turns; a little longer if the drive before that is below friction.
    The watch learns the longest standstill of the last periods, and allows ``LONGER`` times that, but at least
    ``LEAST`` and at most ``MOST`` of the longest of these periods. It judges only a steady cycle: the last two periods
    were accepted, are nearly equal, and the amplitude stays or grows. In a cycle that dies away the shaft may stand.

    If another drive has acted than the relays asked for (the guard has braked), the watch forgets what it has learned:
    the shaft may stop anywhere, and a drive below friction leaves it there until the integral changes sign.

    min_amplitude_rad  smallest amplitude of a limit cycle; a reading stands still if it stays within a quarter of this,
                       or within the part ``SPAN`` of the amplitude
    """

    LONGER = 3.0
    LEAST = 0.6
    MOST = 1.0
    SPAN = 0.05
    PERIODS = 3  # the last ones
    KEEPS = 0.9  # the amplitude stays if it is at least this part of the one before
    ALIKE = 0.3  # largest relative difference of two periods
    ASKED = 4  # one of the last drives asked for must act: some get lost, or are reported later

    def __init__(self, min_amplitude_rad: float) -> None:
        self.longest_s = 0.0  # longest standstill of the last periods
        self.allowed_s = math.inf
        self._granted_s = math.inf
        self._span_rad = self._least_rad = 0.25 * min_amplitude_rad
        self.standstill = Standstill()
        self._running_s = 0.0
        self._last: deque[tuple[DetectedCycle, float]] = deque(maxlen=self.PERIODS)  # with its longest standstill
        self._asked_V: deque[float] = deque(maxlen=self.ASKED)

    def wait(self, drives: int) -> None:
        """So many drives wait in the device until they act."""
        self._asked_V = deque(maxlen=self.ASKED + drives)

    def step(self, sample: Sample, u_V: float) -> None:
        """Take a sample, and the drive that the relays ask for. Raises Fault SENSOR_STUCK if it stands too long."""
        # not for a relay in the device: the loop has compared its rows with the law already
        if math.isfinite(sample.t_u_s) and not any(is_obeyed(asked_V, sample.u_V) for asked_V in self._asked_V):
            self._last.clear()
            self.allowed_s = self._granted_s = math.inf
        self._asked_V.append(u_V)
        still_s = self.standstill.step(sample.t_s, sample.y_rad, self._span_rad)
        self._running_s = max(self._running_s, still_s)
        if still_s == 0.0:
            self._granted_s = self.allowed_s  # for this standstill, even if a period ends meanwhile
        if still_s > self._granted_s:
            raise Fault(
                "SENSOR_STUCK",
                f"the reading has stood still for {still_s:.2f} s, at {u_V:+.2f} V; in the cycles before it never "
                f"stood still for longer than {self.longest_s:.2f} s; {self.standstill.words()}",
            )

    def end_period(self, cycle: DetectedCycle) -> None:
        """Learn from a period that is over."""
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
