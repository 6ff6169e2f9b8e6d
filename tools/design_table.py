"""docs/evidence/design-table.md: how soon designed tests tell enough, beside a free optimum: ``make design``.

The motors are the first of config/campaign.yaml's grid. Every figure is a Cramer-Rao bound by exact simulation, with
the delay unknown. The free optimum drives any voltage at each sample, of a motor that is exactly known: a local search
that begins with the best strokes. Nobody can drive it without knowing the answer.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig import config
from rig.campaign.random_motors import Draw, draw
from rig.control.strokes import Stroke
from rig.design import compiled
from rig.design.belief import Belief
from rig.design.best_test import best_of, best_strokes, gain_grid
from rig.design.outlook import Task, driven, law_of, told, told_in_turn
from rig.design.planned_test import Reading, RelayGains, Room, Strokes
from rig.model.compiled.motion import states
from shared import page
from shared.cases import in_order

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/evidence/design-table.md"
MOTORS = 30
WANTED_PERCENT = 1.0
DOUBTS_PERCENT = (1.0, 10.0, 20.0, 30.0)
ROOM = Room(-0.55, 0.55, 3.0, 4.9)
STATIC = 1.05  # static friction over that in motion, of the harder direction
GRID = 24
NOW = (12, 0.75)  # cycles of each of two tests, and the second amplitude: as rig did without designs
CHANGES = 6000  # that the search for the free optimum tries


@dataclass(frozen=True)
class Row:
    """Seconds of each kind of test until the wanted interval on one motor; inf: there is no such test."""

    free_s: float
    strokes_s: tuple[float, ...]
    pair_s: float
    single_s: float
    now_s: float


def task_of(one: Draw, doubt_percent: float) -> Task:
    """A motor of the grid, of which tau, K and f_c may all be wrong by so much; its delay is to be found."""
    static_V = STATIC * (one.fc_V + abs(one.asym_V))
    motor = (one.tau_s, one.K_rad_s_V, one.fc_V, one.asym_V)
    campaign = config.load_campaign(ROOT / "config/campaign.yaml")
    reading = Reading(campaign.sampling.period_s, campaign.sensor.noise_rad, campaign.sensor.lsb_rad, one.delay_s)
    return Task(
        Belief.within(motor, doubt_percent), np.zeros((5, 5)), replace(ROOM, static_V=static_V), reading, WANTED_PERCENT
    )


def row_of(number: int) -> Row:
    """Every kind of test on one motor."""
    one = draw(config.load_campaign(ROOT / "config/campaign.yaml"), number)
    wish = task_of(one, DOUBTS_PERCENT[0])
    plans = [best_strokes(task_of(one, doubt)) for doubt in DOUBTS_PERCENT]
    strokes = [() if plan is None or not isinstance(plan.test, Strokes) else plan.test.strokes for plan in plans]
    free_s = free_optimum_s(wish, [plan for plan in strokes if plan])
    gains = best_of(wish, gain_grid(wish, GRID))
    return Row(
        free_s,
        tuple(math.inf if plan is None else plan.seconds for plan in plans),
        math.inf if gains is None else gains.pair_s,
        math.inf if gains is None else gains.single_s,
        two_tests_s(wish, one),
    )


def two_tests_s(wish: Task, one: Draw) -> float:
    """The tests of a run without designs: two at one period, the second smaller; the gains are the grid's."""
    ratio = 0.45 / 0.8  # from the grid's amplitude to one that the room of these tests has
    first = RelayGains(*one.second_gains(ratio))
    second = RelayGains(*one.second_gains(ratio * NOW[1]))
    return told_in_turn(wish, [law_of(first), law_of(second)])


def free_optimum_s(wish: Task, starts: Sequence[Sequence[Stroke]]) -> float:
    """Seconds until the wanted interval under the best drive that a local search finds from the best strokes."""
    rng = np.random.default_rng(1)
    best_s = math.inf
    drives: Array = np.zeros(0)
    for strokes in starts:
        seconds = told(wish, law_of(strokes)).seconds
        if seconds < best_s:
            best_s, drives = seconds, driven(wish, law_of(strokes), seconds + 0.1)[2]
    seconds_of = open_loop(wish)
    best_s = seconds_of(drives)
    for _ in range(CHANGES):
        tried = changed(drives, rng)
        seconds = seconds_of(tried)
        if seconds < best_s:
            best_s, drives = seconds, tried[: round(seconds / wish.reading.period_s) + 10]
    return best_s


def changed(drives: Array, rng: np.random.Generator) -> Array:
    """The drives with one stretch of another level, or with one edge at another time."""
    tried = drives.copy()
    begin = int(rng.integers(tried.size))
    end = begin + int(rng.integers(1, 40))
    kind = rng.integers(3)
    if kind == 0:
        tried[begin:end] = rng.uniform(-ROOM.max_V, ROOM.max_V)
    elif kind == 1:
        tried[begin:end] = np.clip(tried[begin:end] + 0.3 * rng.standard_normal(), -ROOM.max_V, ROOM.max_V)
    else:
        edges = np.flatnonzero(np.diff(tried)) + 1
        if edges.size:
            edge, by = int(rng.choice(edges)), int(rng.integers(-6, 7))
            low, high = sorted((edge, min(max(edge + by, 0), tried.size)))
            tried[low:high] = drives[edge] if by < 0 else drives[edge - 1]
    return tried


def open_loop(wish: Task) -> Callable[[Array], float]:
    """Seconds until the wanted interval under given drives, one a sample; inf outside the room."""
    period_s, room = wish.reading.period_s, wish.room
    motor = wish.belief.plant(room.static_V)

    def seconds(drives: Array) -> float:
        n = drives.size
        times = period_s * np.arange(float(n))
        edges, levels = np.append(-period_s, times + wish.delay_s), np.append(0.0, drives)
        moved = states(motor, (0.0, 0.0, 0.0), (edges, levels, 0.0), times)[:, :2]
        low, high, speed, *_ = compiled.bounds(moved, 0.0)
        if low < room.low_rad or high > room.high_rad or speed > room.max_speed_rad_s:
            return math.inf
        jacobian = compiled.spread(motor, (period_s, wish.delay_s), drives, moved)
        rows, _ = compiled.rows_until(jacobian, wish.reading.noise_rad2, wish.before, wish.wanted, 5)
        return float(rows * period_s)

    return seconds


def line(name: str, seconds: Sequence[float]) -> tuple[str, ...]:
    """A line of the table: median, 90 % and how many motors have no such test."""
    quantiles = (f"{np.quantile(seconds, q, method='higher'):.1f}" for q in (0.5, 0.9))
    return name, *quantiles, str(sum(map(math.isinf, seconds)))


def listed(numbers: Sequence[int], rows: Sequence[Row]) -> str:
    """Each motor's share of the free optimum's information per second by its strokes, and the median, as text."""
    shares = np.array([[one.free_s / seconds for seconds in one.strokes_s] for one in rows])
    known = "  ".join(f"{doubt:3g} %" for doubt in DOUBTS_PERCENT)
    lines = ["share of the free optimum's information per second that strokes reach, for a motor known to"]
    lines.append(f"motor   free optimum  {known}")
    for number, one, each in zip(numbers, rows, shares, strict=True):
        lines.append(f"{number:5d}  {one.free_s:11.1f} s  " + "  ".join(f"{share:5.2f}" for share in each))
    lines.append("median                " + "  ".join(f"{share:5.2f}" for share in np.median(shares, axis=0)))
    return "\n".join(lines)


def main() -> int:
    """Design for every motor, and write the page; with ``--motors`` only print the shares of some motors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motors", type=int, help="print the shares of the first so many motors, and write no page")
    some: int | None = parser.parse_args().motors
    numbers = range(MOTORS if some is None else some)
    rows = in_order(row_of, [(number,) for number in numbers], jobs=1)
    if some is not None:
        print(listed(numbers, rows))
        return 0
    tests = {
        "two tests at one period, as without a design": [one.now_s for one in rows],
        "best single pair of gains": [one.single_s for one in rows],
        "best two pairs of gains, in turn": [one.pair_s for one in rows],
        **{
            f"strokes, the motor known to {doubt:g} %": [one.strokes_s[k] for one in rows]
            for k, doubt in enumerate(DOUBTS_PERCENT)
        },
        "free optimum": [one.free_s for one in rows],
    }
    table = [line(name, seconds) for name, seconds in tests.items()]
    shares = [
        (
            name,
            *(f"{q:.2f}" for q in np.quantile([one.free_s / s for one, s in zip(rows, each, strict=True)], (0.5, 0.1))),
        )
        for name, each in tests.items()
    ]
    template = Path(__file__).with_name("design-table.md.j2")
    page.write(PAGE, page.render(template, tests=table, shares=shares, motors=MOTORS, room=ROOM, date=page.today()))
    sys.stderr.write("\n".join(" | ".join(line) for line in (*table, *shares)) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
