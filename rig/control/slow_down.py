"""A rest that begins in full motion: the shaft is slowed down until it may coast (docs/until.md)."""

from __future__ import annotations

import math

from rig.control.guard import WINDOW_S, Guard, velocity_noise_rad_s
from rig.control.law import BareLaw
from rig.core.signals import Sample

LATEST_PERIODS = 2.0  # of the guard's delay
CLEAR = 2.5  # standard deviations of the guard's velocity: slower than that the shaft does not coast far


class SlowDown(BareLaw):
    """0 V for a while; before that, once, a drive against the motion if the shaft would coast beyond a soft limit.

    The drive is what friction takes, and what the motor itself needs for its speed. So it falls with the speed, and a
    reading that lags a little does no more than turn the shaft back. It ends one window of the guard's velocity after
    the reading last went farther out: a velocity alone may be an old one. Where drives act more than ``LATEST_PERIODS``
    late there is none: the shaft would have turned back before rig saw it.

    guard          of the loop: it knows the velocity, and where the shaft would stop
    rest_s         how long all of it takes, s, > 0
    moves_V        level that moves the shaft, V, > 0
    slope_V_s_rad  drive per speed, V s/rad, > 0: by the motor's data sheet
    max_V          largest drive, V, > 0
    period_s       of the loop, s

    braked_ticks   ticks in which it drove
    """

    def __init__(
        self, guard: Guard, rest_s: float, moves_V: float, slope_V_s_rad: float, max_V: float, period_s: float
    ) -> None:
        self._guard = guard
        self._rest_s = rest_s
        self._moves_V = moves_V
        self._slope_V_s_rad = slope_V_s_rad
        self._max_V = max_V
        self._period_s = period_s
        late = guard.settings.delay_s > LATEST_PERIODS * period_s
        self._way = (
            0 if late else self._way_out()
        )  # direction of the motion that goes too far, +1 or -1; 0: none, or no longer
        self._furthest_rad = -math.inf  # reading along that way
        self._seen_s = math.nan  # when it last went on
        self.braked_ticks = 0

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V."""
        self.finished = self._elapsed_s(sample) >= self._rest_s
        if sample.y_rad * self._way > self._furthest_rad + self._guard.settings.noise_rad:
            self._furthest_rad, self._seen_s = sample.y_rad * self._way, sample.t_s
        unseen_s = sample.t_s - self._seen_s + self._period_s  # once this drive has acted for its period
        if self._way == 0 or unseen_s > WINDOW_S + 0.5 * self._period_s or self._way_out() != self._way:
            self._way = 0  # never again: near a standstill the velocity is noise
            return 0.0
        self.braked_ticks += 1
        v_rad_s = self._guard.velocity_rad_s
        return -self._way * min(self._moves_V + abs(v_rad_s) * self._slope_V_s_rad, self._max_V)

    def _way_out(self) -> int:
        """The direction in which the shaft, at 0 V, would leave the soft limits, as the guard predicts it; else 0."""
        guard = self._guard
        low_rad, high_rad = guard.settings.limits.soft_rad
        v_rad_s, noise_rad_s = guard.velocity_rad_s, velocity_noise_rad_s(guard.settings.noise_rad, self._period_s)
        if low_rad <= guard.predicted_stop_rad <= high_rad or abs(v_rad_s) < CLEAR * noise_rad_s:
            return 0
        return 1 if v_rad_s > 0.0 else -1
