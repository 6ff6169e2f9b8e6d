"""Viscous friction that differs by direction, by twice this"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure


class ViscousByDirection(Departure):
    """Viscous friction that differs by direction, by twice this."""

    name = "viscous_by_direction"
    title = "viscous friction that differs by direction"
    cause = "a gear or a screw under load? Or an encoder that loses counts one way?"
    unit = "V s/rad"
    numbers = ("viscous_by_direction_V_s_rad",)
    both_ways = True
    told_by = "a relay test of another amplitude"

    def range_of(self, bench: Bench) -> float:
        """20 % of the whole, 1 / K."""
        return 0.2 / bench.K_rad_s_V
