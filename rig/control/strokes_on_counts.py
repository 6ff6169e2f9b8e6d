"""The stroke test as a device runs it, in whole counts and ticks (firmware/core/strokes.h)."""

from __future__ import annotations

import math

from rig.backends.driver import StrokesCommand
from rig.control.law import BareLaw
from rig.control.strokes import Stroke, StrokeTest, StrokeTiming
from rig.core.faults import Fault
from rig.core.signals import Sample


class StrokesOnCounts(BareLaw):
    """``StrokeTest`` with counts instead of rad and ticks instead of s: whole numbers, so rounding affects no decision.

    It goes on until somebody ends it. As the device, it drives nothing any more once two strokes in a row have failed:
    ``step`` raises Fault SENSOR_STUCK or NO_CYCLE then, as ``StrokeTest``, and again at each later step.
    """

    def __init__(self, command: StrokesCommand) -> None:
        self._command = command
        way, centre = command.direction, command.centre_counts
        in_position = [Stroke(u_V, float(way * (turn - centre))) for u_V, turn in command.strokes]
        timing = StrokeTiming(math.inf, float(command.stroke_ticks), float(command.still_ticks))
        self._law = StrokeTest(in_position, timing, float(command.still_counts))
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
        y_counts = self._command.direction * (sample.y_counts - self._command.centre_counts)
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
