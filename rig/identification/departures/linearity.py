"""A sensor that is not straight over the travel"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure


class Linearity(Departure):
    """A sensor that is not straight over the travel."""

    name = "linearity"
    title = "linearity of the sensor"
    cause = "a potentiometer, or its calibration?"
    unit = "rad"
    numbers = ("linearity_sin1_rad", "linearity_cos1_rad", "linearity_sin2_rad", "linearity_cos2_rad")
    told_by = "a calibration at more angles, or relay tests at two speeds"

    def range_of(self, bench: Bench) -> float:
        """By the sensor's data sheet."""
        return bench.linearity_rad
