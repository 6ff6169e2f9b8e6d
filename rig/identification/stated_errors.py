"""What no record shows: the errors of a bench's sensor, supply and clock, as its config states them.

docs/theory.md 12.9 has the equations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.core.calibration import CALIBRATION_ERROR_RAD, LINEARITY_PERCENT, SUPPLY_ERROR_PERCENT
from rig.run_folder.results import RunMeta

CLOCK_ERROR = 60e-6  # of a time, relative: how well a run knows the rate of a device's clock (docs/timing.md)
POINTS = 200  # of the travel, for the best line through a calibration's error


@dataclass(frozen=True)
class StatedErrors:
    """Largest errors of one bench. A CSV file and a run of an older version have the config's defaults.

    linearity_percent       the sensor's departure from a straight line, % of its full range
    full_range_rad          that range, rad; nan: not known, then the driven travel counts
    calibration_error_rad   of each angle of the calibration, rad
    calibration_rad         those angles, rad, rising; (): not known, then the ends of the driven travel count
    supply_error_percent    of the motor supply, %
    """

    linearity_percent: float = LINEARITY_PERCENT
    full_range_rad: float = math.nan
    calibration_error_rad: float = CALIBRATION_ERROR_RAD
    calibration_rad: tuple[float, ...] = ()
    supply_error_percent: float = SUPPLY_ERROR_PERCENT

    @classmethod
    def of(cls, meta: RunMeta) -> StatedErrors:
        """As meta.json states them; the default where it does not, or where the number is below 0."""
        sensor, drive = meta.sensor, meta.drive
        supply = _stated(None if drive is None else drive.supply_error_percent, SUPPLY_ERROR_PERCENT)
        if sensor is None:
            return cls(supply_error_percent=supply)
        angles = sorted(set(sensor.calibration_rad))
        return cls(
            _stated(sensor.linearity_percent, LINEARITY_PERCENT),
            _stated(sensor.full_range_rad, math.nan) or math.nan,
            _stated(sensor.calibration_error_rad, CALIBRATION_ERROR_RAD),
            tuple(angles) if len(angles) > 1 else (),
            supply,
        )

    def linearity_rad(self, travel_rad: float) -> float:
        """Largest error of linearity, rad."""
        full = self.full_range_rad if math.isfinite(self.full_range_rad) else travel_rad
        return 0.01 * self.linearity_percent * full

    def radian_error(self, low_rad: float, high_rad: float) -> float:
        """Standard deviation of the size of a radian over the driven travel, relative.

        Each angle of the calibration is wrong by up to the stated error, uniformly and on its own. Between two of them
        the error is linear. So the best line through it over the travel has a slope that is a sum over the angles.
        """
        angles = np.array(self.calibration_rad or (low_rad, high_rad))
        y = np.linspace(max(low_rad, angles[0]), min(high_rad, angles[-1]), POINTS)
        if not y[-1] > y[0]:
            y = angles  # the travel is beyond the calibration, whose end segments go on
        away = y - y.mean()
        slopes = [float(away @ np.interp(y, angles, one) / (away @ away)) for one in np.eye(angles.size)]
        return self.calibration_error_rad / math.sqrt(3.0) * math.hypot(*slopes)


def _stated(value: float | None, default: float) -> float:
    return default if value is None or value < 0.0 else value


@dataclass(frozen=True)
class ScaleErrors:
    """Standard deviations of a bench's scales, relative.

    volt     of the drive: by the motor supply
    radian   of the position: by the calibration's angles
    second   of the time: by the clock
    """

    volt: float
    radian: float
    second: float

    @classmethod
    def of(cls, stated: Sequence[StatedErrors], low_rad: float, high_rad: float) -> ScaleErrors:
        """Of tests between these positions, each scale as on the worst of the benches ``stated``."""
        return cls(
            max(0.01 * one.supply_error_percent for one in stated) / math.sqrt(3.0),
            max(one.radian_error(low_rad, high_rad) for one in stated),
            CLOCK_ERROR / math.sqrt(3.0),
        )
