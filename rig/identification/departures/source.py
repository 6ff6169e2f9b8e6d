"""A supply with a resistance, behind a bridge that chops"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.identification.departures.departure import Bench, Departure
from rig.identification.departures.load_friction import MOST_VISCOUS, VISCOUS


class Source(Departure):
    """A supply with a resistance, behind a bridge that chops: tau changes with the drive, K hardly does."""

    name = "source"
    title = "resistance of the supply"
    cause = "a weak supply, long leads or a thin connector?"
    unit = "1/V2"
    numbers = ("source_per_V2",)
    shape = ("viscous_share",)
    one_sided = True
    told_by = "drives of several sizes, with reversals; or the supply's voltage beside them"
    may_hide = False  # a sag by the current is its line: see ``outside``

    def range_of(self, bench: Bench) -> float:
        """5 % of the winding's resistance at the largest drive."""
        return 0.05 / bench.largest_V**2

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """Nearly all of 1/K is back-EMF."""
        return [{"viscous_share": VISCOUS}]

    def limits(self, bench: Bench) -> Mapping[str, tuple[float, float]]:
        """What a share may be."""
        return {"viscous_share": (0.0, MOST_VISCOUS)}
