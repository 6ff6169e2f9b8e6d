"""The breakaway check of older versions: replays of their runs need it; it drives no bench.

It ramped in one direction, then in the other. With a stuck sensor the shaft could turn by radians unseen.
"""

from __future__ import annotations

import math

from rig.control.breakaway import RestingCheck
from rig.faults import Fault
from rig.signals import Sample


class OneWayCheck(RestingCheck):
    """Ramp up in strokes until the shaft moves, rest, ramp down until it moves, rest; results as in ``BreakawayCheck``.

    ramp_V_s    slope of the ramp
    max_V       largest drive; Fault NO_MOTION if it does not move the shaft
    motion_rad  displacement that counts as motion
    rest_s      rest before, between and after
    """

    STROKE_S = 0.04  # and as long a pause

    def __init__(self, ramp_V_s: float, max_V: float, motion_rad: float, rest_s: float) -> None:
        super().__init__(motion_rad, rest_s)
        self.ramp_V_s = ramp_V_s
        self.max_V = max_V
        self._phase_start_s = math.nan
        self._ramp_from_rad = 0.0
        self._direction = 0  # 0: at rest; +1, -1: ramping
        self._seen = 0
        self._still_V = 0.0

    def step(self, sample: Sample) -> float:
        """Drive of the ramp at this sample, V; 0 V while resting."""
        if math.isnan(self._phase_start_s):
            self._phase_start_s = sample.t_s
        elapsed = sample.t_s - self._phase_start_s
        if self._direction == 0:
            self._rest(sample, elapsed)
            return 0.0
        return self._ramp(sample, elapsed)

    def _rest(self, sample: Sample, elapsed_s: float) -> None:
        first = math.isnan(self.plus_V)
        stood_rad = self._stands(sample, elapsed_s, first=first)
        if stood_rad is None:
            return
        if not first and not math.isnan(self.minus_V):
            self.finished = True
            return
        self._ramp_from_rad = stood_rad
        self._direction = 1 if first else -1
        self._still_V = 0.0
        self._phase_start_s = sample.t_s
        self._seen = 0

    def _ramp(self, sample: Sample, elapsed_s: float) -> float:
        moved = sample.y_rad - self._ramp_from_rad
        # two samples in a row: one noisy reading is not motion
        self._seen = self._seen + 1 if abs(moved) > self.motion_rad else 0
        level = self.ramp_V_s * elapsed_s
        if abs(moved) < max(2.5 * self.noise_rad, 0.15 * self.motion_rad):
            self._still_V = level
        if self._seen >= 2:
            if moved * self._direction < 0.0:
                raise Fault(
                    "POLARITY",
                    f"{self._direction * level:+.2f} V moved the shaft by {moved * 1e3:+.0f} mrad",
                )
            if self._direction > 0:
                self.plus_V = self._still_V
            else:
                self.minus_V = self._still_V
            self._direction = 0
            self._phase_start_s = sample.t_s
            return 0.0
        if level > self.max_V:
            way = "rising" if self._direction > 0 else "falling"
            raise Fault("NO_MOTION", f"up to {self.max_V:.2f} V towards {way} positions")
        in_stroke = elapsed_s % (2.0 * self.STROKE_S) < self.STROKE_S
        return self._direction * level if in_stroke else 0.0
