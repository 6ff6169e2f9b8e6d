"""The stroke test as a device runs it, in whole counts and ticks (firmware/core/strokes.h)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from rig.control.law import BareLaw
from rig.control.strokes import Stroke, StrokeTest, StrokeTiming
from rig.core.faults import Fault
from rig.core.signals import Sample


class CountedTimes(NamedTuple):
    """Longest times of one stroke, ticks of the device: until its turning point, and with a reading that is still."""

    stroke_ticks: int
    still_ticks: int


class StrokesOnCounts(BareLaw):
    """``StrokeTest`` with counts instead of rad and ticks instead of s: whole numbers, so rounding affects no decision.

    strokes        (drive, V; turning point, counts) of each, as the device has them
    centre_counts  reading at y = 0, as the device has it
    direction      +1 if positions rise with the counts, else -1
    times          as the device has them
    still_counts   readings less than this apart are one position

    It goes on until somebody ends it. As the device, it drives nothing any more once two strokes in a row have failed:
    ``step`` raises Fault SENSOR_STUCK or NO_CYCLE then, as ``StrokeTest``, and again at each later step.
    """

    def __init__(
        self,
        strokes: Sequence[tuple[float, int]],
        centre_counts: int,
        direction: int,
        times: CountedTimes,
        still_counts: int,
    ) -> None:
        in_position = [Stroke(u_V, float(direction * (turn - centre_counts))) for u_V, turn in strokes]
        timing = StrokeTiming(math.inf, float(times.stroke_ticks), float(times.still_ticks))
        self._law = StrokeTest(in_position, timing, float(still_counts))
        self._centre_counts = centre_counts
        self._direction = direction
        self._ticks = 0
        self._failed: Fault | None = None

    @property
    def ended(self) -> int:
        """Strokes that came to their turning point."""
        return self._law.ended

    def step(self, sample: Sample) -> float:
        """Drive for this tick's sample, V. Raises Fault SENSOR_STUCK or NO_CYCLE."""
        if self._failed is not None:
            raise self._failed
        y_counts = self._direction * (sample.y_counts - self._centre_counts)
        driven = self._law.stroke
        try:
            u_V = self._law.step(Sample(float(self._ticks), float(y_counts), sample.y_counts))
        except Fault as fault:
            self._failed = Fault(
                fault.code,
                f"two strokes in a row did not come to their turning points; the last one, {driven.u_V:+.2f} V, was at "
                f"{sample.y_rad:.3f} rad when it was given up",
            )
            raise self._failed from fault
        self._ticks += 1
        return u_V
