"""A departure of a real motor from the plain law, as identification sees it. Each is one file, and one line in a list.

A departure is a part of ``rig.model.real_step.RealMotor`` whose numbers are 0 for the plain motor. Its effect on the
recorded position is linear in its numbers while they are small. What is not linear, a speed or an order, is its
``shape``: it starts from a few values, and is fitted with the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

NOTHING: Mapping[str, float] = {}


@dataclass(frozen=True)
class Bench:
    """What the prior ranges of departures are measured in: sizes of one motor and its record.

    K_rad_s_V, fc_V     of the plain motor, (rad/s)/V and V
    largest_V           largest drive of the record, V
    top_rad_s           largest speed, rad/s
    half_travel_rad     half the driven travel, rad
    linearity_rad       largest error of the sensor's linearity, rad, by its data sheet
    """

    K_rad_s_V: float
    fc_V: float
    largest_V: float
    top_rad_s: float
    half_travel_rad: float
    linearity_rad: float


@dataclass(frozen=True)
class Departure:
    """One law that a real motor may have beyond tau, K and Coulomb friction.

    name            in results and configs
    title           in sentences
    cause           what it may come from, as a question to the user
    unit            of its size
    numbers         fields of ``RealMotor`` that are 0 without it
    shape           its further fields, which are fitted with it but have no effect while ``numbers`` are 0
    one_sided       whether its numbers are never below 0
    confounded_with laws and parameters that look nearly alike in a relay test
    told_by         what to record to tell it from these
    """

    name: str
    title: str
    cause: str
    unit: str
    numbers: tuple[str, ...]
    shape: tuple[str, ...] = ()
    one_sided: bool = False
    confounded_with: tuple[str, ...] = ()
    told_by: str = "a relay test of another amplitude"
    _: None = field(default=None, repr=False)

    def range_of(self, bench: Bench) -> float:
        """Largest size of each of ``numbers`` that a bench may well have without anybody knowing. Always > 0."""
        raise NotImplementedError

    def trials(self, bench: Bench) -> list[Mapping[str, float]]:
        """Starts of ``shape``, and of ``numbers`` where no derivative at 0 is known. One empty entry if none is needed."""
        return [NOTHING]

    def limits(self, bench: Bench) -> Mapping[str, tuple[float, float]]:
        """Bounds of ``shape`` in a fit."""
        return {}
