"""Backlash: play between the motor and the sensor"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure


class Backlash(Departure):
    """Backlash: play between the motor and the sensor."""

    name = "backlash"
    title = "backlash"
    cause = "play between the motor and the sensor?"
    unit = "rad"
    numbers = ("backlash_rad",)
    one_sided = True
    told_by = "a finer sensor"

    def range_of(self, bench: Bench) -> float:
        """10 mrad."""
        return 0.010
