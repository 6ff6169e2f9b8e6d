"""Dead band: a bridge that passes nothing below a small drive, and loses that much above it"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.identification.departures.departure import Bench, Departure

EVEN = 8  # sizes, evenly up to the largest


class DeadBand(Departure):
    """Dead band: a bridge that passes nothing below a small drive, and loses that much above it.

    Where the drive always goes along with the motion, a dead band is friction, and nothing can tell them apart.
    """

    name = "dead_band"
    title = "dead band of the drive"
    cause = "a bridge whose transistors need a least pulse?"
    unit = "V"
    numbers = ("dead_band_V",)
    one_sided = True
    told_by = "a relay test with drives against the motion: h1 nearly as large as h2"

    def fits(self, bench: Bench) -> bool:
        """Where the drive rests, or pushes against the motion."""
        return not bench.goes_along

    def range_of(self, bench: Bench) -> float:
        """0.1 V: a duty of 1 % at 12 V; at most half the largest drive."""
        return min(0.1, bench.half_drive_V)

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """From 0, and from sizes that swallow a small drive whole: that is no longer linear."""
        return [{}, *({"dead_band_V": share * bench.largest_V} for share in (0.02, 0.05))]

    def sizes(self, bench: Bench) -> Sequence[float]:
        """Where a drive is smaller than it may be: even steps, and close to each such drive, before and behind it."""
        largest = self.range_of(bench)
        near = [share * drive for drive in bench.small_drives_V if drive < largest for share in (0.9, 1.1)]
        if not near:
            return ()
        even = (largest * (k + 0.5) / EVEN for k in range(EVEN))
        return sorted({*(size for size in near if size < largest), *even})
