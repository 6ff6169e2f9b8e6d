"""Friction laws: none; Coulomb; Coulomb with a static level; Tustin's, with Stribeck effect and viscous friction.

f(v) = (fc + (fs - fc) exp(-|v|/vs)) sgn(v) + fv v. Each direction has its own fc and fs (docs/theory.md 1.2, 7.3, 8.1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Friction:
    """Friction as a voltage at the drive, for each direction (docs/theory.md 1.2, 7.3 and 8.1).

    plus_V, minus_V                level while moving towards +y and -y, V, >= 0
    static_plus_V, static_minus_V  level to break away, V, >= the moving level
    stribeck_rad_s                 velocity over which friction falls from the static to the moving level, rad/s, >= 0;
                                   0: the static level acts at rest only
    viscous_V_s_rad                viscous friction, V/(rad/s), >= 0

    With all four levels equal it is Coulomb friction; with all zero there is none.
    Raises ValueError outside these ranges.
    """

    plus_V: float = 0.0
    minus_V: float = 0.0
    static_plus_V: float = 0.0
    static_minus_V: float = 0.0
    stribeck_rad_s: float = 0.0
    viscous_V_s_rad: float = 0.0

    def __post_init__(self) -> None:
        if not min(self.plus_V, self.minus_V) >= 0.0:
            raise ValueError("friction levels must be >= 0 V")
        if not (self.static_plus_V >= self.plus_V and self.static_minus_V >= self.minus_V):
            raise ValueError("static friction must be at least the moving friction")
        if not 0.0 <= self.stribeck_rad_s < math.inf:
            raise ValueError("the Stribeck velocity must be >= 0 rad/s")
        if not 0.0 <= self.viscous_V_s_rad < math.inf:
            raise ValueError("viscous friction must be >= 0 V/(rad/s)")

    @property
    def fc_V(self) -> float:
        """Mean Coulomb level of both directions, V: what motion can show (docs/theory.md 7.3)."""
        return 0.5 * (self.plus_V + self.minus_V)

    @property
    def falls_with_speed(self) -> bool:
        """Whether there is a Stribeck effect: then the motion has no closed form."""
        return self.stribeck_rad_s > 0.0 and (self.static_plus_V > self.plus_V or self.static_minus_V > self.minus_V)

    def level(self, v_rad_s: float) -> float:
        """f(v), V, with the sign of ``v_rad_s``; 0 at rest, where friction balances the drive."""
        if v_rad_s == 0.0:
            return 0.0
        moving, static = (self.plus_V, self.static_plus_V) if v_rad_s > 0.0 else (self.minus_V, self.static_minus_V)
        if self.stribeck_rad_s > 0.0:
            moving += (static - moving) * math.exp(-abs(v_rad_s) / self.stribeck_rad_s)
        return math.copysign(moving, v_rad_s) + self.viscous_V_s_rad * v_rad_s


NONE = Friction()


def coulomb(fc_V: float, fs_V: float | None = None) -> Friction:
    """Coulomb friction of level ``fc_V``. The motor breaks away at ``fs_V`` (default: ``fc_V``)."""
    fs = fc_V if fs_V is None else fs_V
    return Friction(fc_V, fc_V, fs, fs)


def tustin(fc_V: float, fs_V: float, stribeck_rad_s: float, viscous_V_s_rad: float = 0.0) -> Friction:
    """Tustin's law, equal in both directions: ``fs_V`` at rest falls to ``fc_V`` with speed, plus viscous friction."""
    return Friction(fc_V, fc_V, fs_V, fs_V, stribeck_rad_s, viscous_V_s_rad)
