"""A drive that falls behind as it grows: a supply or a bridge with a resistance"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure


class Sag(Departure):
    """A drive that falls behind as it grows: a supply or a bridge with a resistance."""

    name = "sag"
    title = "sag of the drive"
    cause = "a supply with long leads, or a bridge that heats?"
    unit = "1/V"
    numbers = ("sag_per_V",)
    one_sided = True
    told_by = "a relay test of another amplitude"

    def range_of(self, bench: Bench) -> float:
        """3 % per volt, and 15 % at the largest drive."""
        return min(0.03, 0.15 / bench.largest_V)
