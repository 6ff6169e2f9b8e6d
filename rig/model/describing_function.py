"""The describing function of the triple relay (docs/theory.md 4.1, Properties 3.1 and 3.2).

It takes the motion for a sine, y = A sin(w t). Friction and the dual-channel relay together then have
N(A) = 4/(pi A) (h1 + j (fc - h2)), and 1 + G(jw) N(A) = 0 gives w and A. The true motion is not a sine, so w and A
are approximate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rig.model.limit_cycle import NoLimitCycle


class Oscillation(NamedTuple):
    """A sine: angular frequency, rad/s, and amplitude, rad."""

    omega_rad_s: float
    amplitude_rad: float

    @property
    def period_s(self) -> float:
        """2 pi / omega, s."""
        return 2.0 * math.pi / self.omega_rad_s


class LinearPart(NamedTuple):
    """Time constant, s, and gain, (rad/s)/V, of the motor."""

    tau_s: float
    K_rad_s_V: float


class RelayGains(NamedTuple):
    """Gains of the dual-channel relay, V."""

    h1_V: float
    h2_V: float


def predict(tau_s: float, K_rad_s_V: float, fc_V: float, h1_V: float, h2_V: float) -> Oscillation:
    """Oscillation under the relay: w = h1 / (tau (h2 - fc)), A = 4 K tau (h2 - fc)^2 / (pi h1).

    Raises NoLimitCycle unless h2 > fc (Property 3.1), ValueError on parameters out of range.
    """
    if not (tau_s > 0.0 and K_rad_s_V > 0.0 and h1_V > 0.0 and fc_V >= 0.0):
        raise ValueError("need tau, K, h1 > 0 and f_c >= 0")
    beyond = h2_V - fc_V
    if beyond <= 0.0:
        raise NoLimitCycle(f"h2 = {h2_V:g} V does not exceed the friction of {fc_V:g} V (Property 3.1)")
    return Oscillation(h1_V / (tau_s * beyond), 4.0 * K_rad_s_V * tau_s * beyond * beyond / (math.pi * h1_V))


def linear_part(cycle: Oscillation, fc_V: float, h1_V: float, h2_V: float) -> LinearPart:
    """The inverse of ``predict``: tau and K from the oscillation and the friction. Raises ValueError unless h2 > fc."""
    beyond = h2_V - fc_V
    if not (beyond > 0.0 and cycle.omega_rad_s > 0.0 and cycle.amplitude_rad > 0.0):
        raise ValueError("need h2 > f_c and an oscillation")
    return LinearPart(
        h1_V / (cycle.omega_rad_s * beyond), math.pi * cycle.amplitude_rad * cycle.omega_rad_s / (4.0 * beyond)
    )


def gains_for(cycle: Oscillation, tau_s: float, K_rad_s_V: float, fc_V: float) -> RelayGains:
    """Gains that give a motor this oscillation: h2 = fc + pi A w / (4 K), h1 = w tau (h2 - fc)."""
    beyond = math.pi * cycle.amplitude_rad * cycle.omega_rad_s / (4.0 * K_rad_s_V)
    return RelayGains(cycle.omega_rad_s * tau_s * beyond, fc_V + beyond)
