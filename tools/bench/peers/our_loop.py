"""The loop of rig, on a bench that answers at once: for `wake_up.py`, which tells what comes in.

our_loop.py PRIORITY SPIN_US

What goes out, and when ticks are due, is what `wake_up_loop.c` says.
"""

from __future__ import annotations

import math
import os
import resource
import sys
import time

from rig.backends.clock import MonotonicClock
from rig.backends.driver import DeviceInfo, DeviceWatchdog
from rig.control.guard import Guard, GuardSettings
from rig.control.loop.real_time import RealTimeSettings, real_time
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.core.signals import Limits, Order, Sample
from rig.run_folder.live.stop_flag import StopFlag
from rig.run_folder.recording.sink import NullSink

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


class Evidence:
    """What the kernel counts of this thread."""

    def __init__(self) -> None:
        self._file = os.open("/proc/thread-self/schedstat", os.O_RDONLY)

    def until_now(self) -> tuple[int, int]:
        """Ready to run without running, ns; page faults."""
        usage = resource.getrusage(resource.RUSAGE_THREAD)
        return int(os.pread(self._file, 80, 0).split()[1]), usage.ru_minflt + usage.ru_majflt


class Ticked(NullSink):
    """Keeps of each tick its number, how late it was (us), when that was over, and the evidence until then."""

    def __init__(self, evidence: Evidence) -> None:
        self.ticks: list[tuple[int, float, int, tuple[int, int]]] = []
        self._evidence = evidence

    def sample(self, *row: object) -> None:
        """Keep that."""
        tick, late_us = row[0], row[6]
        assert isinstance(tick, int) and isinstance(late_us, float)
        self.ticks.append((tick, late_us, time.monotonic_ns(), self._evidence.until_now()))


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
        evidence = Evidence()
        for line in sys.stdin:
            ticks, period_us = map(int, line.split())
            record, guard, clock = Ticked(evidence), Guard(GUARD), MonotonicClock(1e-6 * spin_us)
            while not 480_000 < time.monotonic_ns() % 1_000_000 < 495_000:  # it takes a few us to t0
                pass
            loop = Loop(StillBench(), clock, guard, record, 1e-6 * period_us, StopRequest(StopFlag.unseen()))
            t0_ns = time.monotonic_ns() - round(1e9 * loop.now_s)
            with loop.armed(LIMITS):
                before = evidence.until_now()
                loop.run(Ticks(ticks), "still")
            numbers = [loop.statistics.skipped, 5]
            for tick, late_us, over_ns, (queued_ns, faults) in record.ticks:
                due_ns = t0_ns + 1000 * period_us * tick
                numbers += [round(1e3 * late_us), due_ns, over_ns - due_ns, queued_ns - before[0], faults - before[1]]
                before = (queued_ns, faults)
            print(*numbers, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
