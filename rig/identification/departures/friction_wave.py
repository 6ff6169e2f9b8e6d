"""Friction that changes along the way with a period of its own"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure
from rig.identification.departures.friction_over_position import FrictionOverPosition


class FrictionWave(Departure):
    """Friction over the angle with any period. The motor's model has none: see ``outside``."""

    name = "friction_wave"
    title = "friction over position with a period of its own"
    cause = "a gear, a cam or a cable?"
    unit = "V"
    numbers = ("friction_wave_sin_V", "friction_wave_cos_V")
    over_position = True
    told_by = "slow sweeps over the travel both ways"
    most_per_rad = 6.0

    def range_of(self, bench: Bench) -> float:
        """As of friction with one period a turn."""
        return FrictionOverPosition().range_of(bench)
