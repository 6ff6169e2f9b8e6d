"""From raw numbers to physics and back: counts to rad and rad/s, V to drive units."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from rig.core.signals import Limits

# What a bench may be wrong by if nobody states it
LINEARITY_PERCENT = 1.0  # of the sensor's full range: the data sheet of a plain potentiometer
CALIBRATION_ERROR_RAD = 0.01  # of each angle: a printed protractor is good to half a degree
SUPPLY_ERROR_PERCENT = 1.0  # of the motor supply: a hand-held meter

ALL_COUNTS = (-(2**31), 2**31 - 1)  # of an encoder: as hard limits no limits, as rails no rails
NO_TRAVEL_LIMITS = (-math.inf, math.inf)  # rad


class Calibration:
    """Position sensor: counts to rad through two points or a table, linear in between.

    Beyond the first and the last point the end segments go on, straight.
    """

    def __init__(self, points: Iterable[tuple[float, float]]) -> None:
        """``points`` are (counts, rad) in any order, at least two.

        Raises ValueError if positions do not strictly rise, or strictly fall, with counts.
        """
        table = sorted(points)
        if len(table) < 2:
            raise ValueError(f"a calibration needs at least two points, not {len(table)}")
        if not all(math.isfinite(number) for point in table for number in point):
            raise ValueError("a calibration's numbers must be finite")
        rising = table[-1][1] > table[0][1]
        for (c0, r0), (c1, r1) in pairwise(table):
            if c0 == c1:
                raise ValueError(f"calibration: {c0:g} counts are given twice ({r0:g} and {r1:g} rad)")
            if r0 == r1 or (r1 > r0) != rising:
                raise ValueError(
                    "calibration: positions must only rise or only fall with counts, but from "
                    f"{c0:g} to {c1:g} counts they go from {r0:g} to {r1:g} rad, over the whole table "
                    f"from {table[0][1]:g} to {table[-1][1]:g} rad"
                )
        self.points = tuple(table)
        self.direction = 1 if rising else -1  # of position with counts
        self._counts = [c for c, _ in table]
        self._inner = self._counts[1:-1]
        inverse = sorted((r, c) for c, r in table)
        self._inverse_inner = [r for r, _ in inverse][1:-1]
        self._segments = [_line(*pair) for pair in pairwise(table)]
        self._inverse_segments = [_line(*pair) for pair in pairwise(inverse)]

    def to_rad(self, counts: float) -> float:
        """Position at a reading of ``counts``, rad."""
        c0, r0, slope = self._segments[bisect_right(self._inner, counts)]
        return r0 + (counts - c0) * slope

    def to_counts(self, y_rad: float) -> float:
        """Reading at a position, counts, not rounded."""
        r0, c0, slope = self._inverse_segments[bisect_right(self._inverse_inner, y_rad)]
        return c0 + (y_rad - r0) * slope

    @property
    def lsb_rad(self) -> float:
        """Mean size of one count over the table, rad, > 0."""
        (c0, r0), (c1, r1) = self.points[0], self.points[-1]
        return abs((r1 - r0) / (c1 - c0))


def _line(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float, float]:
    """A segment as start and slope."""
    return a[0], a[1], (b[1] - a[1]) / (b[0] - a[0])


@dataclass(frozen=True)
class TachometerScale:
    """Velocity channel on the motor's side of the gear.

    rad_s_per_count  motor velocity for one count, sign included
    zero_counts      reading at rest
    gear_ratio       motor velocity over shaft velocity, > 0
    """

    rad_s_per_count: float
    zero_counts: float = 0.0
    gear_ratio: float = 1.0

    def to_rad_per_s(self, counts: float) -> float:
        """Velocity of the measured shaft at a reading of ``counts``, rad/s."""
        return (counts - self.zero_counts) * self.rad_s_per_count / self.gear_ratio


@dataclass(frozen=True)
class DriveMap:
    """H-bridge: V at the motor to signed drive units (PWM counts) and back.

    supply_V                        motor supply, > 0
    bridge_drop_V                   lost in the bridge while it conducts, V, >= 0, < supply_V
    dead_band_plus, dead_band_minus duty up to which the bridge passes nothing, for positive and for
                                    negative units, in [0, 1)
    reversed                        positive units turn the shaft to falling positions
    full_units                      units at full duty, > 0

    At full duty the motor gets ``full_V`` = supply_V - bridge_drop_V; from the edge of the dead band to
    there, the mean voltage is linear in duty (slow decay):  |u| = full_V (duty - dead) / (1 - dead).
    0 V is 0 units. Raises ValueError outside these ranges.
    """

    supply_V: float
    bridge_drop_V: float = 0.0
    dead_band_plus: float = 0.0
    dead_band_minus: float = 0.0
    reversed: bool = False
    full_units: int = 799

    def __post_init__(self) -> None:
        if not (math.isfinite(self.supply_V) and 0.0 <= self.bridge_drop_V < self.supply_V):
            raise ValueError("the bridge must drop at least 0 V and less than a finite supply")
        if not (0.0 <= self.dead_band_plus < 1.0 and 0.0 <= self.dead_band_minus < 1.0):
            raise ValueError("dead bands are duties in [0, 1)")
        if self.full_units <= 0:
            raise ValueError("full_units must be > 0")

    @cached_property  # asked for in every tick
    def full_V(self) -> float:
        """Largest drive that the bridge can give, V."""
        return self.supply_V - self.bridge_drop_V

    @cached_property
    def sign(self) -> int:
        """Sign of the units of a positive voltage."""
        return -1 if self.reversed else 1

    def to_units(self, u_V: float) -> int:
        """Drive units nearest to ``u_V``; raises ValueError beyond +-full_V, or if not finite.

        The bridge then drives ``to_volts`` of the result: at most half a unit away.
        """
        size = abs(u_V)
        if not size <= self.full_V:
            raise ValueError(f"drive {u_V:g} V is beyond the +-{self.full_V:g} V that supply and bridge can give")
        if size == 0.0:
            return 0
        sign = self.sign if u_V > 0.0 else -self.sign
        dead = self.dead_band_plus if sign > 0 else self.dead_band_minus
        return sign * round(self.full_units * (dead + (1.0 - dead) * size / self.full_V))

    def to_volts(self, units: int) -> float:
        """Mean voltage at the motor of a number of units, V; 0 inside the dead band.

        The inverse of ``to_units`` outside the dead band. Raises ValueError beyond +-full_units.
        """
        size = abs(units)
        if size > self.full_units:
            raise ValueError(f"drive {units} is beyond the full duty of {self.full_units} units")
        dead = self.dead_band_plus if units > 0 else self.dead_band_minus
        effective = (size / self.full_units - dead) / (1.0 - dead)
        if size == 0 or effective <= 0.0:
            return 0.0
        return self.full_V * effective * (self.sign if units > 0 else -self.sign)

    def quantised(self, u_V: float) -> float:
        """The voltage that the device applies for a command of ``u_V``, V. Raises ValueError as ``to_units``."""
        return self.to_volts(self.to_units(u_V))


@dataclass(frozen=True)
class Scaling:
    """What the raw numbers of a device mean.

    calibration  readings of the position sensor, counts, to rad
    drive_map    V at the motor to units of the drive
    rail_counts  (low, high): readings at or beyond are a broken sensor; ALL_COUNTS of an encoder
    counts_max   largest reading of the converter that the calibration was made for; None: not checked
    tachometer   readings of the velocity channel to rad/s; None: there is none, or it is not used
    """

    calibration: Calibration
    drive_map: DriveMap
    rail_counts: tuple[int, int]
    counts_max: int | None = None
    tachometer: TachometerScale | None = None

    @property
    def is_encoder(self) -> bool:
        """Whether the position is counted by an encoder, from wherever it was switched on."""
        return self.rail_counts == ALL_COUNTS


def hard_limits_in_counts(
    limits: Limits, calibration: Calibration, drive_map: DriveMap, rail_counts: tuple[int, int]
) -> tuple[int, int]:
    """The hard limits as (lowest, highest) reading inside them, counts; ALL_COUNTS without travel limits.

    Raises ValueError for limits that no device can hold with this sensor and this drive: 0 rad outside the hard limits,
    a hard limit that the sensor reads at its rail or beyond, drive beyond supply and bridge.
    """
    low_rad, high_rad = limits.hard_rad
    if limits.hard_rad == NO_TRAVEL_LIMITS and rail_counts == ALL_COUNTS:
        drive_map.to_units(limits.max_u_V)
        return ALL_COUNTS
    if not low_rad < 0.0 < high_rad:
        raise ValueError(f"hard limits {low_rad:g} to {high_rad:g} rad must enclose 0, the centre of travel")
    low, high = sorted((calibration.to_counts(low_rad), calibration.to_counts(high_rad)))
    hard_lo, hard_hi = math.ceil(low - 1e-9), math.floor(high + 1e-9)
    rail_lo, rail_hi = rail_counts
    least = ALL_COUNTS[0] if rail_counts == ALL_COUNTS else 0
    if not least <= rail_lo < hard_lo <= hard_hi < rail_hi:
        raise ValueError(
            f"hard limits {low_rad:g} to {high_rad:g} rad read {low:.1f} to {high:.1f} counts, which must lie "
            f"inside the sensor's rails at {rail_lo} and {rail_hi} counts"
        )
    drive_map.to_units(limits.max_u_V)
    return hard_lo, hard_hi


def largest_drive_in_units(limits: Limits, drive_map: DriveMap) -> int:
    """The largest drive in units, > 0; the larger one of both directions.

    Raises ValueError below one unit, and beyond supply and bridge.
    """
    units = max(abs(drive_map.to_units(sign * limits.max_u_V)) for sign in (1.0, -1.0))
    if units == 0:
        raise ValueError(f"largest drive {limits.max_u_V:g} V is less than one unit of the drive")
    return units


def polarity(calibration: Calibration, drive_map: DriveMap) -> int:
    """+1 if positive drive units raise the position counts, -1 if they lower them."""
    return calibration.direction * drive_map.sign
