"""The plan of a survey: at which speeds the shaft sweeps its travel to and fro (docs/theory.md 13.2).

A sweep goes from one end to the other at a constant speed. A turn takes the same time at every speed: the reference
slows down, reverses and speeds up with a constant acceleration. The faster the sweep, the more of the travel its turns
take; the slower, the longer it lasts, and the fewer counts a second the sensor shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rig.control.trajectory import Reference

SPEEDS = 5
COUNTS_1_S = 10.0  # of the sensor that the slowest sweep passes in a second, at least
BANDWIDTH_DELAYS = 0.09  # of the loop's bandwidth times the time until it reacts
FASTEST_1_S = 12.0
TURN = 4.0  # a turn takes so many time constants of the loop,
SETTLE = 3.0  # and after it the motion settles for so many
EDGE_SHARE = 0.05  # of the travel between the soft limits, kept free at each end
LEAST_RUN = 0.5  # of each sweep is at a steady speed
LEAST_SPREAD = 1.5  # of the largest speed over the smallest one
SPEED_SHARE = 0.5  # of limits.max_speed_rad_s


class TooShortError(ValueError):
    """There is no room or no time for sweeps. The message says what there is, and what there should be."""


def fastest_loop_1_s(reaction_s: float) -> float:
    """Largest bandwidth of the loop, 1/s, if a drive reacts to a motion ``reaction_s`` later."""
    return min(BANDWIDTH_DELAYS / reaction_s, FASTEST_1_S)


@dataclass(frozen=True)
class Room:
    """What there is for the sweeps.

    soft_rad         travel limits (low, high), rad
    max_speed_rad_s  largest speed of the bench, rad/s
    slowest_rad_s    slowest speed that the sensor resolves, rad/s
    bandwidth_1_s    of the loop, 1/s
    longest_s        all sweeps together, s
    """

    soft_rad: tuple[float, float]
    max_speed_rad_s: float
    slowest_rad_s: float
    bandwidth_1_s: float
    longest_s: float


@dataclass(frozen=True)
class SweepPlan:
    """Sweeps to and fro, one pair for each speed, in this order.

    low_rad, high_rad  where the reference turns, rad
    speeds_rad_s       speeds, > 0
    bandwidth_1_s      of the loop, 1/s
    """

    low_rad: float
    high_rad: float
    speeds_rad_s: tuple[float, ...]
    bandwidth_1_s: float

    @property
    def turn_s(self) -> float:
        """Time from a steady speed to rest, or back, s."""
        return TURN / self.bandwidth_1_s

    @property
    def duration_s(self) -> float:
        """All sweeps, without the way to the first one, s."""
        travel = self.high_rad - self.low_rad
        return sum(2.0 * (travel / v + self.turn_s) for v in self.speeds_rad_s)

    def at(self, t_s: float) -> Reference:
        """Reference ``t_s`` after the start at rest at ``low_rad``; after the end at rest there."""
        travel, turn = self.high_rad - self.low_rad, self.turn_s
        for v in self.speeds_rad_s:
            pass_s = travel / v + turn
            for start, way in ((self.low_rad, 1.0), (self.high_rad, -1.0)):
                if t_s < pass_s:
                    y, speed, acceleration = _trapezoid(t_s, v, turn, pass_s)
                    return Reference(start + way * y, way * speed, way * acceleration)
                t_s -= pass_s
        return Reference(self.low_rad, 0.0, 0.0)


def _trapezoid(t: float, v: float, turn: float, pass_s: float) -> tuple[float, float, float]:
    """Way, speed and acceleration ``t`` after a rest, of a motion that is at rest again at ``pass_s``."""
    a = v / turn
    if t < turn:
        return 0.5 * a * t * t, a * t, a
    if t <= pass_s - turn:
        return v * (t - 0.5 * turn), v, 0.0
    left = pass_s - t
    return v * (pass_s - turn) - 0.5 * a * left * left, a * left, -a


def sweep_plan(room: Room, wanted_rad_s: Sequence[float] = ()) -> SweepPlan:
    """The sweeps for this room: at the wanted speeds, else at five from the slowest to the fastest.

    Raises TooShortError if the room is too small for them, or the time too short.
    """
    low, high = room.soft_rad
    if not math.isfinite(high - low):
        raise TooShortError("a survey sweeps between two travel limits, and there are none")
    edge = EDGE_SHARE * (high - low)
    low, high = low + edge, high - edge
    travel, bandwidth = high - low, room.bandwidth_1_s
    by_travel = 0.5 * (1.0 - LEAST_RUN) * travel * bandwidth / (0.5 * TURN + SETTLE)
    fastest = min(by_travel, SPEED_SHARE * room.max_speed_rad_s)
    slowest = room.slowest_rad_s
    if wanted_rad_s:
        plan = SweepPlan(low, high, tuple(sorted(wanted_rad_s, reverse=True)), bandwidth)
        if max(wanted_rad_s) > fastest * (1.0 + 1e-9):
            raise TooShortError(f"{max(wanted_rad_s):g} rad/s is too fast for {_words(travel, fastest)}")
        if min(wanted_rad_s) < slowest * (1.0 - 1e-9):
            raise TooShortError(
                f"{min(wanted_rad_s):g} rad/s is too slow for counts and noise of the sensor: at least {slowest:.3g}"
            )
        if plan.duration_s > room.longest_s:
            raise TooShortError(f"these sweeps take {plan.duration_s:.0f} s, longer than {room.longest_s:g} s")
        return plan
    if fastest < LEAST_SPREAD * slowest:
        raise TooShortError(
            f"the slowest sweep that the sensor resolves is at {slowest:.3g} rad/s, and the fastest for "
            f"{_words(travel, fastest)}; it should be {LEAST_SPREAD:g} times as fast"
        )
    for share in range(101):  # the slowest speed for which there is time
        least = slowest * (fastest / LEAST_SPREAD / slowest) ** (0.01 * share)
        plan = SweepPlan(low, high, _spread(fastest, least), bandwidth)
        if plan.duration_s <= room.longest_s:
            return plan
    raise TooShortError(
        f"sweeps over {travel:.3g} rad take at least {math.ceil(plan.duration_s)} s, longer than {room.longest_s:g} s"
    )


def _spread(fastest: float, slowest: float) -> tuple[float, ...]:
    """Speeds with equal ratios, the fastest first."""
    return tuple(fastest * (slowest / fastest) ** (k / (SPEEDS - 1)) for k in range(SPEEDS))


def _words(travel: float, fastest: float) -> str:
    return f"a travel of {travel:.3g} rad: at most {fastest:.3g} rad/s"
