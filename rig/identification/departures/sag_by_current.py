"""A drive that falls behind as the current grows"""

from __future__ import annotations

from rig.identification.departures.departure import Bench, Departure
from rig.identification.departures.sag import Sag


class SagByCurrent(Departure):
    """A drive that falls behind as the current grows. The motor's model has no such law: see ``outside``."""

    name = "sag_by_current"
    title = "sag of the drive by the current"
    cause = "a supply with long leads?"
    unit = "1/V"
    numbers = ("sag_per_V",)
    one_sided = True
    told_by = "drives of several sizes, with reversals; or the supply's voltage beside them"

    def range_of(self, bench: Bench) -> float:
        """As of a sag."""
        return Sag().range_of(bench)
