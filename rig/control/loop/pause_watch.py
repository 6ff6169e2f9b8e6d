"""Reads a device that latches no e-stop throughout each pause: else an e-stop that opens and closes would be missed."""

from __future__ import annotations

import math
import threading

from rig.backends.clock import MonotonicClock
from rig.backends.driver import Clock, Driver
from rig.core.faults import Fault

VIRTUAL_PAUSE_S = 1.0  # length of a pause in virtual time, in which computing takes no time


class PauseWatch:
    """Reads ``driver`` every ``period_s`` from ``begin`` to ``end``, in its own thread; nothing else uses it meanwhile.

    It does not read a device that latches (``latches_stops``): arming tells what happened in the pause. In virtual time
    all readings come at the end of the pause, and take VIRTUAL_PAUSE_S.

    rail_counts    a reading at or beyond these raises Fault SENSOR_RAIL, as the guard does outside a pause
    longest_gap_s  longest time between two readings so far, s: a contact that opens for less may be missed
    """

    def __init__(
        self, driver: Driver, clock: Clock, period_s: float, rail_counts: tuple[float, float] = (-math.inf, math.inf)
    ) -> None:
        self.longest_gap_s = 0.0
        self._driver = driver
        self._clock = clock
        self._period_s = period_s
        self._rail_counts = rail_counts
        self._needed = not getattr(driver, "latches_stops", False)
        self._in_real_time = isinstance(clock, MonotonicClock)
        self._thread: threading.Thread | None = None
        self._over = threading.Event()
        self._seen: Exception | None = None
        self._is_pause = False

    def begin(self) -> None:
        """A pause begins: the device has been disarmed."""
        if not self._needed or self._is_pause:
            return
        self._is_pause = True
        if self._in_real_time:
            self._over.clear()
            self._thread = threading.Thread(target=self._watch, name="pause watch", daemon=True)
            self._thread.start()

    def end(self) -> None:
        """The pause is over: let go of the driver. Raises the fault that was seen in the pause."""
        self.give_up()
        if self._is_pause and not self._in_real_time:
            start_s = self._clock.now_s()
            for tick in range(1, round(VIRTUAL_PAUSE_S / self._period_s) + 1):
                self._clock.sleep_until(start_s + tick * self._period_s)
                self._look()
        self._is_pause = False
        self.check()

    def check(self) -> None:
        """Raise the fault that was seen so far."""
        if self._seen is not None:
            raise self._seen

    def give_up(self) -> None:
        """Let go of the driver, whatever was seen. May be called twice."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _look(self) -> None:
        counts, (low, high) = self._driver.read().y_counts, self._rail_counts
        if not low < counts < high:
            raise Fault("SENSOR_RAIL", f"in a pause: reading {counts} counts; the rails are {low:g} and {high:g}")

    def _watch(self) -> None:
        before_s = self._clock.now_s()
        while not self._over.wait(self._period_s):
            try:
                self._look()
            except Exception as error:  # noqa: BLE001 - whatever it is, the thread of the run must raise it
                self._seen = error if isinstance(error, Fault) else Fault("INTERNAL", f"in a pause: {error!r}")
                return
            now_s = self._clock.now_s()
            self.longest_gap_s = max(self.longest_gap_s, now_s - before_s)
            before_s = now_s
