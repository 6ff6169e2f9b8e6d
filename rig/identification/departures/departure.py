"""A departure of a real motor from the plain law, as identification sees it. Each is one file, and one line in a list.

A departure is a part of ``rig.model.real_motor`` whose numbers are 0 for the plain motor. Its effect on the recorded
position is linear in its numbers while they are small. What is not linear, a speed or an order, is its ``shape``: it
starts from a few values, and is fitted with the rest.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

LARGEST = 10.0  # size of a law, in its ranges: beyond it no bench is, and a fit loses its way
LARGEST_FORCE = 3.0  # of a law over the angle, times the largest drive
COARSEST_PATH_RAD = 1.0  # from one sample to the next: of a law over the angle
NOTHING: Mapping[str, float] = {}


@dataclass(frozen=True)
class Bench:
    """What the ranges of departures are measured in: sizes of one motor and its record.

    K_rad_s_V, fc_V     of the plain motor, (rad/s)/V and V
    largest_V           largest drive of the record, V
    top_rad_s           largest speed, rad/s
    half_travel_rad     half the driven travel, rad
    linearity_rad       largest error of the sensor's linearity, rad, by its data sheet
    path_per_row_rad    mean way from one sample to the next, rad
    small_drives_V      sizes of the drives below a tenth of the largest, V; at most six
    goes_along          whether the drive always pushes the way that the shaft turns, and never rests
    """

    K_rad_s_V: float
    fc_V: float
    largest_V: float
    top_rad_s: float
    half_travel_rad: float
    linearity_rad: float
    path_per_row_rad: float
    small_drives_V: tuple[float, ...] = ()
    goes_along: bool = False

    @property
    def half_drive_V(self) -> float:
        """Half the largest drive, V: no voltage of a law is larger, whatever the units of the record."""
        return 0.5 * self.largest_V


class Departure(ABC):
    """One law that a real motor may have beyond tau, K and Coulomb friction.

    name             in results
    title            in sentences
    cause            what it may come from, as a question to the user
    unit             of its size
    numbers          fields of ``RealMotor`` that are 0 without it; its size is their root sum of squares
    shape            its further fields, fitted with it; they have no effect while ``numbers`` are 0
    one_sided        whether its numbers are never below 0
    over_position    whether it goes with the angle: such a law needs positions that are angles, finely sampled
    leaps            whether the motion leaps where its one number grows: no derivative shows its size
    both_ways        whether only a shaft that turns both ways can show it
    told_by          what to record to tell it from laws that look alike
    may_hide         whether it is a line of the budget where the tests neither show nor exclude it
    """

    name: str
    title: str
    cause: str
    unit: str
    numbers: tuple[str, ...]
    shape: tuple[str, ...] = ()
    one_sided: bool = False
    over_position: bool = False
    leaps: bool = False
    both_ways: bool = False
    told_by: str = "a relay test of another amplitude"
    may_hide: bool = True

    @property
    def costs(self) -> int:
        """How many numbers it has in a fit, for Schwarz's criterion."""
        return len(self.numbers + self.shape)

    @abstractmethod
    def range_of(self, bench: Bench) -> float:
        """Largest size that a bench may well have without anybody knowing, in ``unit``, > 0."""

    def most(self, bench: Bench) -> float:
        """Largest size that a fit may give it, in ``unit``: a voltage may be as large as the largest drive.

        A force over the angle may be larger: the record may hold a part of the turn in which it is small.
        """
        largest_V = bench.largest_V * (LARGEST_FORCE if self.over_position else 1.0)
        return max(LARGEST * self.range_of(bench), largest_V if self.unit == "V" else 0.0)

    def fits(self, bench: Bench) -> bool:
        """Whether it can be looked for on this bench."""
        return not self.over_position or bench.path_per_row_rad < COARSEST_PATH_RAD

    def trials(self, bench: Bench) -> Sequence[Mapping[str, float]]:
        """Starts of ``shape``, and of ``numbers`` where the motion has no derivative at 0. At least one entry."""
        return (NOTHING,)

    def sizes(self, bench: Bench) -> Sequence[float]:
        """Sizes up to ``range_of`` to be looked at one by one, where the motion is not linear in a law of one number.

        Default: none, for the motion is nearly linear in the law.
        """
        return ()

    def limits(self, bench: Bench) -> Mapping[str, tuple[float, float]]:
        """Bounds of its fields in a fit; default: none, or 0 and up for a law of one side."""
        return {}
