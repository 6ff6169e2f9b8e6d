"""A supply with a resistance, behind a bridge that chops"""

from __future__ import annotations

from rig.identify.departures.departure import Bench, Departure


class Source(Departure):
    """A supply with a resistance, behind a bridge that chops: tau changes with the drive, K hardly does."""

    name = "source"
    title = "resistance of the supply"
    cause = "a weak supply, long leads or a thin connector?"
    unit = "1/V2"
    numbers = ("source_per_V2",)
    one_sided = True
    told_by = "drives of several sizes, with reversals; or the supply's voltage beside them"

    def range_of(self, bench: Bench) -> float:
        """5 % of the winding's resistance at the largest drive."""
        return 0.05 / bench.largest_V**2
