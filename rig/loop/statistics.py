"""What the loop achieved: late wake-ups, exchange times, skipped ticks."""

from __future__ import annotations

from array import array

import numpy as np

QUANTILES = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}


class LoopStatistics:
    """Collects lateness and exchange time of every tick, us, and the ticks that were skipped."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.skipped = 0
        self._late_us = array("d")
        self._io_us = array("d")

    @property
    def ticks(self) -> int:
        """Ticks that ran."""
        return len(self._late_us)

    def tick(self, late_us: float, io_us: float) -> None:
        """Count one tick."""
        self._late_us.append(late_us)
        self._io_us.append(io_us)

    def summary(self) -> dict[str, object]:
        """The ``loop`` object of result.json; quantiles are null where no tick ran."""
        return {
            "period_s": self.period_s,
            "ticks": self.ticks,
            "skipped": self.skipped,
            "late_us": quantiles(self._late_us),
            "io_us": quantiles(self._io_us),
        }


def quantiles(values: array[float]) -> dict[str, float | None]:
    """p50, p99, p99.9 and the largest of some values, each one of the values; None for each if there are none."""
    if not values:
        return dict.fromkeys(QUANTILES)
    data = np.frombuffer(values, dtype=float)
    picked = np.quantile(data, list(QUANTILES.values()), method="inverted_cdf")
    return {name: round(float(value), 3) for name, value in zip(QUANTILES, picked, strict=True)}
