"""What a reading may hide: how far drives may turn the shaft unseen, and the pushes that prove the sensor."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import pytest
from raised import fault_of

from rig.control.bounded import Bounded
from rig.control.law import Constant
from rig.control.strokes import Stroke, StrokeTest, StrokeTiming
from rig.control.unshown import FRICTION, START, STILL_S, STRONGEST, Flicker, Pushes, UnshownMotion
from rig.core.faults import Fault
from rig.core.signals import Sample

PERIOD_S = 0.01
MOVES_V = 0.6
ANY = Flicker(math.inf)


def sample(k: int, y_rad: float = 0.1, counts: int = 500) -> Sample:
    return Sample(k * PERIOD_S, y_rad, counts)


def unshown(delay_s: float = 0.0, from_V: float = 0.0) -> UnshownMotion:
    return UnshownMotion(MOVES_V, 0.02, delay_s, ANY, from_V)


def ticks_until(watch: UnshownMotion, drive_V: Callable[[int], float], most: int = 2000) -> int:
    """Ticks until it is too much; ``most`` if it never is."""
    return next((k for k in range(most) if watch.step(sample(k, 0.1 + 0.003 * (k % 2)), drive_V(k))), most)


@pytest.mark.parametrize("delay_s", [0.0, 0.05])
@pytest.mark.parametrize("level", [0.55, 0.7, 1.0, 1.2, 1.4])
def test_no_drive_turns_the_shaft_farther_unseen_than_a_first_push_does(level: float, delay_s: float) -> None:
    """With friction from half of the breakaway level up: the first push is ``START`` times as strong."""
    driven_s = ticks_until(unshown(delay_s), lambda _: level * MOVES_V) * PERIOD_S
    for friction in (FRICTION, 0.8, 1.0):
        first_push = (START - friction) * STILL_S + (STRONGEST - FRICTION) * delay_s
        assert (level - friction) * driven_s <= first_push + 2.0 * (level - FRICTION) * PERIOD_S
    assert (level - FRICTION) * driven_s > 0.95 * (START - FRICTION) * STILL_S  # and no sooner


def test_drives_too_weak_for_any_friction_and_those_below_a_given_level_do_not_count() -> None:
    assert ticks_until(unshown(), lambda _: 0.49 * MOVES_V) == 2000
    assert ticks_until(unshown(from_V=MOVES_V), lambda _: 0.99 * MOVES_V) == 2000
    assert ticks_until(unshown(from_V=MOVES_V), lambda _: -1.01 * MOVES_V) < 100


def test_drives_to_either_side_count_against_each_other_but_not_for_ever() -> None:
    one_way = ticks_until(unshown(), lambda _: 1.2 * MOVES_V)
    to_and_fro = ticks_until(unshown(), lambda k: math.copysign(1.2 * MOVES_V, math.sin(0.2 * k + 0.1)))
    assert to_and_fro == pytest.approx(4 * one_way, abs=5)


def test_a_shaft_that_has_shown_to_be_slow_gets_twice_as_long_but_never_more_than_four_times() -> None:
    def slow(stands: int) -> int:
        watch, y_rad = unshown(), 0.0
        for k in range(5000):
            y_rad += 0.05 * (k % stands == 0 and k < 20 * stands)
            if watch.step(sample(k, y_rad), 1.2 * MOVES_V):
                return k - 19 * stands
        raise AssertionError

    first = ticks_until(unshown(), lambda _: 1.2 * MOVES_V)
    assert slow(10) == pytest.approx(first, abs=4)
    assert slow(40) == pytest.approx(80, abs=6)
    watch, y_rad, stands, since = unshown(), 0.0, 40, 0
    for k in range(5000):
        if k - since == stands:  # each standstill 1.7 times as long as the last
            y_rad, stands, since = y_rad + 0.05, round(1.7 * stands), k
        if watch.step(sample(k, y_rad), 1.2 * MOVES_V):
            break
    assert k - since == pytest.approx(4 * first, abs=16)  # 0.45 s, four times: not 1.96 s, as it would go on


def test_a_reading_that_flickered_and_no_longer_changes_is_a_stuck_sensor_at_any_drive() -> None:
    watch = UnshownMotion(MOVES_V, 0.02, 0.0, Flicker(0.3))
    for k in range(200):
        assert not watch.step(sample(k), 0.0)  # at rest nothing is said
    with pytest.raises(Fault, match="at rest it flickered") as caught:
        for k in range(200, 300):
            watch.step(sample(k), 0.01)
    assert caught.value.code == "SENSOR_STUCK" and k in (230, 231)
    alive = UnshownMotion(MOVES_V, 0.02, 0.0, Flicker(0.3))
    assert not any(alive.step(sample(k, counts=500 + k // 25 % 2), 0.01) for k in range(1000))


def pushes(first_V: float = 0.5, last_V: float = 0.9, way: int = 0) -> Pushes:
    return Pushes(first_V, last_V, STILL_S, 0.02, ANY, way)


def test_pushes_that_move_nothing_grow_pair_by_pair_and_end_in_a_stuck_sensor() -> None:
    law, driven = pushes(), []
    with pytest.raises(Fault, match=r"pushes of 0\.90 V, 0\.30 s to either side") as caught:
        for k in range(1000):
            driven.append(law.step(sample(k)))
    assert caught.value.code == "SENSOR_STUCK"
    levels = [u_V for k, u_V in enumerate(driven) if k == 0 or u_V != driven[k - 1]]
    assert levels == pytest.approx([-0.5, 0.5, -0.7, 0.7, -0.9, 0.9])  # the first one inward
    assert sum(driven) == pytest.approx(0.0, abs=1e-9) and len(driven) == 6 * 30


@pytest.mark.parametrize(("way", "first"), [(0, -1.0), (1, 1.0), (-1, -1.0)])
def test_they_end_as_soon_as_one_push_moves_the_reading(way: int, first: float) -> None:
    law = pushes(way=way)
    assert law.step(sample(0)) == 0.5 * first
    k = 0
    while not law.finished:
        k += 1
        law.step(sample(k, 0.1 + 0.001 * max(k - 65, 0)))  # the third push
    assert law.moved_V == pytest.approx(0.7) and 85 <= k <= 89


def test_noise_that_just_passes_the_breakaway_check_never_looks_like_motion() -> None:
    """A sixth of motion_rad; in single readings it would be as wide as that once in some hundred pushes."""
    rng = random.Random(2)
    for _ in range(40):
        law = pushes()
        with pytest.raises(Fault, match="did not move"):
            for k in range(1000):
                law.step(sample(k, rng.gauss(0.1, 0.02 / 6.0)))
                assert not law.finished


def test_a_law_is_given_up_where_its_drive_moves_nothing() -> None:
    law = Bounded(Constant(-1.2 * MOVES_V, 60.0), None, unshown())
    k = 0
    while not law.finished:
        assert law.step(sample(k)) in (-1.2 * MOVES_V, 0.0)
        k += 1
    assert "stood still" in law.failed and "the shaft broke away at 0.60 V" in law.failed
    assert law.last_V == -1.2 * MOVES_V


@pytest.mark.parametrize("level_V", [0.7, 3.0])
def test_strokes_are_given_up_where_a_reading_froze_beyond_one_turning_point(level_V: float) -> None:
    """One stroke is over at each tick, the other never: they would drive to one side for ever."""
    plan = (Stroke(level_V, 0.05), Stroke(-level_V, -0.3))
    law = Bounded(StrokeTest(plan, StrokeTiming(3600.0, 1.0), 0.02, MOVES_V), None, unshown())
    driven: list[float] = []
    while not law.finished:
        driven.append(law.step(sample(len(driven))))
        assert len(driven) < 1000
    assert (
        abs(sum(driven)) * PERIOD_S / level_V
        < STILL_S * (START - FRICTION) / (min(level_V / MOVES_V, 1.4) - 0.5) + 0.02
    )


def test_a_stuck_sensor_ends_a_bounded_law_as_a_fault() -> None:
    law = Bounded(Constant(0.1, 60.0), None, UnshownMotion(MOVES_V, 0.02, 0.0, Flicker(0.3)))

    def step_on() -> None:
        for k in range(100):
            law.step(sample(k))

    assert fault_of(step_on).code == "SENSOR_STUCK"
