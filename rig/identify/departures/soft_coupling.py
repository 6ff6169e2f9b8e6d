"""A soft coupling between motor and load"""

from __future__ import annotations

import math

from rig.identify.departures.departure import Bench, Departure

SLOWEST_RAD_S = 2.0 * math.pi * 8.0  # of a coupling that nobody sees by eye


class SoftCoupling(Departure):
    """A soft coupling: one over the square of its frequency. The motor's model has none: see ``outside``."""

    name = "soft_coupling"
    title = "soft coupling"
    cause = "a belt, or a long shaft?"
    unit = "s2"
    numbers = ("soft_coupling_s2",)
    one_sided = True
    told_by = "quick reversals, with rows of a few milliseconds"

    def range_of(self, bench: Bench) -> float:
        """Of a coupling of 8 Hz."""
        return SLOWEST_RAD_S**-2
