"""A first-order lag of the drive: inductance, or a filter"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rig.identification.departures.departure import Bench, Departure


class Lag(Departure):
    """A first-order lag of the drive: inductance, or a filter."""

    name = "lag"
    title = "lag of the drive"
    cause = "an inductance, or a filter before the bridge?"
    unit = "s"
    numbers = ("lag_s",)
    one_sided = True
    told_by = "faster samples, with the times at which the drive acts (t_u_s)"

    def range_of(self, bench: Bench) -> float:
        """10 ms."""
        return 0.010

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """Not from 0: there a lag is a delay."""
        return [{"lag_s": 0.003}, {"lag_s": 0.010}]
