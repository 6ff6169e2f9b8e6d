"""The sensor of a config: its range between the rails, and the size of a count."""

from __future__ import annotations

import math
from itertools import pairwise

from rig.config.schema import Experiment


def range_rad(e: Experiment) -> tuple[float, float]:
    """Positions within the calibration's points and between the rails, rad; (inf, -inf) where there are none.

    An encoder shows all positions: (-inf, inf).
    """
    if e.sensor.encoder is not None:
        return -math.inf, math.inf
    points = e.sensor.points
    rail_low, rail_high = e.sensor.rails
    low, high = max(points[0][0], rail_low + 1), min(points[-1][0], rail_high - 1)
    if low > high:
        return float("inf"), float("-inf")

    def position(counts: int) -> float:
        for (c0, r0), (c1, r1) in pairwise(points):
            if counts <= c1:
                return r0 + (counts - c0) * (r1 - r0) / (c1 - c0)
        return points[-1][1]

    ends = sorted((position(low), position(high)))
    return ends[0], ends[1]


def count_rad(e: Experiment) -> float:
    """Mean size of one count over the calibration, rad."""
    points = e.sensor.points
    return abs((points[-1][1] - points[0][1]) / (points[-1][0] - points[0][0]))


def full_range_rad(e: Experiment) -> float:
    """What the readings 0 to counts_max span, rad; of an encoder one turn of the measured shaft."""
    if e.sensor.encoder is not None:
        return 2.0 * math.pi
    return count_rad(e) * (e.sensor.counts_max or 0)
