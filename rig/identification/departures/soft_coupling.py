"""A soft coupling between motor and load"""

from __future__ import annotations

import math

from rig.identification.departures.departure import Bench, Departure

FREQUENCIES_RAD_S = tuple(2.0 * math.pi * hertz for hertz in (6.0, 9.0, 13.0, 19.0))  # slower ones are seen by eye
DAMPING = 0.1  # of a belt


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
        """Of the slowest coupling."""
        return float(FREQUENCIES_RAD_S[0] ** -2)
