"""A bridge's dead band, from its mean voltage across a resistor at some duties."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rig.running.calibrate.refusal import Refusal

DUTIES = (0.4, 0.7, 1.0)  # of the largest drive
_PASSES_V = 0.05  # less is a bridge that passes nothing
_LARGEST = 0.5
_OFF_LINE = 0.05  # of the largest voltage


class Volts(NamedTuple):
    """The voltage that a meter shows at a duty, both without sign."""

    duty: float
    V: float


@dataclass(frozen=True)
class DeadBandFound:
    """The duty up to which the bridge passes nothing, and the voltage at full duty, by the line."""

    duty: float
    full_V: float


def dead_band(readings: Sequence[Volts], supply_V: float) -> DeadBandFound:
    """From readings in one direction. Raises Refusal: nothing passes, no line, more than the supply."""
    passing = [reading for reading in readings if reading.V > _PASSES_V]
    if len(passing) < 2:
        raise Refusal(
            "the bridge passes next to nothing: "
            + ", ".join(f"{r.V:g} V at {100.0 * r.duty:.0f} % duty" for r in readings),
            "switch the motor's supply on, measure at the bridge's outputs, or raise drive.max_V",
        )
    duty, volts = (np.array(column) for column in zip(*passing, strict=True))
    slope_V, at_zero_V = (float(c) for c in np.polyfit(duty, volts, 1))
    off_V = float(np.max(np.abs(slope_V * duty + at_zero_V - volts)))
    if slope_V <= 0.0 or off_V > _OFF_LINE * float(volts.max()):
        raise Refusal(
            f"the voltages do not rise in a line with the duty: off by {off_V:.3g} V",
            "wait until the meter stands still, and read DC volts; measure again",
        )
    full_V = slope_V + at_zero_V
    if full_V > 1.1 * supply_V:
        raise Refusal(
            f"by these voltages full duty would give {full_V:.3g} V, and drive.supply_V is {supply_V:g}",
            "correct drive.supply_V, or the readings: volts, not millivolts",
        )
    found = max(-at_zero_V / slope_V, 0.0)
    if found >= _LARGEST or not math.isfinite(found):
        raise Refusal(f"a dead band of {100.0 * found:.0f} % duty is none", "measure again")
    return DeadBandFound(round(found, 4), full_V)
