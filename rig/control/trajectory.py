"""Smooth reference trajectories: a sum of sines, faded in from the shaft's position."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple


class Reference(NamedTuple):
    """Reference position rad, velocity rad/s and acceleration rad/s^2."""

    y_rad: float
    v_rad_s: float
    a_rad_s2: float


class SumOfSines:
    """yd(t) = sum A_i sin(w_i t), reached from ``start_rad`` over ``fade_s`` with two continuous derivatives.

    components  pairs (amplitude rad, angular frequency rad/s)
    turn_rad_s  the shaft turns on at this speed, with the sines on top, from ``start_rad`` on; 0: it swings about 0 rad
    """

    def __init__(
        self,
        components: Sequence[tuple[float, float]],
        start_rad: float = 0.0,
        fade_s: float = 1.5,
        turn_rad_s: float = 0.0,
    ) -> None:
        self.components = tuple(components)
        self.turn_rad_s = turn_rad_s
        self.start_rad = start_rad
        self.fade_s = fade_s

    def at(self, t_s: float) -> Reference:
        """Reference at ``t_s`` >= 0 seconds after the start."""
        v, a = self.turn_rad_s, 0.0
        y = self.start_rad + v * t_s if v else 0.0
        for amplitude, omega in self.components:
            sine, cosine = math.sin(omega * t_s), math.cos(omega * t_s)
            y += amplitude * sine
            v += amplitude * omega * cosine
            a -= amplitude * omega * omega * sine
        if t_s >= self.fade_s:
            return Reference(y, v, a)
        w, dw, ddw = _smooth_step(t_s / self.fade_s)
        dw, ddw = dw / self.fade_s, ddw / self.fade_s**2
        gap = y - self.start_rad
        return Reference(self.start_rad + w * gap, w * v + dw * gap, w * a + 2.0 * dw * v + ddw * gap)


def _smooth_step(s: float) -> tuple[float, float, float]:
    """Quintic from 0 to 1 with zero first and second derivatives at both ends; value and derivatives at s."""
    s = max(0.0, s)
    return (
        s**3 * (10.0 - 15.0 * s + 6.0 * s * s),
        30.0 * s * s * (1.0 - s) ** 2,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )
