"""How a tracking error dies away under the linearising drive (docs/theory.md 11.1)."""

from __future__ import annotations

import cmath
import math
from typing import Final

K1_1_S: Final = 12.0  # of (34), where a config says nothing else
K2_1_S2: Final = 36.0  # both poles at -6 1/s


class ErrorDecay:
    """How an error dies away by (35): e'' + k1 e' + k2 e = 0, from e(0) = ``offset_rad`` and e'(0) = 0."""

    def __init__(self, offset_rad: float, k1_1_s: float, k2_1_s2: float) -> None:
        self.offset_rad = offset_rad
        half = 0.5 * k1_1_s
        root = cmath.sqrt(half * half - k2_1_s2)
        self._poles = (-half + root, -half - root)
        self._is_double = abs(root) < 1e-6 * half

    def at(self, t_s: float) -> tuple[float, float]:
        """Error, rad, and its derivative, rad/s, at ``t_s`` >= 0."""
        one, other = self._poles
        if self._is_double:
            p, fading = one.real, math.exp(one.real * t_s)
            return self.offset_rad * (1.0 - p * t_s) * fading, -self.offset_rad * p * p * t_s * fading
        first, second = cmath.exp(one * t_s), cmath.exp(other * t_s)
        scale = self.offset_rad / (one - other)
        return (scale * (one * second - other * first)).real, (scale * one * other * (second - first)).real
