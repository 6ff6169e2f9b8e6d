"""The loop of rig, on a bench that answers at once: for `wake_up.py`, which tells what comes in and goes out.

our_loop.py PRIORITY SPIN_US
"""

from __future__ import annotations

import math
import sys
import time

from rig.control.guard import Guard, GuardSettings
from rig.daq.driver import DeviceInfo, DeviceWatchdog
from rig.loop.clock import MonotonicClock
from rig.loop.real_time import RealTimeSettings, real_time
from rig.loop.runner import Loop
from rig.loop.stop_request import StopRequest
from rig.recording.record import NoRecord
from rig.signals import Limits, Order, Sample

LIMITS = Limits(soft_rad=(-1.0, 1.0), hard_rad=(-2.0, 2.0), max_u_V=3.0, watchdog_s=0.1)
GUARD = GuardSettings(LIMITS, (5, 1018), 5.0, 0.2, 0.1, noise_rad=0.004, motion_rad=0.02)


class StillBench:
    """A shaft that stands at zero, and no link to it."""

    order: Order = "sample_first"
    failsafe = DeviceWatchdog(0.1)
    backend = "nothing"
    link_statistics: dict[str, int] = {}  # noqa: RUF012 - the interface's

    def open(self) -> DeviceInfo:
        """Nothing to meet."""
        return DeviceInfo("-", "-", "-", emulated=True)

    def arm(self, limits: Limits) -> None:
        """Nothing to arm."""

    def read(self) -> Sample:
        """At rest at zero."""
        now_s = time.monotonic()
        return Sample(now_s, 0.0, 512, t_u_s=now_s)

    def write(self, u_V: float) -> None:
        """Nothing to drive."""

    def safe_stop(self) -> bool:
        """It stands."""
        return True

    def close(self) -> None:
        """Nothing to close."""


class Lateness(NoRecord):
    """Keeps how late each tick was, us."""

    def __init__(self) -> None:
        self.late_us: list[float] = []

    def sample(self, *row: object) -> None:
        """Keep that column."""
        late_us = row[6]
        assert isinstance(late_us, float)
        self.late_us.append(late_us)


class Ticks:
    """0 V for a number of ticks, as `Constant` does for a time."""

    z_rad_s = yd_rad = math.nan

    def __init__(self, ticks: int) -> None:
        self._left = ticks
        self.finished = False

    def step(self, sample: Sample) -> float:
        """0 V."""
        self._left -= 1
        self.finished = self._left <= 0
        return 0.0


def main() -> int:
    """Answer each line until the input ends."""
    priority, spin_us = int(sys.argv[1]), float(sys.argv[2])
    with real_time(RealTimeSettings(priority)) as done:
        for line in done.refused:
            print(f"our_loop: {line}", file=sys.stderr)
        for line in sys.stdin:
            ticks, period_us = line.split()
            record = Lateness()
            clock = MonotonicClock(1e-6 * spin_us)
            loop = Loop(StillBench(), clock, Guard(GUARD), record, 1e-6 * float(period_us), StopRequest())
            with loop.armed(LIMITS):
                loop.run(Ticks(int(ticks)), "still")
            print(loop.statistics.skipped, *(f"{1e3 * late_us:.0f}" for late_us in record.late_us), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
