"""A departure of a real motor from the plain law, as identification sees it. Each is a row of ``laws``.

A departure is a part of ``rig.model.real_motor`` whose numbers are 0 for the plain motor. Its effect on the recorded
position is linear in its numbers while they are small. What is not linear, a speed or an order, is its ``shape``: it
starts from a few values, and is fitted with the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rig.core.motor_numbers import NUMBERS, PARTS
from rig.identification.thinning import COARSEST_PATH_RAD

LARGEST = 10.0  # size of a law, in its ranges: beyond it no bench is, and a fit loses its way
UNIFORM = math.sqrt(3.0)  # half width of a uniform distribution over its standard deviation
LARGEST_FORCE = 3.0  # of a law over the angle, times the largest drive
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
    delay_s             of the plain motor, s
    tau_s               of the plain motor, s
    full_V              drive at which a pulse never ends, V, where somebody has said it; else the largest of the record
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
    delay_s: float = 0.0
    tau_s: float = 0.0
    full_V: float = 0.0

    @property
    def half_drive_V(self) -> float:
        """Half the largest drive, V: no voltage of a law is larger, whatever the units of the record."""
        return 0.5 * self.largest_V


Start = Mapping[str, float]


def one_from_nothing(bench: Bench) -> Sequence[Start]:
    """Begin at 0, with no shape."""
    return (NOTHING,)


@dataclass(frozen=True, eq=False)
class Departure:
    """One law that a real motor may have beyond tau, K and Coulomb friction.

    name             in results, and in the table of the motor's numbers
    title            in sentences
    cause            what it may come from, as a question to the user
    range_of         largest size that a bench may well have without anybody knowing, in ``unit``, > 0
    told_by          what to record to tell it from laws that look alike
    trials           starts of ``shape``, and of ``numbers`` where the motion has no derivative at 0; at least one
    limits           bounds of its fields in a fit, beside 0 and up for a law of one side
    sizes            sizes up to ``range_of`` to be looked at one by one, where the motion is not linear in a law of one
                     number; none: it is nearly linear
    untold           largest size that a bench may have, where the tests do not even tell one of ``range_of``
    shown            on which benches it can be looked for, beside ``over_position``
    largest          largest size that a fit may give it; None: see ``most``
    leaps            whether the motion leaps where its one number grows: no derivative shows its size
    valley           whether tau, K and friction make up for its one number along a valley that is no straight line: a
                     descent that begins beside it goes down by small steps
    both_ways        whether only a shaft that turns both ways can show it
    beyond           gain that it must bring, beyond Schwarz's criterion
    may_hide         whether it is a line of the budget where the tests neither show nor exclude it
    often            how many times as likely as other laws it is beforehand
    over_position    whether it goes with the angle: such a law needs positions that are angles, finely sampled
    numbers          fields of ``RealMotor`` that are 0 without it; its size is their root sum of squares
    shape            its further fields, fitted with it; they have no effect while ``numbers`` are 0
    held             those that a trial sets, and no fit changes
    unit             of its size
    one_sided        whether its numbers are never below 0
    costs            how many numbers it has in a fit, for Schwarz's criterion
    The last five are those of the table, if they are not given.
    """

    name: str
    title: str
    cause: str
    range_of: Callable[[Bench], float]
    told_by: str = "a relay test of another amplitude"
    trials: Callable[[Bench], Sequence[Start]] = one_from_nothing
    limits: Callable[[Bench], Mapping[str, tuple[float, float]]] = lambda bench: {}
    sizes: Callable[[Bench], Sequence[float]] = lambda bench: ()
    untold: Callable[[Bench], float] = lambda bench: 0.0
    shown: Callable[[Bench], bool] = lambda bench: True
    largest: float | None = None
    leaps: bool = False
    valley: bool = False
    both_ways: bool = False
    beyond: float = 0.0
    may_hide: bool = True
    often: float = 1.0
    over_position: bool = False
    numbers: tuple[str, ...] = ()
    shape: tuple[str, ...] = ()
    unit: str = ""
    one_sided: bool = False
    costs: int = 0
    held: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.numbers:
            of_table = {name: NUMBERS[name] for name in PARTS[self.name]}
            own = [name for name, number in of_table.items() if not number.is_shape]
            object.__setattr__(self, "numbers", tuple(own))
            object.__setattr__(self, "shape", tuple(name for name in of_table if name not in (*own, *self.held)))
            object.__setattr__(self, "unit", of_table[own[0]].unit)
            object.__setattr__(self, "one_sided", all(of_table[name].of_benches == 0.0 for name in own))
        if not self.costs:
            object.__setattr__(self, "costs", len(self.numbers + self.shape))

    @property
    def fields(self) -> tuple[str, ...]:
        """All its fields of ``RealMotor``."""
        return (*self.numbers, *self.shape, *self.held)

    def most(self, bench: Bench) -> float:
        """Largest size that a fit may give it, in ``unit``: a voltage may be as large as the largest drive.

        A force over the angle may be larger: the record may hold a part of the turn in which it is small.
        """
        if self.largest is not None:
            return self.largest
        largest_V = bench.largest_V * (LARGEST_FORCE if self.over_position else 1.0)
        return max(LARGEST * self.range_of(bench), largest_V if self.unit == "V" else 0.0)

    def fits(self, bench: Bench) -> bool:
        """Whether it can be looked for on this bench."""
        return self.shown(bench) and not (self.over_position and bench.path_per_row_rad >= COARSEST_PATH_RAD)
