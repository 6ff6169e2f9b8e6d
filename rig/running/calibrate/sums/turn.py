"""An encoder's counts and sign, checked by a turn by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rig.running.calibrate.refusal import Refusal

_LEAST_RAD = math.radians(30.0)
_FACTORS = (4.0, 2.0, 0.5, 0.25)  # lines taken for edges, one channel for two, and the other way round


@dataclass(frozen=True)
class TurnFound:
    """What a turn by hand shows: counts a turn of the encoder's shaft and sign for the config; what was measured."""

    counts_per_turn: int
    sign: int
    measured_per_turn: float  # of the measured shaft
    error_per_turn: float


def turn(moved_counts: float, turned_rad: float, error_rad: float, believed: tuple[int, float]) -> TurnFound:
    """Counts and sign from a turn by hand towards rising positions.

    moved_counts  by the encoder; turned_rad  by the eye, > 0; error_rad  of that angle
    believed      counts for a turn of the encoder, and its gear, of the config
    Raises Refusal: too small a turn, counts that fit neither this config nor one with lines for edges.
    """
    counts_per_turn, gear = believed
    if turned_rad < _LEAST_RAD:
        raise Refusal(
            f"a turn of {math.degrees(turned_rad):.4g}° is too small to count by",
            f"turn it towards rising positions by at least {math.degrees(_LEAST_RAD):.0f}°, better by a whole turn",
        )
    turns = turned_rad / (2.0 * math.pi)
    measured = abs(moved_counts) / turns
    error = measured * error_rad / turned_rad + 2.0 / turns
    sign = 1 if moved_counts > 0.0 else -1
    for factor in (1.0, *_FACTORS):
        counts = counts_per_turn * factor
        if counts == round(counts) and abs(counts * gear - measured) <= error:
            return TurnFound(round(counts), sign, measured, error)
    raise Refusal(
        f"the shaft made {measured:.0f} ±{error:.0f} counts a turn; the config says {counts_per_turn * gear:.0f} "
        f"(counts_per_turn {counts_per_turn} x gear {gear:g})",
        "type the angle again; if it was right, correct counts_per_turn (edges: four times the lines) or gear by their "
        "data sheets",
    )
