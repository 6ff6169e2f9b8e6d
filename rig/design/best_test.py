"""The next test: strokes or a relay, whichever should tell enough sooner, and the search for both (docs/design.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from rig.control.strokes import Stroke
from rig.core.arrays import Array
from rig.design import outlook
from rig.design.planned_test import Design, RelayGains, Strokes

WINDOW_S = 4.0  # of a test from rest, from which the information per second is taken
GRID = 12  # values of each gain
SOFTEST_V = 0.02  # least gain to try, V
OFTEN = 40  # halvings of a time
NEVER_S = 1e4
SHORT_LIST = 6


@dataclass(frozen=True)
class TriedGains:
    """A pair of gains that was simulated: its information per second (5, 5), and how far the shaft goes."""

    gains: RelayGains
    rate: Array
    far: outlook.Outcome

    @property
    def is_inside(self) -> bool:
        """Whether every motor that it may be stays within the room."""
        return self.far.excess <= 0.0


@dataclass(frozen=True)
class GainGrid:
    """All pairs of gains that were tried: ``tried[i][j]`` at h1_V[i] and h2_V[j]; None where a motor could stick."""

    h1_V: Array
    h2_V: Array
    tried: tuple[tuple[TriedGains | None, ...], ...]

    @property
    def inside(self) -> list[TriedGains]:
        """The gains that may be used."""
        return [one for row in self.tried for one in row if one is not None and one.is_inside]


def gain_grid(task: outlook.Task, size: int = GRID, *, anywhere: bool = False) -> GainGrid:
    """Simulate ``size`` by ``size`` pairs of gains; ``anywhere`` as ``rig.design.outlook.outcome`` takes it."""
    belief, room = task.belief, task.room
    hard_V = room.max_speed_rad_s / belief.K_rad_s_V
    corners = belief.fast((0.2 * hard_V, hard_V))
    nominal = [belief.plant(room.static_V)]
    # the relay on the integral alone must move even the motor that may have most friction (theory, Property 3.1)
    least_V = 1.02 * max(p[2] + abs(p[7]) for p in belief.slow(0.2 * hard_V, room.static_V))
    top_V = max(room.max_V - least_V, 2.0 * SOFTEST_V)
    span = np.geomspace(min(SOFTEST_V, 0.1 * top_V), top_V, size)
    h1_V, h2_V = span, least_V + span - span[0]

    def tried(h1: float, h2: float) -> TriedGains | None:
        if h1 + h2 > room.max_V or h1 + h2 < 1.05 * room.static_V:
            return None
        gains = RelayGains(float(h1), float(h2))
        law = outlook.law_of(gains)
        far = outlook.outcome(task, law, nominal, 0)
        if far.excess <= 0.0:
            far = outlook.outcome(task, law, corners, 0, anywhere=anywhere)
        return TriedGains(gains, outlook.information_of(task, law, WINDOW_S) / WINDOW_S, far)

    return GainGrid(h1_V, h2_V, tuple(tuple(tried(h1, h2) for h2 in h2_V) for h1 in h1_V))


def seconds_of(task: outlook.Task, rates: Array) -> Array:
    """How long information must come in at ``rates`` (n, 5, 5) until enough is known, s (n,); inf if it never is."""
    before, wanted = task.before, task.wanted

    def ratio(seconds: Array) -> Array:
        information = before + rates * seconds[:, None, None]
        size = np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-300))
        scaled = information / size[:, :, None] / size[:, None, :]
        good = np.linalg.eigvalsh(scaled)[:, 0] > 1e-11
        found = np.full((len(rates), 3), math.inf)
        if good.any():
            inverse = np.linalg.inv(scaled[good])
            found[good] = np.diagonal(inverse, axis1=1, axis2=2)[:, :3] / size[good, :3] ** 2
        return np.asarray(np.max(np.sqrt(found) / wanted, axis=1))

    low, high = np.full(len(rates), 1e-3), np.full(len(rates), NEVER_S)
    never = ratio(high) > 1.0
    for _ in range(OFTEN):
        middle = np.sqrt(low * high)
        enough = ratio(middle) <= 1.0
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
        if np.max(high / low) < 1.01:
            break
    return np.where(never, math.inf, high)


@dataclass(frozen=True)
class BestGains:
    """The best single pair of gains, and the best two that take turns, with the seconds each needs by simulation.

    ``pair`` is None where only one can be used; its first entry is the harder one.
    """

    single: TriedGains
    single_s: float
    pair: tuple[TriedGains, TriedGains] | None
    pair_s: float


def best_of(task: outlook.Task, grid: GainGrid) -> BestGains | None:
    """The best of a grid's gains, alone and in turn; None where none may be used.

    Information per second, from a test of ``WINDOW_S``, makes a short list of pairs; whole tests decide.
    """
    inside = grid.inside
    if not inside:
        return None
    rates = np.array([one.rate for one in inside])
    single, single_s = _soonest_alone(task, inside)
    couples = list(combinations(range(len(inside)), 2))
    if not couples:
        return BestGains(single, single_s, None, math.inf)
    first, second = np.array(couples).T
    order = np.argsort(seconds_of(task, 0.5 * (rates[first] + rates[second])))[:SHORT_LIST]
    pairs = [(inside[first[k]], inside[second[k]]) for k in order]
    pairs_s = [outlook.told_in_turn(task, [outlook.law_of(one.gains) for one in pair]) for pair in pairs]
    hard, soft = sorted(pairs[int(np.argmin(pairs_s))], key=lambda one: -one.gains.h1_V - one.gains.h2_V)
    return BestGains(single, single_s, (hard, soft), min(pairs_s))


def _soonest_alone(task: outlook.Task, gains: Sequence[TriedGains]) -> tuple[TriedGains, float]:
    """Of several gains those that tell enough soonest, and their seconds."""
    seconds = [outlook.told(task, outlook.law_of(one.gains)).seconds for one in gains]
    best = int(np.argmin(seconds))
    return gains[best], seconds[best]


def best_gains(task: outlook.Task) -> Design | None:
    """The relay test to drive next: the best one alone, or the first of two if these tell enough sooner; None if none.

    The seconds are those of the whole: of both in turn, where that is better. It may begin wherever another test turns.
    Deterministic.
    """
    found = best_of(task, gain_grid(task, anywhere=True))
    if found is None or not math.isfinite(min(found.single_s, found.pair_s)):
        return None
    one, seconds = found.single, found.single_s
    if found.pair is not None and found.pair_s < found.single_s:
        seconds = found.pair_s
        one, _ = _soonest_alone(task, found.pair)  # of both, the one that tells more by itself
    return Design(one.gains, seconds, task.wanted_percent, one.far.reach)


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
    def __init__(self, task: outlook.Task) -> None:
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
        law = outlook.law_of(self.strokes(plan))
        far = outlook.outcome(self.task, law, self.nominal, STROKES)
        if far.excess > 0.0:
            return 10.0 * TOO_FAR_S * (1.0 + far.excess)
        seconds = outlook.told_either_way(self.task, law, min(outlook.LONGEST_S, best + 0.2), best).seconds
        if seconds >= best:
            return seconds
        # beside a plan that keeps within the room it does not matter by how much this one leaves it
        enough = math.inf if best >= TOO_FAR_S else 0.0
        far = outlook.outcome(self.task, law, self.corners, STROKES, anywhere=True, enough=enough)
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


def best_strokes(task: outlook.Task) -> Design | None:
    """The best stroke test that the search finds within the room; None if it finds none. Deterministic."""
    search = _Search(task)
    best, cost = min((search.local_best() for _ in range(STARTS)), key=lambda found: found[1])
    if cost >= TOO_FAR_S:
        return None
    law = outlook.law_of(search.strokes(best))
    far = outlook.outcome(task, law, search.corners, STROKES)
    found = outlook.told_either_way(task, law)
    test = Strokes(search.strokes(best), far.longest_stroke_s)
    return Design(test, found.seconds, task.percent(found.information), far.reach)


Kind = Literal["strokes", "relay"]
KINDS: tuple[Kind, ...] = ("strokes", "relay")


def best_test(task: outlook.Task, kinds: Sequence[Kind] = KINDS) -> Design | None:
    """The test that should tell enough soonest, of these kinds, within the room for every motor that it may be.

    None where there is no such test: too little is known yet, or the room is too small. Deterministic. Strokes take
    about 0.3 s of one core, a relay 0.1 s.
    """
    found = [best_strokes(task) if "strokes" in kinds else None, best_gains(task) if "relay" in kinds else None]
    return min((one for one in found if one is not None), key=lambda one: one.seconds, default=None)
