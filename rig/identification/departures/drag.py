"""Drag that grows with the square of the speed"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure


class Drag(Departure):
    """Drag that grows with the square of the speed."""

    name = "drag"
    title = "drag with the square of the speed"
    cause = "a fan, or oil?"
    unit = "V s2/rad2"
    numbers = ("drag_V_s2_rad2",)
    one_sided = True
    told_by = "a relay test of another amplitude"

    def range_of(self, bench: Bench) -> float:
        """A tenth of the viscous friction, 1 / K, at the largest speed."""
        return 0.1 / (bench.K_rad_s_V * bench.top_rad_s)
