"""The motor supply as a device measures it, against the one that the config tells: what a difference does to K."""

from __future__ import annotations

import math
from dataclasses import dataclass

TOLERANCE = 0.04  # of the reading: its divider's resistors and the 5 V that it counts on; one digit is 0.7 % of 12 V


@dataclass(frozen=True)
class SupplyReading:
    """What the device measured, and what the drive was scaled with.

    measured_V    motor supply as the device measures it; nan where it does not
    at_least      the reading is at its end: the supply is ``measured_V`` or more
    believed_V    drive.supply_V
    bridge_drop_V drive.bridge_drop_V
    """

    measured_V: float
    at_least: bool
    believed_V: float
    bridge_drop_V: float

    @property
    def share(self) -> float:
        """By how much, at least, the supply is off, relative to ``believed_V``; 0 where nothing is known."""
        if math.isnan(self.measured_V) or (self.at_least and self.measured_V <= self.believed_V):
            return 0.0
        return self.measured_V / self.believed_V - 1.0

    @property
    def objection(self) -> str | None:
        """What speaks against estimates of this run, and what to do; None within ``TOLERANCE``.

        A drive of u reaches the motor as u times the true full voltage by the believed one: K comes out as much too
        large, friction too small.
        """
        if abs(self.share) <= TOLERANCE:
            return None
        scale = (self.measured_V - self.bridge_drop_V) / (self.believed_V - self.bridge_drop_V)
        too = ("large", "small") if scale > 1.0 else ("small", "large")
        least = "at least " if self.at_least else ""
        return (
            f"the device measures a motor supply of {least}{self.measured_V:.1f} V, drive.supply_V is "
            f"{self.believed_V:g} V: K is {least}{100.0 * abs(scale - 1.0):.0f} % too {too[0]} then, and f_c too "
            f"{too[1]}; measure the supply with the motor running and set drive.supply_V, then record again"
        )
