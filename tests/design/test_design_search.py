"""The search: strokes and gains within the room for every motor that it may be, and better than what they replace."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from design_tasks import DEMO, NOTHING, ROOM, task
from evidence import evidence

from rig.design.belief import Belief
from rig.design.best_test import best_gains, best_of, best_strokes, best_test, gain_grid, seconds_of
from rig.design.outlook import Task, information_of, law_of, told
from rig.design.planned_test import RelayGains, Room, Strokes

MOTORS = {
    "demo": DEMO,
    "quick, high gain": (0.081, 17.5, 0.50, 0.01),
    "slow, low gain": (0.49, 1.27, 0.28, -0.02),
    "one-sided": (0.17, 6.5, 0.40, 0.15),
}


@pytest.mark.parametrize("name", ["one-sided", *evidence("quick, high gain", "demo", "slow, low gain")])
def test_strokes_alternate_stay_in_the_room_and_need_seconds(name: str) -> None:
    wish = task(MOTORS[name])
    found = best_strokes(wish)
    assert found is not None
    assert isinstance(found.test, Strokes)
    drives = [stroke.u_V for stroke in found.test.strokes]
    assert all(a * b < 0.0 for a, b in pairwise([*drives, drives[0]]))
    assert max(map(abs, drives)) <= ROOM.max_V
    assert ROOM.low_rad <= found.reach.low_rad < found.reach.high_rad <= ROOM.high_rad
    assert found.reach.speed_rad_s <= ROOM.max_speed_rad_s
    assert found.seconds < 9.0
    assert found.percent == pytest.approx(1.0, abs=0.2)


@pytest.mark.evidence
def test_strokes_tell_more_per_second_than_relays_and_two_relays_more_than_one() -> None:
    wish = task()
    strokes, gains = best_strokes(wish), best_of(wish, gain_grid(wish))
    assert strokes is not None
    assert gains is not None
    assert strokes.seconds < 0.7 * gains.pair_s < 0.4 * gains.single_s
    chosen = best_test(wish)
    assert chosen == strokes


def test_a_relay_is_what_a_bench_without_strokes_gets() -> None:
    found = best_test(task(), ("relay",))
    assert found is not None
    assert isinstance(found.test, RelayGains)
    assert found.test.h2_V > DEMO[2]


def test_after_a_hard_relay_a_soft_one_comes_and_after_a_soft_one_a_hard_one() -> None:
    wish = task()
    gains = best_of(wish, gain_grid(wish))
    assert gains is not None
    assert gains.pair is not None
    for done, other in (gains.pair, gains.pair[::-1]):
        seen = information_of(wish, law_of(done.gains), 6.0)
        found = best_gains(replace(wish, seen=seen))
        assert found is not None
        assert isinstance(found.test, RelayGains)
        is_harder = found.test.h1_V + found.test.h2_V > done.gains.h1_V + done.gains.h2_V
        assert is_harder == (other.gains.h1_V + other.gains.h2_V > done.gains.h1_V + done.gains.h2_V)


@pytest.mark.evidence
def test_the_same_task_gives_the_same_test() -> None:
    assert best_test(task()) == best_test(task())


@pytest.mark.evidence
def test_what_was_seen_makes_the_rest_shorter() -> None:
    wish = task()
    found = best_strokes(wish)
    assert found is not None
    assert isinstance(found.test, Strokes)
    seen = information_of(wish, law_of(found.test.strokes), 0.6 * found.seconds)
    after = best_strokes(replace(wish, seen=seen))
    assert after is not None
    assert after.seconds < 0.85 * found.seconds


def test_the_less_is_known_the_more_careful_the_test() -> None:
    """Its nominal motor uses less of the room."""
    nominal = [told_reach(doubt) for doubt in (5.0, 40.0)]
    assert nominal[1] < 0.9 * nominal[0]


def told_reach(doubt_percent: float) -> float:
    """Largest speed of the believed motor in the strokes that are best at this doubt, rad/s."""
    from rig.design.outlook import outcome

    wish = task(doubt_percent=doubt_percent)
    found = best_strokes(wish)
    assert found is not None
    assert isinstance(found.test, Strokes)
    law = law_of(found.test.strokes)
    return outcome(wish, law, [wish.belief.plant(0.0)], len(found.test.strokes)).reach.speed_rad_s


@pytest.mark.parametrize(
    "room",
    [
        replace(ROOM, max_V=0.3),  # below friction
        replace(ROOM, low_rad=-0.01, high_rad=0.01),  # no swing there stands out from the noise
        replace(ROOM, stop_rad=(-0.3, 0.3), horizon_s=2.0),
    ],
)
def test_without_room_there_is_no_test(room: Room) -> None:
    assert best_test(task(room=room)) is None


def test_a_relay_sticks_in_no_motor_that_it_may_be() -> None:
    wish = task(doubt_percent=30.0)
    least_V = 1.04 * (DEMO[2] + abs(DEMO[3]))
    assert all(one.gains.h2_V > least_V for one in gain_grid(wish, 6).inside)


def test_seconds_of_several_rates_are_those_of_each() -> None:
    wish = task()
    rates = np.array([information_of(wish, law_of(RelayGains(h1, 0.8)), 4.0) / 4.0 for h1 in (0.2, 0.5)])
    both = seconds_of(wish, rates)
    for rate, seconds in zip(rates, both, strict=True):
        assert wish.percent(rate * seconds) == pytest.approx(1.0, rel=0.02)
    assert seconds_of(wish, np.zeros((1, 5, 5))).tolist() == [math.inf]


def test_gains_cannot_be_better_than_their_own_test_says() -> None:
    """By the whole test, simulated, and by its information per second."""
    wish = task(wanted_percent=3.0)
    gains = best_of(wish, gain_grid(wish))
    assert gains is not None
    assert told(wish, law_of(gains.single.gains)).seconds == pytest.approx(gains.single_s, rel=0.3)


def test_corners_follow_the_covariance() -> None:
    """Where a high gain comes with a high friction, as in a fit of short records, the farthest motor is no box's."""
    deviation = np.array([0.05, 0.1, 0.1 * DEMO[2], 0.001, 0.0])
    separate = np.diag(deviation**2)
    together = separate.copy()
    together[1, 2] = together[2, 1] = 0.95 * deviation[1] * deviation[2]

    def fastest(covariance: np.ndarray) -> float:
        belief = Belief(*DEMO, 0.0, covariance)
        return max(K * (0.7 - fc + asym) for _, K, fc, *_, asym in belief.fast((0.2,)))

    believed = DEMO[1] * (0.7 - DEMO[2] + DEMO[3])
    assert believed < fastest(together) < 0.75 * fastest(separate)


def test_no_motor_that_it_may_be_has_more_friction_in_motion_than_at_rest() -> None:
    belief = task(doubt_percent=30.0).belief
    for _, _, fc_V, *_, asym_V in belief.slow(0.2, 0.52):
        assert fc_V + abs(asym_V - DEMO[3]) < 0.56


@pytest.mark.parametrize(
    "wrong",
    [
        {"motor": (0.0, 6.5, 0.5, 0.0)},
        {"motor": (0.2, -1.0, 0.5, 0.0)},
        {"motor": (0.2, 6.5, 0.0, 0.0)},
        {"motor": (0.2, 6.5, 0.5, math.nan)},
    ],
)
def test_a_motor_out_of_range_is_refused(wrong: dict[str, tuple[float, float, float, float]]) -> None:
    with pytest.raises(ValueError, match="a design needs"):
        Belief.within(wrong["motor"], 10.0)


def test_rooms_and_readings_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="on both sides of 0 rad"):
        Room(0.1, 0.5, 3.0, 5.0)
    with pytest.raises(ValueError, match="max_V"):
        Room(-0.5, 0.5, 0.0, 5.0)
    with pytest.raises(ValueError, match="without noise or step"):
        replace(task().reading, noise_rad=0.0, lsb_rad=0.0)
    with pytest.raises(ValueError, match="covariance"):
        Belief(*DEMO, 0.0, np.eye(3))
    assert Task(task().belief, NOTHING, ROOM, task().reading, 1.0).percent(NOTHING) == math.inf
