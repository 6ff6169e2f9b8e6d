"""Cycle detection while a test runs: which periods are limit cycles of the relay, and when they have settled."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

GAP_PERIODS = 2.5  # of the sampling: a longer step between two samples is a gap, unless it is short beside a cycle
GAP_SHARE = 0.02
SPREAD = 0.05  # how far settled periods in a row may differ, as a share of a period
_LEAST_SAMPLES = 30  # of the shortest period


class DetectedCycle(NamedTuple):
    """One period, from one upward crossing of the integral to the next.

    start_s, period_s     time of its start and its length, s
    amplitude_rad         half of the peak-to-peak position
    accepted              true for a limit cycle (docs/theory.md 3.1), false for delay hunting
    reason                why it is not accepted; empty if it is
    """

    start_s: float
    period_s: float
    amplitude_rad: float
    accepted: bool
    reason: str


class CycleDetector:
    """Finds periods from samples of position and its integral, and applies the acceptance rule (docs/theory.md 4.3).

    min_period_s        30 sampling periods, s
    min_amplitude_rad   20 LSB

    ``settled`` becomes true after three accepted periods in a row that differ by at most ``SPREAD``, and whose
    amplitudes differ by at most twice that share. It becomes false at a period that is not accepted, or whose length or
    amplitude differs from the one before by more than six times ``SPREAD``.

    A period with a gap between two samples is left out: the relay switched late in it, and its turning points may not
    have been seen. It neither counts nor unsettles the others.

    A period starts where z crosses zero upwards. There y is large, so noise on y cannot make z chatter.
    Three events must follow in this order: RA (largest y), RB (y falls through zero), RC (z falls through zero).
    Then the same three follow with the opposite sign.
    """

    def __init__(self, min_period_s: float, min_amplitude_rad: float) -> None:
        self.min_period_s = min_period_s
        self.min_amplitude_rad = min_amplitude_rad
        self.cycles: list[DetectedCycle] = []
        self.settled = False
        self.left_out = 0  # periods with a gap
        self._last: tuple[float, float, float] | None = None
        self._start_s = math.nan
        self._begin(0.0)

    def _begin(self, t_s: float) -> None:
        self._max = (-math.inf, t_s)
        self._min = (math.inf, t_s)
        self._y_down_s = math.nan
        self._y_up_s = math.nan
        self._z_down_s = math.nan
        self._longest_step_s = 0.0

    def forget(self) -> None:
        """Drop the cycles found so far. Call it when the gains change."""
        self.cycles.clear()
        self.left_out = 0
        self.settled = False
        self._start_s = math.nan

    def step(self, t_s: float, y_rad: float, z_rad_s: float) -> DetectedCycle | None:
        """Take one sample. Returns the period that this sample completes, or None."""
        last, self._last = self._last, (t_s, y_rad, z_rad_s)
        if last is None:
            return None
        t0, y0, z0 = last
        self._longest_step_s = max(self._longest_step_s, t_s - t0)
        if y_rad > self._max[0]:
            self._max = (y_rad, t_s)
        if y_rad < self._min[0]:
            self._min = (y_rad, t_s)
        # the last crossing downwards before RC, and the last upwards after it: chatter only shifts these
        if y0 > 0.0 >= y_rad and math.isnan(self._z_down_s):
            self._y_down_s = t_s
        if y0 < 0.0 <= y_rad and not math.isnan(self._z_down_s):
            self._y_up_s = t_s
        if z0 > 0.0 >= z_rad_s and math.isnan(self._z_down_s):
            self._z_down_s = t_s
        if not z0 < 0.0 <= z_rad_s:
            return None
        crossing_s = t0 + (t_s - t0) * z0 / (z0 - z_rad_s)
        cycle = None if math.isnan(self._start_s) else self._judge(crossing_s)
        self._start_s = crossing_s
        has_gap = cycle is not None and self._longest_step_s > max(
            GAP_PERIODS * self.min_period_s / _LEAST_SAMPLES, GAP_SHARE * cycle.period_s
        )
        self._begin(t_s)
        self._longest_step_s = t_s - t0  # a gap about the crossing is in both periods
        self.left_out += has_gap
        if cycle is None or has_gap:
            return None
        self.cycles.append(cycle)
        self._update_settled()
        return cycle

    def _judge(self, end_s: float) -> DetectedCycle:
        period = end_s - self._start_s
        amplitude = 0.5 * (self._max[0] - self._min[0])
        # RA follows RC by t1. That can be shorter than a sampling period, so noise can show RA a few samples early
        early_s = 0.1 * self.min_period_s
        top_s = self._max[1] if self._max[1] < end_s - early_s else self._start_s
        bottom_s = max(self._min[1], self._z_down_s) if self._min[1] > self._z_down_s - early_s else self._min[1]
        order = (self._start_s, top_s, self._y_down_s, self._z_down_s, bottom_s, self._y_up_s, end_s)
        reason = ""
        if period < self.min_period_s:
            reason = f"period {period:.3f} s is below {self.min_period_s:.3f} s: delay hunting"
        elif amplitude < self.min_amplitude_rad:
            reason = f"amplitude {amplitude:.4f} rad is below {self.min_amplitude_rad:.4f} rad: delay hunting"
        elif not all(a <= b for a, b in itertools.pairwise(order)):
            reason = "the relays do not switch in the order velocity, position, integral"
        return DetectedCycle(self._start_s, period, amplitude, not reason, reason)

    def _update_settled(self) -> None:
        last = self.cycles[-3:]
        if not last[-1].accepted:
            self.settled = False
            return
        periods = [c.period_s for c in last]
        amplitudes = [c.amplitude_rad for c in last]
        if self.settled:
            # a relay that decides once a sampling period makes the cycle jitter; only a real change unsettles it
            period, amplitude = self.cycles[-2].period_s, self.cycles[-2].amplitude_rad
            self.settled = (
                abs(periods[-1] / period - 1.0) < 6.0 * SPREAD and abs(amplitudes[-1] / amplitude - 1.0) < 6.0 * SPREAD
            )
        elif len(last) == 3 and all(c.accepted for c in last):
            self.settled = max(periods) <= (1.0 + SPREAD) * min(periods) and max(amplitudes) <= (
                1.0 + 2.0 * SPREAD
            ) * min(amplitudes)

    def mean(self, last: int = 3) -> tuple[float, float]:
        """Mean (period s, amplitude rad) of the ``last`` periods. Raises ValueError before the first period."""
        cycles = self.cycles[-last:]
        if not cycles:
            raise ValueError("no period has been completed")
        n = len(cycles)
        return sum(c.period_s for c in cycles) / n, sum(c.amplitude_rad for c in cycles) / n
