"""The old name of ``rig.calibration``."""

from rig.calibration import (
    Calibration,
    DriveMap,
    TachometerScale,
    hard_limits_in_counts,
    largest_drive_in_units,
    polarity,
)

__all__ = [
    "Calibration",
    "DriveMap",
    "TachometerScale",
    "hard_limits_in_counts",
    "largest_drive_in_units",
    "polarity",
]
