"""What the gain search does at each thing that it may see: the shaft's motion is given, not simulated."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from rig.control.excitation import CycleTarget, GainSearch, SearchRange
from rig.control.relay import DualChannelRelay
from rig.control.unshown import Flicker, UnshownMotion
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.cycle_detector import CycleDetector
from rig.model.describing_function import predict

PERIOD_S = 0.01
FRICTION_V = 0.5
TARGET = CycleTarget(0.6, 1.0, 0.05)
SEARCH = SearchRange(0.6, 1.5, 0.15, 0.6, h_max_V=3.0, sum_max_V=3.0, timeout_s=60.0)
REACH_RAD = 0.99

Motion = Callable[[float], float]


def new_search(search: SearchRange = SEARCH, top_speed_rad_s: float = math.inf) -> GainSearch:
    relay = DualChannelRelay(0.0, 0.0, z_bound_rad_s=0.7)
    detector = CycleDetector(30 * PERIOD_S, 0.05)
    return GainSearch(relay, detector, TARGET, search, FRICTION_V, REACH_RAD, top_speed_rad_s)


def show(search: GainSearch, motion: Motion, from_s: float, to_s: float) -> None:
    """Have it see a motion, tick by tick, from one time to before the other."""
    for k in range(round(from_s / PERIOD_S), round(to_s / PERIOD_S)):
        search.step(Sample(k * PERIOD_S, motion(k * PERIOD_S), 512))


def sine(amplitude_rad: float, period_s: float) -> Motion:
    return lambda t_s: amplitude_rad * math.cos(2.0 * math.pi * t_s / period_s)


def at_rest(t_s: float) -> float:
    return 0.1


def gains(search: GainSearch) -> tuple[float, float]:
    return search.relay.h1_V, search.relay.h2_V


# ---------------------------------------------------------------------- retreat


def test_a_cycle_that_leaves_its_reach_gets_less_h2_at_once_and_more_h1() -> None:
    search = new_search()
    wide = sine(1.2, 0.8)  # beyond the reach at each top, the first time on its way out at 0.33 s
    show(search, wide, 0.0, 1.0)
    assert gains(search) == (0.6, 1.5) and search.steps == []  # the first gains get a period to show
    show(search, wide, 1.0, 1.2)
    # 0.6 of what it was above friction; h1 a fifth more
    assert gains(search) == pytest.approx((0.72, 1.1))
    (step,) = search.steps
    assert (step.h1_V, step.h2_V) == (0.6, 1.5) and step.outcome == "|y| above 0.99 rad"
    assert 1.1 < step.t_s < 1.2 and math.isnan(step.period_s) and math.isnan(step.amplitude_rad)
    show(search, wide, 1.2, 2.0)
    assert len(search.steps) == 1  # these gains get a period, too
    show(search, wide, 2.0, 2.4)
    assert gains(search) == pytest.approx((0.864, 0.86)) and len(search.steps) == 2


def test_a_retreat_that_began_near_friction_goes_below_it() -> None:
    search = new_search(replace(SEARCH, h2_start_V=0.54))
    show(search, sine(1.2, 0.8), 0.0, 1.2)
    assert gains(search) == pytest.approx((0.72, 0.8 * 0.54))


@pytest.mark.parametrize(
    ("search", "h1_V"),
    [(replace(SEARCH, h_max_V=0.65), 0.65), (replace(SEARCH, sum_max_V=1.8), 0.7)],
    ids=["largest gain", "largest sum"],
)
def test_a_retreat_asks_for_no_more_than_the_largest_gains(search: SearchRange, h1_V: float) -> None:
    looking = new_search(search)
    show(looking, sine(1.2, 0.8), 0.0, 1.2)
    assert gains(looking) == pytest.approx((h1_V, 1.1))


def test_a_shaft_that_starts_beyond_the_reach_is_no_fault_of_the_gains() -> None:
    search = new_search(replace(SEARCH, step_s=3.0))
    show(search, lambda t_s: 1.2 - 0.1 * t_s, 0.0, 2.0)
    assert search.steps == []


def test_a_cycle_beyond_the_top_speed_gets_less_h2() -> None:
    quick = sine(0.9, 0.8)  # 7.1 rad/s, inside the reach
    search = new_search(top_speed_rad_s=5.0)
    show(search, quick, 0.0, 1.2)
    assert gains(search) == pytest.approx((0.72, 1.1))
    assert search.steps[0].outcome == "speed above 5.0 rad/s"
    slower = new_search(top_speed_rad_s=7.5)
    show(slower, quick, 0.0, 1.2)
    assert slower.steps == []


# ---------------------------------------------------------------------- more h2


def test_a_shaft_that_sticks_gets_more_h2_step_by_step_and_a_fresh_integral() -> None:
    search = new_search(replace(SEARCH, h2_start_V=0.1))
    show(search, at_rest, 0.0, 0.60)
    assert gains(search) == (0.6, 0.1)
    show(search, at_rest, 0.60, 0.62)
    assert gains(search) == pytest.approx((0.6, 0.25))
    assert search.steps[0].outcome == "no oscillation"
    show(search, at_rest, 0.62, 0.63)
    assert search.relay.z_rad_s == 0.0
    show(search, at_rest, 0.63, 1.24)
    assert gains(search) == pytest.approx((0.6, 0.4))


def test_a_shaft_that_moves_gets_the_time_for_two_periods_and_a_half() -> None:
    search = new_search()
    falling = 0.3
    show(search, lambda t_s: 0.4 - falling * t_s, 0.0, 2.5)
    assert search.steps == []
    show(search, lambda t_s: 0.4 - falling * t_s, 2.5, 2.52)
    assert gains(search) == pytest.approx((0.6, 1.65))


def test_the_step_s_own_time_counts_where_it_is_longer() -> None:
    search = new_search(replace(SEARCH, step_s=4.0))
    show(search, lambda t_s: 0.4 - 0.2 * t_s, 0.0, 4.0)
    assert search.steps == []
    show(search, lambda t_s: 0.4 - 0.2 * t_s, 4.0, 4.02)
    assert len(search.steps) == 1


@pytest.mark.parametrize(
    "search", [replace(SEARCH, h_max_V=1.6), replace(SEARCH, sum_max_V=2.2)], ids=["largest gain", "largest sum"]
)
def test_where_the_largest_gains_do_nothing_it_gives_up(search: SearchRange) -> None:
    looking = new_search(search)
    with pytest.raises(Fault) as caught:
        show(looking, at_rest, 0.0, 10.0)
    assert caught.value.code == "NO_CYCLE"
    assert "h2 reached 1.50 V" in caught.value.detail and "1 pairs of gains tried" in caught.value.detail


def test_the_largest_gains_themselves_are_tried() -> None:
    search = new_search(replace(SEARCH, h2_start_V=1.5, h2_step_V=0.5, h_max_V=2.0, sum_max_V=2.75))
    show(search, at_rest, 0.0, 0.62)
    assert gains(search) == (0.6, 2.0)


def test_the_search_ends_at_its_time_out() -> None:
    search = new_search(replace(SEARCH, step_s=100.0, timeout_s=2.0))
    show(search, at_rest, 0.0, 2.0)
    with pytest.raises(Fault, match="NO_CYCLE"):
        show(search, at_rest, 2.0, 2.02)


# ---------------------------------------------------------------------- trim


def settle(search: GainSearch, amplitude_rad: float, period_s: float, from_s: float) -> float:
    """Show a cycle until it has settled and the gains were changed, or the search is over; when that was, s."""
    steps, t_s = len(search.steps), from_s
    while len(search.steps) == steps and not search.finished:
        assert t_s < from_s + 8.0 * period_s
        show(search, sine(amplitude_rad, period_s), t_s, t_s + PERIOD_S)
        t_s += PERIOD_S
    return t_s


def test_a_settled_cycle_that_is_as_wished_ends_the_search() -> None:
    search = new_search()
    settle(search, 0.62, 0.98, 0.0)
    assert search.finished and search.steps[-1].outcome == "settled"
    assert search.steps[-1].amplitude_rad == pytest.approx(0.62, rel=0.01)
    assert search.steps[-1].period_s == pytest.approx(0.98, rel=0.01)
    assert gains(search) == (0.6, 1.5)


@pytest.mark.parametrize(("amplitude_rad", "period_s"), [(0.64, 1.0), (0.56, 1.0), (0.6, 1.08), (0.6, 0.92)])
def test_one_that_is_not_quite_as_wished_does_not(amplitude_rad: float, period_s: float) -> None:
    search = new_search()
    settle(search, amplitude_rad, period_s, 0.0)
    assert not search.finished and gains(search) != (0.6, 1.5)


def test_the_next_gains_are_those_under_which_the_motor_that_was_seen_cycles_as_wished() -> None:
    search = new_search()
    settle(search, 0.7, 1.1, 0.0)
    h1, h2 = gains(search)
    # the motor that cycles so under 0.6 and 1.5 V at 0.5 V of friction
    omega = 2.0 * math.pi / 1.1
    tau_s, K = 0.6 / omega, math.pi * 0.7 * omega / 4.0
    wished = predict(tau_s, K, FRICTION_V, h1, h2)
    assert wished.amplitude_rad == pytest.approx(TARGET.amplitude_rad, rel=0.02)
    assert wished.period_s == pytest.approx(TARGET.period_s, rel=0.02)


def test_no_step_changes_a_gain_by_more_than_half() -> None:
    search = new_search(replace(SEARCH, h1_start_V=0.2, h2_start_V=0.7))
    settle(search, 0.1, 1.2, 0.0)  # far too small
    assert gains(search) == pytest.approx((0.3, FRICTION_V + 1.5 * 0.2))


def test_gains_that_the_drive_cannot_give_are_both_scaled_down() -> None:
    search = new_search(replace(SEARCH, h1_start_V=1.0, h2_start_V=1.5, sum_max_V=2.6))
    settle(search, 0.2, 1.2, 0.0)
    h1, h2 = gains(search)
    assert h1 + h2 == pytest.approx(2.6)
    assert h1 / h2 == pytest.approx(1.5 / 2.0)  # as wanted: half more of each, above friction


def test_friction_comes_from_two_settled_pairs() -> None:
    """Pi A w/4 = K (h2 - f): shown are the cycles of a motor of friction 0.4 V, not the 0.5 V assumed."""
    search = new_search()
    K, true_V = 2.0, 0.4
    t_s = 0.0
    for _ in range(2):
        h2 = search.relay.h2_V
        t_s = settle(search, 4.0 * K * (h2 - true_V) / math.pi / (2.0 * math.pi / 1.2), 1.2, t_s)
    assert search.friction_V == pytest.approx(true_V, abs=0.02)


@pytest.mark.parametrize(("second_rad", "friction_V"), [(0.6, 1.5 * FRICTION_V), (0.34, 0.5 * FRICTION_V)])
def test_friction_moves_by_no_more_than_half(second_rad: float, friction_V: float) -> None:
    search = new_search()
    t_s = settle(search, 0.3, 1.2, 0.0)
    assert gains(search) == pytest.approx((0.9, 2.0))
    settle(search, second_rad, 1.2, t_s)  # slopes that would put it at 1.0 V, and at -1.75 V
    assert search.friction_V == pytest.approx(friction_V)


def test_two_pairs_that_contradict_or_are_too_near_say_nothing_of_friction() -> None:
    search = new_search()
    t_s = settle(search, 0.3, 1.2, 0.0)
    settle(search, 0.2, 1.2, t_s)  # more drive, less motion
    assert search.friction_V == FRICTION_V
    near = new_search()
    t_s = settle(near, 0.565, 1.0, 0.0)
    assert near.relay.h2_V == pytest.approx(1.5 + 0.06, abs=0.01)
    settle(near, 0.8, 1.0, t_s)
    assert near.friction_V == FRICTION_V


def test_a_cycle_that_is_still_growing_is_waited_for_and_one_that_has_stuck_is_not() -> None:
    search = new_search()
    growing = 0.3

    def motion(t_s: float) -> float:
        return (0.2 + growing * min(t_s, 4.0)) * 0.4 * math.cos(2.0 * math.pi * t_s) if t_s < 4.5 else 0.0

    show(search, motion, 0.0, 4.5)
    assert search.steps == []  # longer than two periods and a half: its cycles are accepted, not settled
    show(search, motion, 4.5, 8.0)
    assert search.steps != [] and search.steps[0].outcome != "settled"


@pytest.mark.parametrize(("moves_rad", "steps"), [(0.2, 1), (0.05, 0)])
def test_a_shaft_that_hunts_unshown_is_not_waited_for(moves_rad: float, steps: int) -> None:
    search = new_search()
    search.unshown = UnshownMotion(5.0, moves_rad, 0.0, Flicker(math.inf))
    show(search, sine(0.04, 0.1), 0.0, 0.7)  # its range is more than a shaft has that sticks
    assert [step.outcome.endswith("delay hunting") for step in search.steps] == [True] * steps  # not after 2.5 s


# ---------------------------------------------------------------------- the story, and the second test


def test_the_story_names_the_nearest_pair() -> None:
    search = new_search(replace(SEARCH, timeout_s=40.0))
    t_s = settle(search, 0.3, 1.2, 0.0)
    t_s = settle(search, 0.5, 1.2, t_s)
    with pytest.raises(Fault) as caught:
        show(search, lambda t_s: 0.0, 40.0, 40.1)
    first, second = search.steps[0], search.steps[1]
    assert (first.h1_V, first.h2_V) == (0.6, 1.5)
    assert f"nearest: h1 {second.h1_V:.2f} V, h2 {second.h2_V:.2f} V gave 0.50 rad, 1.20 s" in caught.value.detail
    assert "wanted 0.60 rad, 1.00 s" in caught.value.detail


@pytest.mark.parametrize("ratio", [0.8, 1.25])  # 0.83 rad are within the reach
def test_gains_of_the_second_test_scale_h1_and_what_is_above_friction(ratio: float) -> None:
    search = new_search()
    settle(search, 0.6, 1.0, 0.0)
    search.seek_second(ratio)
    friction_V = 0.85 * FRICTION_V  # a guess from strokes is too high
    assert search.friction_V == friction_V and not search.finished
    assert gains(search) == pytest.approx((0.6 * ratio, friction_V + (1.5 - friction_V) * ratio))
    assert search.further_gains(0.64) == pytest.approx((0.384, friction_V + (1.5 - friction_V) * 0.64))


@pytest.mark.parametrize(
    "search",
    [replace(SEARCH, h_max_V=1.7), replace(SEARCH, sum_max_V=2.45), SEARCH],
    ids=["largest gain", "largest sum", "reach"],
)
def test_where_there_is_no_room_for_more_the_second_test_is_smaller_by_as_much(search: SearchRange) -> None:
    looking = new_search(search)
    settle(looking, 0.6, 1.0, 0.0)
    ratio = 1.25 if search is not SEARCH else 1.55  # 1.1 times 0.93 rad are beyond the reach
    looking.seek_second(ratio)
    assert gains(looking) == pytest.approx((0.6 / ratio, 0.425 + 1.075 / ratio))
    assert looking.target.amplitude_rad == pytest.approx(0.6 / ratio, rel=0.01)


def test_the_second_tests_gains_stay_within_the_drive_though_friction_was_taken_for_more_than_h2() -> None:
    looking = new_search(replace(SEARCH, h_max_V=1.6))
    settle(looking, 0.6, 1.0, 0.0)
    looking.friction_V = 2.0
    looking.seek_second(0.7)
    assert max(gains(looking)) <= 1.6
    assert max(looking.further_gains(0.5)) <= 1.6


@pytest.mark.parametrize("true_V", [0.32, 0.52])
def test_the_second_cycle_has_its_amplitude_though_friction_was_taken_for_another(true_V: float) -> None:
    """Friction is taken for 0.43 V; at 0.52 V the first try has a third of the first amplitude."""
    search = new_search(replace(SEARCH, h1_start_V=0.12, h2_start_V=0.65))
    tau_s = 0.12 / (2.0 * math.pi * (0.65 - true_V))
    K = 0.6 * 2.0 * math.pi * math.pi / (4.0 * (0.65 - true_V))
    t_s = settle(search, 0.6, 1.0, 0.0)
    search.seek_second(0.7)
    while not search.finished:
        cycle, begin_s, steps = predict(tau_s, K, true_V, *gains(search)), t_s, len(search.steps)
        motion = sine(cycle.amplitude_rad, cycle.period_s)
        search.relay.restart()  # the motion that is shown begins where its integral is zero
        while len(search.steps) == steps:
            assert t_s < begin_s + 8.0 * cycle.period_s
            show(search, lambda now_s: motion(now_s - begin_s), t_s, t_s + PERIOD_S)  # noqa: B023 (called at once)
            t_s += PERIOD_S
    assert predict(tau_s, K, true_V, *gains(search)).amplitude_rad == pytest.approx(0.42, rel=0.05)
    assert len(search.steps) <= 5
    assert search.friction_V == pytest.approx(true_V, abs=0.03)


def test_a_second_test_whose_shaft_sticks_goes_half_the_way_back() -> None:
    search = new_search()
    t_s = settle(search, 0.6, 1.0, 0.0)
    search.seek_second(0.5)
    tried = gains(search)
    show(search, at_rest, t_s, t_s + 2.4)
    assert gains(search) == tried  # two and a half periods to show
    show(search, at_rest, t_s + 2.4, t_s + 2.6)
    assert gains(search) == pytest.approx((0.5 * (0.6 + tried[0]), 0.5 * (1.5 + tried[1])))


@pytest.mark.parametrize(
    ("largest_V", "why"), [(3.0, "3 pairs of gains of the second test"), (1.3, "h2 reached 1.28 V; 1 pairs of gains")]
)
def test_a_second_search_that_gives_up_ends_with_the_first_gains_and_why(largest_V: float, why: str) -> None:
    search = new_search(replace(SEARCH, timeout_s=8.0))
    t_s = settle(search, 0.6, 1.0, 0.0)
    search.seek_second(0.8)
    search.search = replace(search.search, h_max_V=largest_V)
    while not search.finished:
        assert not search.no_second and t_s < 30.0
        show(search, lambda _: 0.0, t_s, t_s + PERIOD_S)
        t_s += PERIOD_S
    assert search.no_second.startswith(why)
    assert gains(search) == (0.6, 1.5) and search.relay.z_rad_s == 0.0
