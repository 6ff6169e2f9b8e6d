"""The motor supply: the device's measurement against the config, and what a difference does to K."""

from __future__ import annotations

import math
from dataclasses import dataclass

TOLERANCE = 0.04  # of the reading: resistors of its divider, and its 5 V reference; one digit is 0.7 % of 12 V


@dataclass(frozen=True)
class SupplyReading:
    """The measured motor supply, and the one from the config that scales the drive.

    measured_V    motor supply as the device measures it; nan if it does not measure it
    at_least      the reading is at the end of its range: the supply is ``measured_V`` or more
    believed_V    drive.supply_V
    bridge_drop_V drive.bridge_drop_V
    """

    measured_V: float
    at_least: bool
    believed_V: float
    bridge_drop_V: float

    @property
    def share(self) -> float:
        """Smallest possible error of the supply, relative to ``believed_V``; 0 without a measurement."""
        if math.isnan(self.measured_V) or (self.at_least and self.measured_V <= self.believed_V):
            return 0.0
        return self.measured_V / self.believed_V - 1.0

    @property
    def objection(self) -> str | None:
        """Why not to trust estimates of this run, and what to do; None within ``TOLERANCE``.

        The motor gets u times the ratio of the true supply to the believed one. So K comes out too large by this ratio,
        and friction too small.
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
