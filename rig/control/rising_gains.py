"""A start without model and target: the relay's gains grow until the shaft swings widely (docs/theory.md 4.5)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rig.control.excitation import RelayLaw, SearchStep
from rig.control.motion import Swings
from rig.control.relay import DualChannelRelay
from rig.core.signals import Sample
from rig.model.cycle_detector import CycleDetector


@dataclass(frozen=True)
class SwingRoom:
    """What the rising gains may use.

    friction_V       breakaway level, mean of both directions, V, > 0
    reach_rad        largest |y|: a little inside the soft limit
    top_speed_rad_s  largest speed
    h_max_V          largest h1 and largest h2
    sum_max_V        largest h1 + h2
    motion_rad       a reading that stays within this span shows a shaft that sticks
    first_sum_V      h1 + h2 to begin with; nan: ``FIRST`` times friction_V
    """

    friction_V: float
    reach_rad: float
    top_speed_rad_s: float
    h_max_V: float
    sum_max_V: float
    motion_rad: float
    first_sum_V: float = math.nan


class RisingGains(RelayLaw[DualChannelRelay]):
    """Raise the relay's gains from the breakaway level until the shaft swings widely; then change between two sizes.

    With x = h2 - f, f the breakaway level, the cycle has A ~ x^2/h1 and T ~ x/h1 (docs/theory.md 4.2). So x grows by
    the factor ``GROWTH`` at each turning point, or after a time without one, until the swing has ``WIDE`` of the
    reach or ``FAST`` of the largest speed. Where the shaft would leave the reach or gets too fast, x goes back, and f
    after it. From then on a wide and a small cycle take turns, ``TURNS`` turning points
    each: two sizes tell a drag from another K, should nobody decide to end this law.

    It never finishes by itself, and never gives up: ``rig.running.experiment.until`` ends it.
    """

    START = 0.15  # of the breakaway level: first x
    GROWTH = 1.4
    STICKS_S = 0.4
    TREMBLES_S = 1.2  # a slow motor may need that to its first turning point
    WIDE = 0.4
    FAST = 0.6
    TOO_FAST = 0.82  # of the largest speed: a light motor gains the rest until its speed is seen
    SMALL = 0.6  # of x, in the small cycle
    TURNS = 12
    RETREAT = 0.6
    LEAST = 0.1  # of the breakaway level: where an x below it is too much, that level was shown too high
    LOWER, HIGHER = 0.75, 1.1  # of the breakaway level then, and of one that was lowered too far
    AHEAD_S = 0.06  # the shaft still goes on for about that long after the relay has turned

    def __init__(self, relay: DualChannelRelay, detector: CycleDetector, room: SwingRoom) -> None:
        super().__init__(relay, detector)
        self.room = room
        self.steps: list[SearchStep] = []  # the gains that are over, and why they ended
        self._swings = Swings(detector.min_amplitude_rad)
        self._friction_V = room.friction_V if math.isnan(room.first_sum_V) else room.first_sum_V / FIRST
        self._x_V = self.START * self._friction_V
        self._widest_V = math.inf  # the x that was too much
        self._wide = False
        self._small = False
        self._retreated = False  # the last change was one
        self._changed_s = math.nan
        self._changed_at = 0  # turning points at that time
        self._peak_rad_s = 0.0  # since then
        self._span_rad = (math.inf, -math.inf)  # of the readings since then
        self._was_within = False

    def step(self, sample: Sample) -> float:
        """Drive of the relay at this sample, V; changes its gains as the shaft swings."""
        if math.isnan(self._changed_s):
            self._set(sample.t_s)
        u_V, _ = self._run_relay(sample)
        turned = self._swings.step(sample.y_rad)
        self._peak_rad_s = max(self._peak_rad_s, abs(self.speed_rad_s))
        self._span_rad = min(self._span_rad[0], sample.y_rad), max(self._span_rad[1], sample.y_rad)
        was_within, self._was_within = self._was_within, self._goes_to_rad(sample.y_rad) <= self.room.reach_rad
        turns = self._swings.count - self._changed_at
        if (was_within and not self._was_within) or (abs(self.speed_rad_s) > self.TOO_FAST * self.room.top_speed_rad_s):
            # once for each swing: the last change needs one to take effect
            if turns >= 1 or not self._retreated:
                self._retreat(sample.t_s)
        elif self._wide:
            if turns >= self.TURNS:
                self._small = not self._small
                self._change(sample.t_s, "now a small cycle" if self._small else "now a wide cycle")
            elif self._friction_V < self.room.friction_V and sample.t_s - self._changed_s > self.TREMBLES_S * (
                turns + 1
            ):
                self._friction_V = min(self.HIGHER * self._friction_V, self.room.friction_V)
                self._change(sample.t_s, "hardly swings")
        elif turned and turns >= 1:
            self._grow(sample.t_s)
        elif turns == 0 and sample.t_s - self._changed_s > (self.STICKS_S if self._sticks else self.TREMBLES_S):
            if self._sticks:
                self.relay.restart()  # the integral meanwhile means nothing
            self._grow(sample.t_s)
        return u_V

    def _goes_to_rad(self, y_rad: float) -> float:
        """How far from the middle the shaft will be before it can turn, rad."""
        return max(abs(y_rad), abs(y_rad + self.AHEAD_S * self.speed_rad_s))

    @property
    def _sticks(self) -> bool:
        """Whether the shaft has not moved since the last change."""
        return self._span_rad[1] - self._span_rad[0] < self.room.motion_rad

    def _grow(self, t_s: float) -> None:
        half_rad = self._swings.half_way_rad
        swings = self._swings.count >= 2
        if swings and (
            half_rad >= self.WIDE * self.room.reach_rad or self._peak_rad_s >= self.FAST * self.room.top_speed_rad_s
        ):
            self._wide = True
            self._changed_at = self._swings.count
            return
        largest_V = self._largest_x_V()
        if self._x_V >= largest_V:
            self._wide = swings
            return
        self._x_V, self._retreated = min(self._x_V * self.GROWTH, largest_V), False
        self._change(t_s, f"swings by {half_rad:.2f} rad" if swings else "no swing")

    def _largest_x_V(self) -> float:
        """Largest x within the drive's range, and below one that was too much, V."""
        room = self.room
        within_sum_V = (room.sum_max_V - self._friction_V) / (1.0 + _H1_SHARE)
        return min(within_sum_V, room.h_max_V - self._friction_V, 0.9 * self._widest_V)

    def _retreat(self, t_s: float) -> None:
        self._widest_V = min(self._widest_V, self._x_V)
        self._x_V *= self.RETREAT
        if self._x_V < self.LEAST * self._friction_V:
            # short strokes show a fast motor's friction too high: x alone would never come down to it
            self._friction_V *= self.LOWER
        self._wide = self._retreated = True
        self.relay.restart()  # both relays inward
        self._change(t_s, "too wide or too fast")

    def _change(self, t_s: float, why: str) -> None:
        """Go over to the gains of the present x; ``why`` those before are over."""
        self.steps.append(SearchStep(t_s, self.relay.h1_V, self.relay.h2_V, math.nan, math.nan, why))
        self._set(t_s)

    def _set(self, t_s: float) -> None:
        x_V = self._x_V * (self.SMALL if self._small else 1.0)
        friction_V = self._friction_V
        h1_V, h2_V = max(_H1_LEAST * friction_V, _H1_SHARE * x_V), friction_V + x_V
        scale = min(1.0, self.room.sum_max_V / (h1_V + h2_V))
        self.relay.h1_V, self.relay.h2_V = h1_V * scale, h2_V * scale
        self._changed_s, self._changed_at, self._peak_rad_s = t_s, self._swings.count, 0.0
        self._span_rad = (math.inf, -math.inf)


_H1_SHARE = 0.6  # of x: then T ~ 10 tau
_H1_LEAST = 0.4  # of the breakaway level: below, the position's relay would hardly brake
FIRST = 1.0 + RisingGains.START + _H1_LEAST  # of the breakaway level: first h1 + h2
