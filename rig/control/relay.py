"""Relays: the dual-channel relay of the experiment, and the sign rule that all of them share."""

from __future__ import annotations

import math

from rig.signals import Sample


def keep_sign(value: float, previous: int) -> int:
    """Sign of ``value``; at exactly zero the previous state stays (theory section 5)."""
    if value > 0.0:
        return 1
    if value < 0.0:
        return -1
    return previous


class DualChannelRelay:
    """u = -h1 sgn(y) - h2 sgn(z), one relay on position and one on its integral (6)-(10).

    z is the trapezoidal integral of y over the samples' true times, zero at the first sample, and held
    within +-z_bound_rad_s so that a start far from centre does not wind it up. The bound must exceed three
    times the cycle's largest |z|, else it shortens the period (theory section 5).
    """

    yd_rad = math.nan

    def __init__(self, h1_V: float, h2_V: float, z_bound_rad_s: float) -> None:
        if not (h1_V >= 0.0 and h2_V >= 0.0 and z_bound_rad_s > 0.0):
            raise ValueError("relay gains must be >= 0 V and the bound on the integral > 0 rad s")
        self.h1_V = h1_V
        self.h2_V = h2_V
        self.z_bound_rad_s = z_bound_rad_s
        self.z_rad_s = 0.0
        self.bound_reached = False
        self.finished = False
        self._sign_y = 0
        self._sign_z = 0
        self._last: tuple[float, float] | None = None

    def restart(self) -> None:
        """Begin anew at the next sample: integral zero, both relays inward."""
        self.z_rad_s = 0.0
        self._last = None

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V."""
        t, y = sample.t_s, sample.y_rad
        if self._last is None:
            # both relays start inward of where the shaft stands
            self._sign_y = self._sign_z = 1 if y >= 0.0 else -1
        else:
            t_last, y_last = self._last
            z = self.z_rad_s + (t - t_last) * 0.5 * (y + y_last)
            self.bound_reached |= abs(z) > self.z_bound_rad_s
            self.z_rad_s = max(-self.z_bound_rad_s, min(self.z_bound_rad_s, z))
        self._last = (t, y)
        self._sign_y = keep_sign(y, self._sign_y)
        self._sign_z = keep_sign(self.z_rad_s, self._sign_z)
        return -self.h1_V * self._sign_y - self.h2_V * self._sign_z
