"""A device that latches no e-stop by itself is read throughout each pause: one opened and closed must not be missed."""

from __future__ import annotations

import math
import threading

from rig.backends.clock import MonotonicClock
from rig.backends.driver import Clock, Driver
from rig.faults import Fault

VIRTUAL_PAUSE_S = 1.0  # how long a pause lasts in virtual time, which stands still while anything is computed


class PauseWatch:
    """Reads ``driver`` each ``period_s`` from ``begin`` to ``end``, in a thread of its own; nothing else uses it then.

    A driver whose device latches (``latches_stops``) is left alone: arming tells what has happened. In virtual time the
    pause comes at its end, and takes VIRTUAL_PAUSE_S.

    A reading at or beyond ``rail_counts`` is the fault SENSOR_RAIL: the guard, which says so otherwise, rests as well.

    longest_gap_s  the longest time between two readings so far, s: a contact that opens for less may be missed
    """

    def __init__(
        self,
        driver: Driver,
        clock: Clock,
        period_s: float,
        rail_counts: tuple[float, float] = (-math.inf, math.inf),
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
        """The pause is over, and the driver free. Raises the fault that was seen in it."""
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
            except Exception as error:  # noqa: BLE001 - whatever it is belongs to the run, which is another thread's
                self._seen = error if isinstance(error, Fault) else Fault("INTERNAL", f"in a pause: {error!r}")
                return
            now_s = self._clock.now_s()
            self.longest_gap_s = max(self.longest_gap_s, now_s - before_s)
            before_s = now_s
