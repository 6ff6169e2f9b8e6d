"""Timing of the loop: how late ticks began, how long their parts took, skipped ticks."""

from __future__ import annotations

import math
from array import array

import numpy as np

from rig.run_folder.results import DeviceLoop, LoopResult, Quantiles

QUANTILES = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}
KEPT = 1_000_000  # ticks; at 100 Hz nearly three hours


class Times:
    """The times, us, that one part of a tick took: the last ``kept`` of them, and the largest of all.

    So even an endless run needs no more memory.
    """

    def __init__(self, kept: int = KEPT) -> None:
        self._kept = kept
        self._last = array("f")
        self._largest_us = -math.inf
        self.count = 0

    def add(self, time_us: float) -> None:
        """Add one time."""
        if self.count < self._kept:
            self._last.append(time_us)
        else:
            self._last[self.count % self._kept] = time_us
        self.count += 1
        if time_us > self._largest_us:
            self._largest_us = time_us

    def quantiles(self) -> Quantiles:
        """p50, p99 and p99.9 of the kept times, and the largest of all; None without any."""
        found = quantiles(self._last)
        return Quantiles(**(found | {"max": round(self._largest_us, 3)} if self.count else found))


class LoopStatistics:
    """Collects the times of every tick, us, and counts the skipped ticks."""

    def __init__(self) -> None:
        self.skipped = 0
        self.device_ticks = 0  # ticks of a relay in the device that were recorded
        self.device_missed = 0  # ticks that it missed
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
        """Count a tick that began ``late_us`` late and took ``io_us`` to read the device."""
        self._late.add(late_us)
        self._io.add(io_us)

    def drive(self, compute_us: float, write_us: float, record_us: float) -> None:
        """Add the times of the rest of a tick: law and guard, writing the drive, recording the row."""
        self._compute.add(compute_us)
        self._write.add(write_us)
        self._record.add(record_us)

    def device_tick(self, tick_s: float, missed: int) -> None:
        """Count a tick of a relay in the device, of length ``tick_s``, and the ticks missed before it."""
        self.device_ticks += 1
        self.device_missed += missed
        self.device_tick_s = tick_s

    def summary(self, period_s: float) -> LoopResult:
        """The loop of this period for result.json; with ``device`` if a relay in the device has run."""
        device = DeviceLoop(period_s=self.device_tick_s, ticks=self.device_ticks, missed=self.device_missed)
        return LoopResult.of(
            self,
            period_s=period_s,
            late_us=self._late.quantiles(),
            io_us=self._io.quantiles(),
            compute_us=self._compute.quantiles(),
            write_us=self._write.quantiles(),
            record_us=self._record.quantiles(),
            device=device if self.device_ticks else None,
        )


def quantiles(values: array[float]) -> dict[str, float | None]:
    """p50, p99, p99.9 and the largest of ``values``, without interpolation; None for each if there are none."""
    if not values:
        return dict.fromkeys(QUANTILES)
    data = np.frombuffer(values, dtype=values.typecode).astype(float)
    picked = np.quantile(data, list(QUANTILES.values()), method="inverted_cdf")
    return {name: round(float(value), 3) for name, value in zip(QUANTILES, picked, strict=True)}
