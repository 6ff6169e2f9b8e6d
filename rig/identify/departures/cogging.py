"""Cogging: the force of the poles, several times a turn"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from rig.identify.departures.departure import Bench, Departure

MOST_PER_RAD = 30.0


class Cogging(Departure):
    """Cogging: the force of the poles, several times a turn."""

    name = "cogging"
    title = "cogging"
    cause = "the poles of the motor, or the teeth of a gear?"
    unit = "V"
    numbers = ("cogging_sin_V", "cogging_cos_V")
    shape = ("cogging_per_rad",)
    over_position = True
    told_by = "slow sweeps over the travel both ways"

    def range_of(self, bench: Bench) -> float:
        """0.05 V, at most half the largest drive."""
        return min(0.05, bench.half_drive_V)

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """Orders from 3 a radian to what the travel shows, closer than half a period over it.

        Beyond one turn they are whole: a shaft's poles come again after each turn.
        """
        if bench.half_travel_rad > math.pi:
            return [
                {"cogging_per_rad": float(order)} for order in range(math.ceil(self._fewest(bench)), int(MOST_PER_RAD))
            ]
        step = 1.5 / bench.half_travel_rad
        orders = []
        order = self._fewest(bench)
        while order < MOST_PER_RAD:
            orders.append({"cogging_per_rad": order})
            order += step
        return orders

    def limits(self, bench: Bench) -> Mapping[str, tuple[float, float]]:
        """Fewer are a force over position; more are beyond the samples."""
        return {"cogging_per_rad": (self._fewest(bench), MOST_PER_RAD)}

    def _fewest(self, bench: Bench) -> float:
        return max(3.0, 3.0 / bench.half_travel_rad)
