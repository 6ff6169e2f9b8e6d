"""What the loop achieved: late wake-ups, how long the parts of a tick took, skipped ticks."""

from __future__ import annotations

import math
from array import array

import numpy as np

from rig.results import DeviceLoop, LoopResult, Quantiles

QUANTILES = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}
KEPT = 1_000_000  # ticks; at 100 Hz nearly three hours


class Times:
    """The times, us, that one part of a tick took: the last ``kept`` of them, and the largest of all.

    Of an endless run memory holds no more than that.
    """

    def __init__(self, kept: int = KEPT) -> None:
        self._kept = kept
        self._last = array("f")
        self._largest_us = -math.inf
        self.count = 0

    def add(self, time_us: float) -> None:
        """One more."""
        if self.count < self._kept:
            self._last.append(time_us)
        else:
            self._last[self.count % self._kept] = time_us
        self.count += 1
        if time_us > self._largest_us:
            self._largest_us = time_us

    def quantiles(self) -> Quantiles:
        """p50, p99 and p99.9 of those that are kept, and the largest of all; None for each where there are none."""
        found = quantiles(self._last)
        return Quantiles(**(found | {"max": round(self._largest_us, 3)} if self.count else found))


class LoopStatistics:
    """Collects the times of every tick, us, and the ticks that were skipped."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.skipped = 0
        self.device_ticks = 0  # of a relay in the device, as far as they were recorded
        self.device_missed = 0  # that it did not run
        self.device_tick_s = 0.0
        self._late = Times()
        self._io = Times()
        self._compute = Times()
        self._write = Times()
        self._record = Times()

    @property
    def ticks(self) -> int:
        """Ticks that ran."""
        return self._late.count

    def tick(self, late_us: float, io_us: float) -> None:
        """Count one tick that woke ``late_us`` late and read the device for ``io_us``."""
        self._late.add(late_us)
        self._io.add(io_us)

    def drive(self, compute_us: float, write_us: float, record_us: float) -> None:
        """The rest of a tick that drives: law and guard, writing the drive, recording the row."""
        self._compute.add(compute_us)
        self._write.add(write_us)
        self._record.add(record_us)

    def device_tick(self, tick_s: float, missed: int) -> None:
        """Count one tick of a relay in the device, every ``tick_s``, and those missed before it."""
        self.device_ticks += 1
        self.device_missed += missed
        self.device_tick_s = tick_s

    def summary(self) -> LoopResult:
        """What result.json says of the loop; ``device`` is there where a relay in the device has run."""
        device = DeviceLoop(period_s=self.device_tick_s, ticks=self.device_ticks, missed=self.device_missed)
        return LoopResult(
            period_s=self.period_s,
            ticks=self.ticks,
            skipped=self.skipped,
            late_us=self._late.quantiles(),
            io_us=self._io.quantiles(),
            compute_us=self._compute.quantiles(),
            write_us=self._write.quantiles(),
            record_us=self._record.quantiles(),
            device=device if self.device_ticks else None,
        )


def quantiles(values: array[float]) -> dict[str, float | None]:
    """p50, p99, p99.9 and the largest of some values, each one of the values; None for each if there are none."""
    if not values:
        return dict.fromkeys(QUANTILES)
    data = np.frombuffer(values, dtype=values.typecode).astype(float)
    picked = np.quantile(data, list(QUANTILES.values()), method="inverted_cdf")
    return {name: round(float(value), 3) for name, value in zip(QUANTILES, picked, strict=True)}
