"""The breakaway check: a slow ramp each way, in short strokes, proves sensor, drive and sign before any relay runs."""

from __future__ import annotations

import math
from statistics import fmean

from rig.faults import Fault
from rig.signals import Sample


class BreakawayCheck:
    """Ramp up until the shaft moves, rest, ramp down until it moves, rest (architecture: Safety).

    The ramp goes out in strokes of ``STROKE_S``, with as long a pause at 0 V: if the sensor is stuck or not coupled
    the shaft turns unseen, and a continuous ramp would have it at full speed, and at its stop, before the ramp's end.

    ramp_V_s    slope of the ramp
    max_V       largest drive tried; Fault NO_MOTION where it does not move the shaft
    motion_rad  displacement that counts as motion
    rest_s      rest before, between and after; the first one measures the sensor's noise

    Results, once finished: ``plus_V`` and ``minus_V`` (> 0), the last drive each way at which no motion was to be seen,
    and ``noise_rad``, the sensor's standard deviation at rest. Both levels may lie above static friction by what the
    ramp gains until the motion leaves the noise; identification corrects that.

    Raises Fault: DRIVE_STUCK_ON (moves at 0 V), SENSOR_NOISY, NO_MOTION, POLARITY (moves against the drive).
    """

    STROKE_S = 0.04

    z_rad_s = math.nan
    yd_rad = math.nan

    def __init__(self, ramp_V_s: float, max_V: float, motion_rad: float, rest_s: float) -> None:
        self.ramp_V_s = ramp_V_s
        self.max_V = max_V
        self.motion_rad = motion_rad
        self.rest_s = rest_s
        self.finished = False
        self.plus_V = math.nan
        self.minus_V = math.nan
        self.noise_rad = math.nan
        self._phase_start_s = math.nan
        self._rest_y: list[float] = []
        self._ramp_from_rad = 0.0
        self._direction = 0  # 0: at rest; +1, -1: ramping
        self._seen = 0
        self._still_V = 0.0  # last level of the ramp at which the shaft had not moved beyond the noise

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
        self._rest_y.append(sample.y_rad)
        if elapsed_s < self.rest_s:
            return
        # the second half: the shaft has coasted to a stop by then
        still = self._rest_y[len(self._rest_y) // 2 :]
        # from second differences: a shaft that still turns steadily does not count as noise
        rest = self._rest_y
        bends = [a - 2.0 * b + c for a, b, c in zip(rest, rest[1:], rest[2:], strict=False)]
        self.noise_rad = math.sqrt(fmean(bend * bend for bend in bends) / 6.0)
        first = math.isnan(self.plus_V)
        if first and self.noise_rad > 0.33 * self.motion_rad:
            raise Fault(
                "SENSOR_NOISY",
                f"standard deviation {self.noise_rad * 1e3:.1f} mrad at rest; "
                f"breakaway.motion_rad is {self.motion_rad * 1e3:.0f} mrad",
            )
        if self._turns(still):
            if elapsed_s > 10.0 * self.rest_s:
                raise Fault("DRIVE_STUCK_ON", f"it still turns {elapsed_s:.1f} s after the drive was set to 0 V")
            self._rest_y = self._rest_y[-2 * len(still) :]
            return
        if not first and not math.isnan(self.minus_V):
            self.finished = True
            return
        self._ramp_from_rad = fmean(still)
        self._direction = 1 if first else -1
        self._still_V = 0.0
        self._phase_start_s = sample.t_s
        self._seen = 0

    def _turns(self, y_rad: list[float]) -> bool:
        half = len(y_rad) // 2
        drift = abs(fmean(y_rad[half:]) - fmean(y_rad[:half]))
        return drift > max(0.25 * self.motion_rad, 4.0 * self.noise_rad * math.sqrt(2.0 / half))

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
                    f"{self._direction * level:+.2f} V moved it by {moved * 1e3:+.0f} mrad",
                )
            if self._direction > 0:
                self.plus_V = self._still_V
            else:
                self.minus_V = self._still_V
            self._direction = 0
            self._phase_start_s = sample.t_s
            self._rest_y = []
            return 0.0
        if level > self.max_V:
            way = "rising" if self._direction > 0 else "falling"
            raise Fault("NO_MOTION", f"up to {self.max_V:.2f} V towards {way} positions")
        in_stroke = elapsed_s % (2.0 * self.STROKE_S) < self.STROKE_S
        return self._direction * level if in_stroke else 0.0
