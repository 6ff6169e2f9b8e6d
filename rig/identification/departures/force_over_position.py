"""A force that depends on the position, once a turn"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure


class ForceOverPosition(Departure):
    """A force that depends on the position, once a turn."""

    name = "force_over_position"
    title = "force over position"
    cause = "an unbalanced load, or a cable?"
    unit = "V"
    numbers = ("force_sin_V", "force_cos_V")
    over_position = True
    told_by = "slow sweeps over the travel both ways"

    def range_of(self, bench: Bench) -> float:
        """0.1 V, at most half the largest drive."""
        return min(0.1, bench.half_drive_V)
