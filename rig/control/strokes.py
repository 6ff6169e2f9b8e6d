"""The stroke test: the shaft is driven to and fro, at levels and between turning points that vary (docs/design.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from rig.control.law import BareLaw
from rig.control.motion import Standstill
from rig.core.faults import Fault
from rig.core.signals import Sample


class Stroke(NamedTuple):
    """One stroke: drive ``u_V`` until the position has passed ``turn_rad`` in the drive's direction."""

    u_V: float
    turn_rad: float

    def is_over(self, y_rad: float) -> bool:
        """Whether the reading is at the turning point, or beyond it in the drive's direction."""
        return y_rad >= self.turn_rad if self.u_V > 0.0 else y_rad <= self.turn_rad


class StrokeTiming(NamedTuple):
    """How long a stroke test may take.

    longest_s    of the whole test, s: it ends at the first turn after that
    stroke_s     of one stroke, s: then the next one begins
    still_s      for which the reading may stand still under one drive, s: then the next stroke begins
    """

    longest_s: float
    stroke_s: float
    still_s: float = 0.3


class StrokeTest(BareLaw):
    """Drive a list of strokes again and again, each until its turning point.

    strokes     at least two; the drives change their sign from each to the next, and from the last to the first
    timing      how long it may take
    motion_rad  a reading within this span stands still, rad, > 0
    moves_V     level that is known to move the shaft, V, >= 0: where a weaker stroke fails the shaft may stick

    The first stroke is inward: of the first two, the one that drives towards 0 rad. At most one stroke ends at each
    sample. A stroke that does not come to its turning point in time ends all the same: the next one drives back, so a
    shaft whose reading does not show its motion comes back too. After a second one in a row the test raises Fault
    SENSOR_STUCK if the reading stood still in both, and both drives were known to move the shaft; else NO_CYCLE.
    Raises ValueError for other strokes and times.

    ended          strokes that came to their turning point
    settled_start_s, settled_end_s   begin of the second stroke and end of the last, s
    """

    def __init__(
        self, strokes: Sequence[Stroke], timing: StrokeTiming, motion_rad: float, moves_V: float = 0.0
    ) -> None:
        drives = [stroke.u_V for stroke in strokes]
        if len(drives) < 2 or any(a * b >= 0.0 for a, b in zip(drives, drives[1:] + drives[:1], strict=True)):
            raise ValueError("a stroke test needs two strokes or more whose drives change their sign each time")
        if not (math.isfinite(sum(map(sum, strokes))) and min(timing) > 0.0 and motion_rad > 0.0):
            raise ValueError("a stroke test needs finite drives and turning points, and times and motion_rad > 0")
        self.strokes = tuple(strokes)
        self.timing = timing
        self.motion_rad = motion_rad
        self.moves_V = moves_V
        self.ended = 0
        self.settled_start_s = math.nan
        self.settled_end_s = math.nan
        self._index = 0
        self._start_s = math.nan
        self._stroke_s = math.nan  # begin of this stroke
        self._failed: list[str] = []  # how the last strokes in a row failed
        self._standstill = Standstill()

    @property
    def stroke(self) -> Stroke:
        """The stroke that is driven."""
        return self.strokes[self._index]

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V. Raises Fault SENSOR_STUCK or NO_CYCLE."""
        t_s, y_rad = sample.t_s, sample.y_rad
        if math.isnan(self._start_s):
            self._start_s = self._stroke_s = t_s
            self._index = int(y_rad * self.strokes[0].u_V > 0.0)
        still_s = self._standstill.step(t_s, y_rad, self.motion_rad)
        if self.stroke.is_over(y_rad):
            self.ended += 1
            self._failed.clear()
            if math.isnan(self.settled_start_s):
                self.settled_start_s = t_s
            self.settled_end_s = t_s
            self._turn(t_s)
        elif still_s > self.timing.still_s:
            code = "SENSOR_STUCK" if abs(self.stroke.u_V) >= self.moves_V else "NO_CYCLE"
            self._fail(t_s, code, f"the reading stood still for {still_s:.2f} s; {self._standstill.words()}")
        elif t_s - self._stroke_s > self.timing.stroke_s:
            self._fail(t_s, "NO_CYCLE", f"it was at {y_rad:.3f} rad after {t_s - self._stroke_s:.2f} s")
        return self.stroke.u_V

    def _turn(self, t_s: float) -> None:
        self.finished = t_s - self._start_s >= self.timing.longest_s
        self._index = (self._index + 1) % len(self.strokes)
        self._stroke_s = t_s
        self._standstill.restart()

    def _fail(self, t_s: float, code: str, what: str) -> None:
        """Go on with the next stroke: the present one did not come to its turning point. End the test after two."""
        u_V, turn_rad = self.stroke
        self._failed.append(code)
        if len(self._failed) >= 2:
            raise Fault(
                "SENSOR_STUCK" if set(self._failed) == {"SENSOR_STUCK"} else "NO_CYCLE",
                f"two strokes in a row did not come to their turning points; the last one, {u_V:+.2f} V to "
                f"{turn_rad:+.3f} rad: {what}",
            )
        self._turn(t_s)
