"""Static friction above the moving one, at rest only"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.identification.departures.departure import Bench, Departure

SHARES = (0.1, 0.25, 0.6)  # of the friction in motion


class Static(Departure):
    """Static friction above the moving one, at rest only."""

    name = "static"
    title = "static friction"
    cause = "a motor that has to be broken away?"
    unit = "V"
    numbers = ("static_V",)
    one_sided = True
    leaps = True
    told_by = "slow breakaway ramps both ways (`rig relay` with breakaway)"

    def range_of(self, bench: Bench) -> float:
        """Half the friction in motion."""
        return max(0.5 * bench.fc_V, min(0.02, bench.half_drive_V))

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """From 0, and from sizes: whether a shaft sticks has no derivative."""
        return [{}, *({"static_V": share * bench.fc_V} for share in SHARES if bench.fc_V > 0.0)]
