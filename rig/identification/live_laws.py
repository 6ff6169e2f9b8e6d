"""The laws that the rows of a run show while it goes on, for the live fit (docs/theory.md 7.12)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rig.identification.departures import DEPARTURES
from rig.identification.departures.choice import Chooser
from rig.identification.departures.departure import Bench, Departure
from rig.identification.departures.fit import CORE, DELAY
from rig.identification.departures.pieces import Cut
from rig.identification.stated_errors import StatedErrors
from rig.model.real_motor import Frame, RealMotor
from rig.run_folder.recording.series import TimeSeries


@dataclass(frozen=True)
class LawsSoFar:
    """Laws that the rows show, none to four, and what a fit with them begins with.

    laws    the laws
    motor   the motor that has them
    bench   sizes that their ranges are measured in
    frame   the middle of the travel and half of it, which laws over the angle refer to
    """

    laws: tuple[Departure, ...]
    motor: RealMotor
    bench: Bench
    frame: Frame


def laws_so_far(
    series: Sequence[TimeSeries],
    motor: RealMotor,
    cycle_s: float,
    sigma_rad: float,
    delay_s: tuple[float, float] | None,
    stated: StatedErrors,
) -> LawsSoFar:
    """Choose laws for the rows so far, as `rig identify` does when the run is over.

    series     the rows between gaps of the record
    motor      the plain motor that the live fit has found
    cycle_s    mean length of a swing to and fro, s
    sigma_rad  standard deviation of a moving reading's noise, rad
    delay_s    bounds of a delay that is fitted, s; None: the rows say when each drive acted
    stated     what is known of the bench
    """
    whole = Cut.whole(series, delay_s[1] if delay_s is not None else 0.0)
    travel_rad = 2.0 * whole.frames[0].half_travel_rad
    bench = whole.every(0.5 * cycle_s).bench(motor, stated.linearity_rad(travel_rad))
    candidates = [law for law in DEPARTURES if law.fits(bench)]
    core = CORE if delay_s is None else (*CORE, DELAY)
    chooser = Chooser(candidates, bench, core, delay_s or (0.0, 0.0), sigma_rad)
    choice = chooser.choose(whole, motor, cycle_s)
    return LawsSoFar(choice.laws, choice.fit.motor, bench, whole.frames[0])
