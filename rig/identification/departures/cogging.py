"""Cogging: the force of the poles, several times a turn"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from rig.identification.departures.departure import Bench, Departure

MOST_PER_RAD = 30.0
OF_POLES = 3.0  # per radian: from there on it is the poles, or teeth; below it is a shaft behind a gear, a cam, a cable
ROW_RAD = 1.5  # of a wave, from one row to the next at the mean speed: at twice that speed, more is beyond the samples
MOST_SLOW = 90  # starts below it: over a longer travel they would be too many


class Cogging(Departure):
    """Cogging: the force of the poles, several times a turn."""

    name = "cogging"
    title = "cogging"
    cause = "the poles of the motor, the teeth of a gear, or a load behind one?"
    unit = "V"
    numbers = ("cogging_sin_V", "cogging_cos_V")
    shape = ("cogging_per_rad",)
    over_position = True
    told_by = "slow sweeps over the travel both ways"

    def range_of(self, bench: Bench) -> float:
        """0.05 V, at most half the largest drive."""
        return min(0.05, bench.half_drive_V)

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """Orders from one period over the travel on, closer than half a period over it, as far as samples show them.

        Beyond one turn those of poles are whole: a shaft's poles come again after each turn.
        """
        step = 1.5 / bench.half_travel_rad
        orders = [order for order in self._slow(bench) if order < min(OF_POLES, self._most(bench))]
        if bench.half_travel_rad > math.pi:
            orders += [float(order) for order in range(math.ceil(OF_POLES), int(self._most(bench)))]
        else:
            first = max(OF_POLES, 2.0 * step)
            orders += [first + k * step for k in range(math.ceil((self._most(bench) - first) / step))]
        return [{"cogging_per_rad": order} for order in orders]

    def limits(self, bench: Bench) -> Mapping[str, tuple[float, float]]:
        """Fewer are a force over position; more are beyond the samples."""
        fewest = min(self._slow(bench), default=max(OF_POLES, 3.0 / bench.half_travel_rad))
        return {"cogging_per_rad": (fewest, max(fewest, self._most(bench)))}

    def fits(self, bench: Bench) -> bool:
        """Where the samples show a wave at all."""
        return super().fits(bench) and bool(self.trials(bench))

    def _most(self, bench: Bench) -> float:
        return min(MOST_PER_RAD, ROW_RAD / max(bench.path_per_row_rad, 1e-9))

    def _slow(self, bench: Bench) -> list[float]:
        """Orders below those of poles; none where a radian or two of travel, or very many turns, do not show them."""
        step = 1.5 / bench.half_travel_rad
        count = math.ceil((OF_POLES - 2.0 * step) / step)
        return [(2 + k) * step for k in range(count)] if 0 < count <= MOST_SLOW else []
