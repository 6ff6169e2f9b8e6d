"""Friction that depends on the position, once a turn"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure


class FrictionOverPosition(Departure):
    """Friction that depends on the position, once a turn."""

    name = "friction_over_position"
    title = "friction over position"
    cause = "a shaft or a gear that is not true?"
    unit = "V"
    numbers = ("friction_sin_V", "friction_cos_V")
    over_position = True
    told_by = "slow sweeps over the travel both ways"

    def range_of(self, bench: Bench) -> float:
        """A fifth of the friction."""
        return max(0.2 * bench.fc_V, min(0.01, bench.half_drive_V))
