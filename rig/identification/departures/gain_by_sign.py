"""A gain that differs by the sign of the drive, by twice this share"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure


class GainBySign(Departure):
    """A gain that differs by the sign of the drive, by twice this share."""

    name = "gain_by_sign"
    title = "gain that differs by sign"
    cause = "two half bridges that are not alike? Or an encoder that loses counts one way?"
    unit = "1"
    numbers = ("gain_by_sign",)
    both_ways = True
    told_by = "two relay tests, one of them with an offset"

    def range_of(self, bench: Bench) -> float:
        """5 %."""
        return 0.05
