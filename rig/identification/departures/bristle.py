"""Bristles: friction that yields before it slides (LuGre)"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.identification.departures.departure import Bench, Departure


class Bristle(Departure):
    """Bristles: friction that yields before it slides (LuGre)."""

    name = "bristle"
    title = "bristles: friction that yields before it slides"
    cause = "a seal, a belt, or grease?"
    unit = "V/rad"
    numbers = ("bristle_V_rad",)
    one_sided = True
    told_by = "a small relay test with a fine sensor"

    def range_of(self, bench: Bench) -> float:
        """100 V/rad; softer ones are seen."""
        return 100.0

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """From soft to stiff: as far as a thirtieth to a thousandth of the travel bends them fully."""
        return [
            {"bristle_V_rad": max(bench.fc_V, min(0.02, bench.half_drive_V)) / (share * bench.half_travel_rad)}
            for share in (0.03, 0.006)
        ]

    def limits(self, bench: Bench) -> Mapping[str, tuple[float, float]]:
        """Stiffer ones cannot be told from Coulomb friction."""
        low, high = (
            max(bench.fc_V, min(0.02, bench.half_drive_V)) / (share * bench.half_travel_rad) for share in (0.3, 0.001)
        )
        return {"bristle_V_rad": (low, high)}
