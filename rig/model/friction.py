"""Friction laws that are constant between velocity reversals, so that the motion has a closed form."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Friction:
    """Friction referred to the drive input, by direction (theory section 1, 8).

    plus_V, minus_V                level while moving towards +y and -y, V, >= 0
    static_plus_V, static_minus_V  level to break away, V, >= the moving level

    With all four equal it is Coulomb friction; with all zero there is none.
    Raises ValueError if a level is negative, or a static level is below its moving level.
    """

    plus_V: float = 0.0
    minus_V: float = 0.0
    static_plus_V: float = 0.0
    static_minus_V: float = 0.0

    def __post_init__(self) -> None:
        if min(self.plus_V, self.minus_V) < 0.0:
            raise ValueError("friction levels must be >= 0 V")
        if self.static_plus_V < self.plus_V or self.static_minus_V < self.minus_V:
            raise ValueError("static friction must be at least the moving friction")

    @property
    def fc_V(self) -> float:
        """Mean Coulomb level of both directions, V: what motion can show (theory section 8)."""
        return 0.5 * (self.plus_V + self.minus_V)


NONE = Friction()


def coulomb(fc_V: float, fs_V: float | None = None) -> Friction:
    """Coulomb friction of level ``fc_V``, breaking away at ``fs_V`` (default: the same)."""
    fs = fc_V if fs_V is None else fs_V
    return Friction(fc_V, fc_V, fs, fs)


def directional(plus_V: float, minus_V: float, static_ratio: float = 1.0) -> Friction:
    """Coulomb friction with a level for each direction; static level ``static_ratio`` times it."""
    return Friction(plus_V, minus_V, plus_V * static_ratio, minus_V * static_ratio)
