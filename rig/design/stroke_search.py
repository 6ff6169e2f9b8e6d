"""The strokes that tell most per second: a search over their levels and turning points (docs/design.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.control.strokes import Stroke
from rig.design.outlook import LONGEST_S, Task, law_of, outcome, told_either_way
from rig.design.planned_test import Design, Strokes

Array = NDArray[np.float64]

STROKES = 6  # in a plan, an even number
STARTS = 4  # searches from different beginnings; the best counts
FIRST = 80  # plans at random, the best of which a search begins with
STEPS = 300  # changes of one stroke that it tries
SLOWEST_RAD_S = 0.5  # final speed of the softest stroke to try
FASTEST = 3.0  # times the largest speed: final speed of the hardest, which is ended long before
TOO_FAR_S = 1e4  # cost of a plan that leaves the room
THROUGH = 0.1  # of the reach: the first two strokes turn beyond that
FULL = 0.98  # of the room that turning points may use
SEED = 1


@dataclass(frozen=True)
class _Plan:
    """Strokes as the search varies them: log of the final speed, rad/s; turning points in its direction, rad."""

    log_speed: Array
    turn_rad: Array


class _Search:
    def __init__(self, task: Task) -> None:
        self.task = task
        belief, room = task.belief, task.room
        self.nominal = [belief.plant(room.static_V)]
        hard_V = room.max_speed_rad_s / belief.K_rad_s_V
        slow = belief.slow(0.2 * hard_V, room.static_V)
        self.corners = belief.fast((0.2 * hard_V, hard_V)) + slow
        self.sign = np.where(np.arange(STROKES) % 2 == 0, 1.0, -1.0)
        # friction of the direction, and a drive that moves even the motor that may have most of it
        self.friction_V = belief.fc_V - self.sign * belief.asym_V
        self.least_V = np.maximum(1.05 * room.static_V, [max(p[2] - s * p[7] for p in slow) for s in self.sign])
        low = np.maximum(SLOWEST_RAD_S, belief.K_rad_s_V * (self.least_V - self.friction_V))
        high = np.minimum(belief.K_rad_s_V * (room.max_V - self.friction_V), FASTEST * room.max_speed_rad_s)
        self.low, self.high = np.log(low), np.log(np.maximum(high, 1.01 * low))
        self.reach = np.where(self.sign > 0.0, room.high_rad, -room.low_rad) * FULL
        # whichever of the first two begins, inward, goes through the centre: no test begins with a stroke that is over
        self.least_turn = np.where(np.arange(STROKES) < 2, THROUGH * self.reach, -math.inf)
        self.rng = np.random.default_rng(SEED)

    def strokes(self, plan: _Plan) -> tuple[Stroke, ...]:
        b = self.task.belief
        level = np.clip(self.friction_V + np.exp(plan.log_speed) / b.K_rad_s_V, self.least_V, self.task.room.max_V)
        return tuple(
            Stroke(float(s * u), float(s * t)) for s, u, t in zip(self.sign, level, plan.turn_rad, strict=True)
        )

    def random(self) -> _Plan:
        """Strokes that turn early where they are fast."""
        log_speed = self.rng.uniform(self.low, self.high)
        tau_s = self.task.belief.tau_s
        gone = (
            np.minimum(np.exp(log_speed), self.task.room.max_speed_rad_s) * tau_s * self.rng.uniform(0.0, 1.5, STROKES)
        )
        turn = np.clip(self.reach * self.rng.uniform(0.3, 1.0, STROKES) - gone, -0.5 * self.reach, self.reach)
        return _Plan(log_speed, self.apart(turn))

    def apart(self, turn_rad: Array) -> Array:
        """Turning points so far apart that each stroke is one for certain, whatever the noise at its begin.

        A stroke begins where the one before has passed its turning point, or beyond.
        """
        least = self.task.least_swing_rad
        for i in range(STROKES):
            turn_rad[i] = min(max(turn_rad[i], self.least_turn[i], least - turn_rad[i - 1]), self.reach[i])
        turn_rad[0] = max(turn_rad[0], least - turn_rad[-1])
        return turn_rad

    def changed(self, plan: _Plan, size: float) -> _Plan:
        log_speed, turn = plan.log_speed.copy(), plan.turn_rad.copy()
        i = int(self.rng.integers(STROKES))
        if self.rng.uniform() < 0.5:
            log_speed[i] = np.clip(log_speed[i] + 0.5 * size * self.rng.standard_normal(), self.low[i], self.high[i])
        else:
            turn[i] = np.clip(
                turn[i] + 0.25 * size * self.reach[i] * self.rng.standard_normal(),
                max(self.least_turn[i], self.task.least_swing_rad - min(turn[i - 1], turn[(i + 1) % STROKES])),
                self.reach[i],
            )
        return _Plan(log_speed, turn)

    def cost(self, plan: _Plan, best: float) -> float:
        """Expected seconds; ``TOO_FAR_S`` and more if the shaft could go too far, by how far it would."""
        law = law_of(self.strokes(plan))
        far = outcome(self.task, law, self.nominal, STROKES)
        if far.excess > 0.0:
            return 10.0 * TOO_FAR_S * (1.0 + far.excess)
        seconds = told_either_way(self.task, law, min(LONGEST_S, best + 0.2), best).seconds
        if seconds >= best:
            return seconds
        # beside a plan that keeps within the room it does not matter by how much this one leaves it
        enough = math.inf if best >= TOO_FAR_S else 0.0
        far = outcome(self.task, law, self.corners, STROKES, anywhere=True, enough=enough)
        return TOO_FAR_S * (1.0 + far.excess) if far.excess > 0.0 else seconds

    def local_best(self) -> tuple[_Plan, float]:
        """The best plan of one search, and its cost."""
        best, best_cost = self.random(), math.inf
        for k in range(FIRST + STEPS):
            plan = self.random() if k < FIRST else self.changed(best, 1.0 if k < FIRST + STEPS // 2 else 0.4)
            cost = self.cost(plan, best_cost)
            if cost < best_cost:
                best, best_cost = plan, cost
        return best, best_cost


def best_strokes(task: Task) -> Design | None:
    """The best stroke test that the search finds within the room; None if it finds none. Deterministic."""
    search = _Search(task)
    best, cost = min((search.local_best() for _ in range(STARTS)), key=lambda found: found[1])
    if cost >= TOO_FAR_S:
        return None
    law = law_of(search.strokes(best))
    far = outcome(task, law, search.corners, STROKES)
    found = told_either_way(task, law)
    test = Strokes(search.strokes(best), far.longest_stroke_s)
    return Design(test, found.seconds, task.percent(found.information), far.reach)
