"""What the loop achieved: late wake-ups, how long the parts of a tick took, skipped ticks."""

from __future__ import annotations

from array import array

import numpy as np

QUANTILES = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}


class LoopStatistics:
    """Collects the times of every tick, us, and the ticks that were skipped."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.skipped = 0
        self.device_ticks = 0  # of a relay in the device, as far as they were recorded
        self.device_missed = 0  # that it did not run
        self.device_tick_s = 0.0
        self._late_us = array("d")
        self._io_us = array("d")
        self._compute_us = array("d")
        self._write_us = array("d")
        self._record_us = array("d")

    @property
    def ticks(self) -> int:
        """Ticks that ran."""
        return len(self._late_us)

    def tick(self, late_us: float, io_us: float) -> None:
        """Count one tick that woke ``late_us`` late and read the device for ``io_us``."""
        self._late_us.append(late_us)
        self._io_us.append(io_us)

    def drive(self, compute_us: float, write_us: float, record_us: float) -> None:
        """The rest of a tick that drives: law and guard, writing the drive, recording the row."""
        self._compute_us.append(compute_us)
        self._write_us.append(write_us)
        self._record_us.append(record_us)

    def device_tick(self, tick_s: float, missed: int) -> None:
        """Count one tick of a relay in the device, every ``tick_s``, and those missed before it."""
        self.device_ticks += 1
        self.device_missed += missed
        self.device_tick_s = tick_s

    def summary(self) -> dict[str, object]:
        """The ``loop`` object of result.json; quantiles are null where no tick ran.

        ``device`` is there where a relay in the device has run.
        """
        device = {"period_s": self.device_tick_s, "ticks": self.device_ticks, "missed": self.device_missed}
        return {
            "period_s": self.period_s,
            "ticks": self.ticks,
            "skipped": self.skipped,
            "late_us": quantiles(self._late_us),
            "io_us": quantiles(self._io_us),
            "compute_us": quantiles(self._compute_us),
            "write_us": quantiles(self._write_us),
            "record_us": quantiles(self._record_us),
            **({"device": device} if self.device_ticks else {}),
        }


def quantiles(values: array[float]) -> dict[str, float | None]:
    """p50, p99, p99.9 and the largest of some values, each one of the values; None for each if there are none."""
    if not values:
        return dict.fromkeys(QUANTILES)
    data = np.frombuffer(values, dtype=float)
    picked = np.quantile(data, list(QUANTILES.values()), method="inverted_cdf")
    return {name: round(float(value), 3) for name, value in zip(QUANTILES, picked, strict=True)}
