"""The relay gains that tell most per second: one pair of gains, or a hard and a soft pair in turn (docs/design.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rig.design.outlook import Outcome, Task, information_of, law_of, outcome, told, told_in_turn
from rig.design.planned_test import Design, RelayGains

Array = NDArray[np.float64]

WINDOW_S = 4.0  # of a test from rest, from which the information per second is taken
GRID = 12  # values of each gain
SOFTEST_V = 0.02  # least gain to try, V
OFTEN = 40  # halvings of a time
LONGEST_S = 1e4
SHORT_LIST = 6


@dataclass(frozen=True)
class TriedGains:
    """A pair of gains that was simulated: its information per second (5, 5), and how far the shaft goes."""

    gains: RelayGains
    rate: Array
    far: Outcome

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


def gain_grid(task: Task, size: int = GRID, *, anywhere: bool = False) -> GainGrid:
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
        law = law_of(gains)
        far = outcome(task, law, nominal, 0)
        if far.excess <= 0.0:
            far = outcome(task, law, corners, 0, anywhere=anywhere)
        return TriedGains(gains, information_of(task, law, WINDOW_S) / WINDOW_S, far)

    return GainGrid(h1_V, h2_V, tuple(tuple(tried(h1, h2) for h2 in h2_V) for h1 in h1_V))


def seconds_of(task: Task, rates: Array) -> Array:
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

    low, high = np.full(len(rates), 1e-3), np.full(len(rates), LONGEST_S)
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


def best_of(task: Task, grid: GainGrid) -> BestGains | None:
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
    pairs_s = [told_in_turn(task, [law_of(one.gains) for one in pair]) for pair in pairs]
    hard, soft = sorted(pairs[int(np.argmin(pairs_s))], key=lambda one: -one.gains.h1_V - one.gains.h2_V)
    return BestGains(single, single_s, (hard, soft), min(pairs_s))


def _soonest_alone(task: Task, gains: Sequence[TriedGains]) -> tuple[TriedGains, float]:
    """Of several gains those that tell enough soonest, and their seconds."""
    seconds = [told(task, law_of(one.gains)).seconds for one in gains]
    best = int(np.argmin(seconds))
    return gains[best], seconds[best]


def best_gains(task: Task) -> Design | None:
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
