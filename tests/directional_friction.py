"""Friction that differs by direction, as the tests of laws and models have it."""

from __future__ import annotations

from rig.model.friction import Friction


def directional(plus_V: float, minus_V: float, static_ratio: float = 1.0) -> Friction:
    """Coulomb friction with a level for each direction; static level ``static_ratio`` times it."""
    return Friction(plus_V, minus_V, plus_V * static_ratio, minus_V * static_ratio)
