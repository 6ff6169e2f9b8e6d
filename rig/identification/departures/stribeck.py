"""The Stribeck effect: friction that falls with speed"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.identification.departures.departure import Bench, Departure


class Stribeck(Departure):
    """The Stribeck effect: friction that falls with speed."""

    name = "stribeck"
    title = "Stribeck effect"
    cause = "a bearing or a gear that runs dry?"
    unit = "V"
    numbers = ("stribeck_V",)
    shape = ("stribeck_rad_s",)
    one_sided = True
    told_by = "slow motion: a small relay test, or slow ramps"

    def range_of(self, bench: Bench) -> float:
        """Half the friction in motion."""
        return max(0.5 * bench.fc_V, min(0.02, bench.half_drive_V))

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """A slow, a middle and a fast one."""
        return [{"stribeck_rad_s": share * bench.top_rad_s} for share in (0.03, 0.1, 0.3)]

    def limits(self, bench: Bench) -> Mapping[str, tuple[float, float]]:
        """A speed that the motion goes through."""
        return {"stribeck_rad_s": (0.003 * bench.top_rad_s, bench.top_rad_s)}
