"""What a planned test is expected to do, by exact simulation: how soon it tells enough, and how far the shaft goes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from rig.control.strokes import Stroke
from rig.core.arrays import Array
from rig.design import compiled
from rig.design.belief import NORMAL_95, Belief
from rig.design.planned_test import Reach, Reading, RelayGains, Room
from rig.model.step import State

AT_REST = State()
LOOKED_S = 0.1  # between two looks at the information
LONGEST_S = 8.0  # of a test; beyond it information is taken to grow as it did until then
CORNER_S = 12.0  # of the simulation of a possible motor
PASSES = 2  # of all strokes, by which a motor shows how far it goes
LEAST_SWING = 16.0  # standard deviations of the reading: tiny swings agree with any law, and tell of none
KNOWN = 1e12  # information on a delay that is known, 1/s^2


class Told(NamedTuple):
    """When a test tells enough, s; and the information (5, 5) a moment later, with what was there before."""

    seconds: float
    information: Array


@dataclass(frozen=True)
class Task:
    """What a test is for.

    belief    the motor as far as it is known
    seen      (5, 5): the information on log tau, log K, fc, asym and delay that is there before the test
    room, reading   the bench
    wanted_percent  half width of the 95 % intervals of tau, K and f_c, %, > 0
    start     state of the shaft at the test's first sample
    """

    belief: Belief
    seen: Array
    room: Room
    reading: Reading
    wanted_percent: float
    start: State = AT_REST

    @property
    def delay_s(self) -> float:
        """From a sample until its drive acts, as far as it is known, s."""
        return max(self.reading.latency_s + self.belief.delay_s, 0.0)

    @property
    def least_swing_rad(self) -> float:
        """The least that a swing must go to and fro, rad."""
        return LEAST_SWING * math.sqrt(self.reading.noise_rad2)

    @property
    def wanted(self) -> Array:
        """(3,): standard deviations of log tau, log K and fc that the wanted intervals have."""
        share = self.wanted_percent / 100.0 / NORMAL_95
        return np.array([share, share, share * self.belief.fc_V])

    @property
    def before(self) -> Array:
        """``seen``; what is known of a known delay is in it."""
        before = np.array(self.seen, dtype=float)
        if self.belief.delay_is_known:
            before[4, 4] += KNOWN
        return before

    def percent(self, information: Array) -> float:
        """The largest half width of the intervals of tau, K and f_c, in % of the value; inf if they stay unknown.

        information  (5, 5), of log tau, log K, fc (V), asym (V) and delay (s)
        """
        found = compiled.variances(information)
        if found is None:
            return math.inf
        return float(self.wanted_percent * np.max(np.sqrt(found) / self.wanted))


def law_of(test: RelayGains | Sequence[Stroke]) -> compiled.Law:
    """A test as the compiled loops take it."""
    if isinstance(test, RelayGains):
        return True, np.array([test.h1_V, test.h2_V]), np.zeros(0)
    u_V, turn_rad = np.array(test, dtype=float).T
    return False, np.ascontiguousarray(u_V), np.ascontiguousarray(turn_rad)


def told(task: Task, law: compiled.Law, longest_s: float = LONGEST_S) -> Told:
    """How soon a test tells enough. If it takes longer than ``longest_s``: as if information grew evenly."""
    period_s = task.reading.period_s
    jacobian, every = _jacobian(task, law, longest_s), max(round(LOOKED_S / period_s), 1)
    rows, information = compiled.rows_until(jacobian, task.reading.noise_rad2, task.before, task.wanted, every)
    return Told(rows * period_s, information)


def told_either_way(task: Task, law: compiled.Law, longest_s: float = LONGEST_S, too_long_s: float = math.inf) -> Told:
    """As ``told``, for strokes: where noise decides with which of the first two they begin, the slower way.

    too_long_s  where one way takes that long, the other is not looked at
    """
    y_rad = task.start.y
    if abs(y_rad) > task.least_swing_rad:
        return told(task, law, longest_s)
    first = told(replace(task, start=task.start._replace(y=-1e-9)), law, longest_s)
    if first.seconds >= too_long_s:
        return first
    second = told(replace(task, start=task.start._replace(y=1e-9)), law, longest_s)
    return second if second.seconds > first.seconds else first


def told_in_turn(task: Task, laws: Sequence[compiled.Law]) -> float:
    """How soon tests that share the time evenly tell enough, s; each begins as ``task`` says.

    Beyond ``LONGEST_S`` for each of them information is taken to grow evenly.
    """

    def percent(seconds: float) -> float:
        parts = (information_of(task, law, seconds / len(laws)) for law in laws)
        return task.percent(task.before + np.sum(list(parts), axis=0))

    low_s, high_s = 0.0, LONGEST_S * len(laws)
    at_last = percent(high_s)
    if at_last > task.wanted_percent:
        return high_s * (at_last / task.wanted_percent) ** 2
    while high_s - low_s > LOOKED_S:
        middle_s = 0.5 * (low_s + high_s)
        low_s, high_s = (low_s, middle_s) if percent(middle_s) <= task.wanted_percent else (middle_s, high_s)
    return high_s


def information_of(task: Task, law: compiled.Law, seconds: float) -> Array:
    """What a test of so many seconds tells (5, 5), without what was there before."""
    jacobian = _jacobian(task, law, seconds)
    return compiled.known(jacobian.T @ jacobian / task.reading.noise_rad2, np.zeros((5, 5)))


def driven(task: Task, law: compiled.Law, seconds: float) -> tuple[Array, Array, Array]:
    """Times, s, positions, rad, and drives, V, of a test of so many seconds, by the believed motor."""
    u_V, states = _driven(task, law, seconds)
    return task.reading.period_s * np.arange(float(u_V.size)), states[:, 1], u_V


def _driven(task: Task, law: compiled.Law, seconds: float) -> tuple[Array, Array]:
    """Drives (n,) and states (n, 2) of a test."""
    n = max(round(seconds / task.reading.period_s), 3)
    timing = task.reading.period_s, task.delay_s
    motor = task.belief.plant(task.room.static_V)
    u_V, states, _ = compiled.drive(motor, law, timing, tuple(map(float, task.start)), 0, n)
    return u_V, states


def _jacobian(task: Task, law: compiled.Law, seconds: float) -> Array:
    """The derivatives (n, 7) of the readings of a test, by log tau, log K, fc, asym, delay and the start."""
    u_V, states = _driven(task, law, seconds)
    motor = task.belief.plant(task.room.static_V)
    return compiled.spread(motor, (task.reading.period_s, task.delay_s), u_V, states)


class Outcome(NamedTuple):
    """How far the shaft goes in a test, and by what share that is too much, or too little; 0 if all is well."""

    reach: Reach
    excess: float
    longest_stroke_s: float


def outcome(
    task: Task,
    law: compiled.Law,
    motors: Sequence[tuple[float, ...]],
    strokes: int,
    *,
    anywhere: bool = False,
    enough: float = math.inf,
) -> Outcome:
    """Simulate a test on each of the motors it may be, with a drive that acts up to one period later.

    strokes   number of strokes; 0 for a relay
    anywhere  whether the test may also begin at the edge of the room, where another test turned that gives way to it
    enough    excess beyond which no further motor is simulated: the rest of the outcome is of those before
    """
    starts = [task.start]
    if anywhere:
        starts += [State(y=task.room.low_rad), State(y=task.room.high_rad)]
    room, period_s = task.room, task.reading.period_s
    late_s = period_s + min(task.belief.delay_doubt_s, period_s)
    timing = period_s, task.delay_s + late_s
    # a shaft that starts farther out is not the test's fault
    low_rad, high_rad = min(room.low_rad, task.start.y), max(room.high_rad, task.start.y)
    low = high = speed = excess = longest_s = 0.0
    least_swing_rad = task.least_swing_rad
    n = round(CORNER_S / period_s)
    for motor, start in product(motors, starts):
        _, states, longest = compiled.drive(motor, law, timing, tuple(map(float, start)), PASSES * strokes, n)
        lowest, highest, fastest, *stops = compiled.bounds(states, room.horizon_s)
        low, high, speed = min(low, lowest), max(high, highest), max(speed, fastest)
        longest_s = max(longest_s, longest * period_s)
        used = (lowest / low_rad, highest / high_rad, fastest / room.max_speed_rad_s)
        too_small = least_swing_rad / max(highest - lowest, 1e-9)
        predicted = (stop / limit for stop, limit in zip(stops, room.stop_rad, strict=True))
        never_ends = 2.0 if strokes and len(states) == n else 0.0
        excess = max(excess, max(*used, *predicted, too_small, never_ends) - 1.0)
        if excess > enough:
            break
    return Outcome(Reach(low, high, speed), excess, longest_s)
