"""Relays: the dual-channel relay, the single relay with hysteresis, and their common sign rule."""

from __future__ import annotations

import math

from rig.backends.driver import RelayCommand
from rig.control.law import BareLaw
from rig.core.signals import Sample


def keep_sign(value: float, previous: int) -> int:
    """Sign of ``value``; at exactly zero the previous state stays (docs/theory.md 2.2)."""
    if value > 0.0:
        return 1
    if value < 0.0:
        return -1
    return previous


class DualChannelRelay(BareLaw):
    """u = -h1 sgn(y) - h2 sgn(z), one relay on position and one on its integral (docs/theory.md 2.1).

    z is the trapezoidal integral of y over the samples' true times. It is zero at the first sample, and stays within
    +-z_bound_rad_s, so that a start far from the centre does not wind it up. The bound must exceed three times the
    cycle's largest |z|, else it shortens the period (docs/theory.md 2.2).
    Raises ValueError for gains below 0 V, and for a bound that is not > 0.
    """

    def __init__(self, h1_V: float, h2_V: float, z_bound_rad_s: float) -> None:
        if not (h1_V >= 0.0 and h2_V >= 0.0 and z_bound_rad_s > 0.0):
            raise ValueError("relay gains must be >= 0 V and the bound on the integral > 0 rad s")
        self.h1_V = h1_V
        self.h2_V = h2_V
        self.z_bound_rad_s = z_bound_rad_s
        self.z_rad_s = 0.0
        self.bound_reached = False
        self._sign_y = 0
        self._sign_z = 0
        self._last: tuple[float, float] | None = None

    def restart(self) -> None:
        """Start again at the next sample: integral zero, both relays inward."""
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


class RelayOnCounts:
    """The dual-channel relay as a device runs it, in whole counts and ticks (firmware/core/relay.h).

    The law is ``DualChannelRelay`` with counts instead of rad and ticks instead of s. These are binary fractions, so
    rounding affects no decision.

    command     as the device has it
    h1_V, h2_V  gains that its drives come from
    """

    def __init__(self, command: RelayCommand, gains_V: tuple[float, float]) -> None:
        self.h1_V, self.h2_V = gains_V
        self.command = command
        self._law = DualChannelRelay(1.0, 2.0, command.z_bound_count_ticks)
        self._drives_V = dict(zip((-3.0, 1.0, -1.0, 3.0), command.drives_V, strict=True))  # by -1 sgn(y) - 2 sgn(z)
        self._ticks = 0

    @property
    def z_rad_s(self) -> float:
        """Integral of the position."""
        return self._law.z_rad_s * self.command.count_tick_rad_s

    @property
    def bound_reached(self) -> bool:
        """Whether the integral has reached its bound."""
        return self._law.bound_reached

    def step(self, sample: Sample) -> float:
        """Drive for this tick's sample, V."""
        y_counts = self.command.direction * (sample.y_counts - self.command.centre_counts)
        state = self._law.step(Sample(float(self._ticks), y_counts, sample.y_counts))
        self._ticks += 1
        return self._drives_V[state]


class HystereticRelay(BareLaw):
    """u = -|d| sgn(y) with hysteresis: the sign changes once y is beyond eps on the other side (docs/theory.md 5.1).

    The first drive is +d_V, towards rising positions if d_V > 0, as from a start at or below zero.
    d_V     drive, V; not 0
    eps_rad half width of the hysteresis, rad; > 0
    Raises ValueError outside these ranges.
    """

    def __init__(self, d_V: float, eps_rad: float) -> None:
        if not (abs(d_V) > 0.0 and math.isfinite(d_V) and eps_rad > 0.0):
            raise ValueError("a hysteretic relay needs a drive that is not 0 V and a hysteresis > 0 rad")
        self.d_V = d_V
        self.eps_rad = eps_rad
        self._sign_y = -1 if d_V > 0.0 else 1

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V."""
        y = sample.y_rad
        beyond = y if abs(y) > self.eps_rad else 0.0  # within the band: as at zero, the state stays
        self._sign_y = keep_sign(beyond, self._sign_y)
        return -abs(self.d_V) * self._sign_y
