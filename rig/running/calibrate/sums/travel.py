"""Travel limits from the mechanical stops."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rig.running.calibrate.refusal import Refusal

MARGIN_RAD = 0.2  # from a hard limit to the stop behind it
_LEAST_RAD = 0.3  # from the centre to a hard limit: less is too little to stop and to measure in

Interval = tuple[float, float]


@dataclass(frozen=True)
class Travel:
    """The limits, rad; and the end of each side: `stop` or `calibration`, whichever comes first."""

    soft_rad: Interval
    hard_rad: Interval
    ends: tuple[str, str]


def travel(stops_rad: Interval, shown_rad: Interval, before: tuple[Interval, Interval]) -> Travel:
    """Hard limits inside stops and calibration; soft limits in the same proportion to them as before.

    stops_rad  where the shaft meets its stops; infinite: there is none
    shown_rad  positions that the calibration covers
    before     soft and hard limits of the config so far, rad
    Raises Refusal: the stops in the wrong order, the centre outside, no room.
    """
    low_rad, high_rad = stops_rad
    if low_rad >= high_rad:
        raise Refusal(
            f"the low stop is at {_rad(low_rad)} and the high stop at {_rad(high_rad)}: the wrong way round",
            "the high stop is that to the positive side of your angles: begin with the other one",
        )
    if not low_rad < 0.0 < high_rad:
        raise Refusal(
            f"the centre, 0, is outside the travel: {_rad(low_rad)} to {_rad(high_rad)}",
            "0 must be near the middle between the stops: measure the angles again, from that middle",
        )
    inside = (low_rad + MARGIN_RAD, high_rad - MARGIN_RAD)
    hard_rad = _inward(max(inside[0], shown_rad[0]), min(inside[1], shown_rad[1]))
    ends = tuple(
        "stop" if abs(limit) < abs(shown) else "calibration" for limit, shown in zip(inside, shown_rad, strict=True)
    )
    if not (hard_rad[0] <= -_LEAST_RAD and hard_rad[1] >= _LEAST_RAD):
        raise Refusal(
            f"hard limits would be {_rad(hard_rad[0])} to {_rad(hard_rad[1])}, {MARGIN_RAD} rad inside the stops and "
            "within the calibrated angles: too little to stop and to measure in",
            f"at least {_LEAST_RAD} rad to each side: calibrate farther out, or put the centre in the middle",
        )
    soft, hard = before
    soft_rad = _inward(hard_rad[0] * soft[0] / hard[0], hard_rad[1] * soft[1] / hard[1])
    return Travel(soft_rad, hard_rad, (ends[0], ends[1]))


def _inward(low_rad: float, high_rad: float) -> Interval:
    """To the hundredth, inward."""
    return math.ceil(100.0 * low_rad - 1e-6) / 100.0, math.floor(100.0 * high_rad + 1e-6) / 100.0


def _rad(rad: float) -> str:
    return f"{rad:+.3f} rad ({math.degrees(rad):+.1f}°)"
