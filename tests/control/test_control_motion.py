"""What a driven shaft must do: a frozen reading is found within its bound, and a healthy one is never accused."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest
from evidence import evidence
from hypothesis import given
from hypothesis import strategies as st
from simulated_bench import CALIBRATION, GUARD, LIMITS, PERIOD_S, BenchModel, break_away, simulated_bench

from rig.campaign.random_motors import draw
from rig.config.campaign import Campaign
from rig.control.excitation import CycleTarget, GainSearch, RelayTest, SearchRange
from rig.control.guard import Guard
from rig.control.motion import CycleWatch, Standstill
from rig.control.relay import DualChannelRelay
from rig.core.faults import Fault
from rig.core.signals import Sample
from rig.model.cycle_detector import CycleDetector, DetectedCycle
from rig.model.friction import Friction
from rig.model.motor import Motor

# ---------------------------------------------------------------------- the rules by themselves


def test_a_stand_begins_where_the_reading_last_left_its_span() -> None:
    stand = Standstill()
    still_s = [stand.step(0.1 * k, y, 0.02) for k, y in enumerate([0.0, 0.01, 0.019, 0.021, 0.021, 0.03, 0.021])]
    assert still_s == pytest.approx([0.0, 0.1, 0.2, 0.0, 0.1, 0.2, 0.3])
    assert (stand.low_rad, stand.high_rad) == (0.021, 0.03) and stand.same_s == 0.0
    stand.restart()
    assert stand.step(5.0, 0.021, 0.02) == 0.0


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60))
def test_no_stand_is_longer_than_the_longest_stretch_within_the_span(y_rad: list[float]) -> None:
    stand, span_rad = Standstill(), 0.3
    for k, y in enumerate(y_rad):
        first = k - round(stand.step(float(k), y, span_rad))
        assert max(y_rad[first : k + 1]) - min(y_rad[first : k + 1]) < span_rad


def test_the_words_say_whether_the_reading_still_flickers() -> None:
    frozen, alive = Standstill(), Standstill()
    for k in range(50):
        frozen.step(0.01 * k, 0.1, 0.02)
        alive.step(0.01 * k, 0.1 + 0.004 * (k % 3 == 0), 0.02)
    assert "has not changed at all for 0.49 s" in frozen.words() and "wiper's wire" in frozen.words()
    assert "still flickers" in alive.words() and "drive's supply" in alive.words()


def test_the_guard_finds_a_reading_that_freezes_while_the_drive_speeds_the_shaft_up() -> None:
    """From rest under 1 V: 40 ms after the freeze, while a shaft at rest would have 0.3 s to move."""
    guard = Guard(GUARD)
    guard.static_V = 0.5
    motor, v, y = Motor(0.17, 6.5, Friction(0.5, 0.5, 0.5, 0.5)), 0.0, -0.8
    frozen_s = math.inf
    with pytest.raises(Fault, match="SENSOR_STUCK") as caught:
        for k in range(100):
            t_s = 0.01 * k
            if k == 35:
                frozen_s = t_s
            if k < 35:
                v += 0.01 / motor.tau_s * (motor.K_rad_s_V * 0.5 - v)
                y += 0.01 * v
            guard.allow(Sample(t_s, y, round(CALIBRATION.to_counts(y))), 1.0)
    assert "under the same drive" in caught.value.detail
    assert t_s - frozen_s <= 0.04


def test_a_slow_shaft_teaches_the_guard_its_own_pace() -> None:
    """Steps of 25 mrad, one in 0.25 s: then the next may take up to 0.5 s; it takes 0.45 s, and 0.9 s are too long."""
    guard = Guard(GUARD)
    guard.static_V = 0.5
    moves_s, y, t_s = [0.25, 0.5, 0.95], 0.0, 0.0
    with pytest.raises(Fault, match="SENSOR_STUCK"):
        for k in range(300):
            t_s = 0.01 * k
            y = 0.025 * sum(t_s >= move_s - 1e-9 for move_s in moves_s)
            guard.allow(Sample(t_s, y, round(CALIBRATION.to_counts(y))), 0.8)
    assert t_s == pytest.approx(0.95 + 2.0 * 0.45, abs=0.02)


def cycle(period_s: float, amplitude_rad: float, reason: str = "") -> DetectedCycle:
    return DetectedCycle(0.0, period_s, amplitude_rad, not reason, reason)


@pytest.mark.parametrize(
    ("cycles", "allowed_s"),
    [
        ([cycle(1.0, 0.5)], math.inf),  # one period is no cycle that goes on
        ([cycle(0.9, 0.4), cycle(1.0, 0.5)], 0.6),
        ([cycle(1.0, 0.5), cycle(1.0, 0.5)], 0.6),
        ([cycle(1.2, 0.5), cycle(1.0, 0.5), cycle(1.0, 0.5)], 0.72),
        ([cycle(1.0, 0.5), cycle(1.0, 0.44)], math.inf),  # it dies away
        ([cycle(1.0, 0.5), cycle(1.4, 0.5)], math.inf),  # it is another
        ([cycle(1.0, 0.5, "hunting"), cycle(1.0, 0.5)], math.inf),
        ([cycle(1.0, 0.5), cycle(1.0, 0.5, "hunting")], math.inf),
    ],
)
def test_how_long_a_cycle_may_stand(cycles: list[DetectedCycle], allowed_s: float) -> None:
    watch = CycleWatch(0.08)
    for one in cycles:
        watch.end_period(one)
    assert watch.allowed_s == pytest.approx(allowed_s)


@pytest.mark.parametrize(("stand_s", "allowed_s"), [(0.1, 0.6), (0.25, 0.75), (0.4, 1.0)])
def test_a_cycle_that_stands_by_itself_may_go_on_to_do_so(stand_s: float, allowed_s: float) -> None:
    watch = CycleWatch(0.08)
    for k in range(2):
        for n in range(100):
            stands = n <= round(100 * stand_s)
            watch.step(Sample(k + 0.01 * n, 1.0 if stands else 0.5 * (-1) ** n, 0), 0.4)
        watch.end_period(cycle(1.0, 0.5))
    assert watch.longest_s == pytest.approx(stand_s) and watch.allowed_s == pytest.approx(allowed_s)
    watch.step(Sample(2.0, 1.0, 0), 0.4)
    # that the relays' integral ends a period meanwhile, a long one, changes nothing
    watch.end_period(cycle(1.5, 0.5))
    for n in range(1, round(99 * allowed_s)):
        watch.step(Sample(2.0 + 0.01 * n, 1.0, 0), -1.35)
    with pytest.raises(Fault, match="SENSOR_STUCK"):
        watch.step(Sample(2.0 + 1.01 * allowed_s, 1.0, 0), -1.35)


@pytest.mark.parametrize(
    ("acting_V", "t_u_s", "allowed_s"),
    [(-1.35, 1.99, 0.6), (0.45, 1.99, 0.6), (3.0, 1.99, math.inf), (0.0, 1.99, math.inf), (0.0, math.nan, 0.6)],
    ids=["as asked", "the one before is late", "the guard brakes", "the guard clips", "relay in the device"],
)
def test_a_cycle_that_others_drive_in_goes_on_when_it_has_shown_so_again(
    acting_V: float, t_u_s: float, allowed_s: float
) -> None:
    watch = CycleWatch(0.08)
    watch.step(Sample(1.97, 0.1, 0), 0.45)
    watch.step(Sample(1.98, 0.1, 0), -1.35)
    for _ in range(2):
        watch.end_period(cycle(1.0, 0.5))
    watch.step(Sample(1.99, 0.2, 0, t_u_s=t_u_s, u_V=acting_V), -1.35)
    assert watch.allowed_s == pytest.approx(allowed_s)
    watch.end_period(cycle(1.0, 0.5))
    assert watch.allowed_s == pytest.approx(allowed_s)
    watch.end_period(cycle(1.0, 0.5))
    assert watch.allowed_s == pytest.approx(0.6)


# ---------------------------------------------------------------------- on the bench


def relay_test(cycles: int, gains_V: tuple[float, float]) -> RelayTest:
    detector = CycleDetector(30 * PERIOD_S, 20 * CALIBRATION.lsb_rad)
    return RelayTest(DualChannelRelay(0.0, 0.0, 2.0), detector, gains_V, cycles, 15.0)


def positions_of(bench: BenchModel) -> tuple[Callable[[float], None], list[float]]:
    reached: list[float] = []
    return lambda _: reached.append(bench.driver.bench.state.y), reached


@pytest.mark.parametrize("wiring", [{"sensor": "stuck"}, {"drive": "dead"}], ids=["sensor stuck", "drive dead"])
@pytest.mark.parametrize("gains_V", [(0.45, 0.9), (0.2, 0.8)], ids=["inner level 0.45 V", "inner level 0.6 V"])
def test_at_any_phase_of_the_cycle_it_is_found_and_the_shaft_stays_inside(
    wiring: dict[str, Any], gains_V: tuple[float, float]
) -> None:
    """In the fifth period: a frozen reading within 0.6 of the longest period before, a dead drive within a whole one.

    The relay's inner level is below friction, or above it and moves the shaft unseen.
    """
    whole, test = simulated_bench(), relay_test(5, gains_V)
    with whole.loop.armed(LIMITS):
        break_away(whole.loop)
        whole.loop.run(test, "relay")
    fifth = test.detector.cycles[4]
    longest_s = max(one.period_s for one in test.detector.cycles[1:5])
    for k in range(6):
        freeze_s = fifth.start_s + (k + 0.3) / 6.0 * fifth.period_s
        bench = simulated_bench(fault_after_s=freeze_s, **wiring)
        watch, reached = positions_of(bench)
        with pytest.raises(Fault) as caught, bench.loop.armed(LIMITS):
            break_away(bench.loop)
            bench.loop.run(relay_test(20, gains_V), "relay", watch)
        assert caught.value.code == "SENSOR_STUCK"
        part = 0.6 if "sensor" in wiring else 1.0
        assert bench.record.rows[-1]["t_s"] - freeze_s < part * longest_s + 2.0 * PERIOD_S
        bench.driver.bench.advance(2.0)
        reached.append(bench.driver.bench.state.y)
        assert LIMITS.hard_rad[0] < min(reached) and max(reached) < LIMITS.hard_rad[1]


@contextmanager
def no_cycle_is_no_alarm() -> Iterator[None]:
    """A loop that never settles may say so: that is no false alarm."""
    try:
        yield
    except Fault as fault:
        if fault.code != "NO_CYCLE":
            raise


@pytest.mark.parametrize("phase", [0.15, 0.2, 0.55, 0.7])
def test_a_cycle_that_the_guard_has_braked_may_stand_until_the_relays_turn(phase: float) -> None:
    """The inner level, 0.2 V, does not start the shaft again: the relays' integral has to come back first."""
    gains_V, whole = (0.6, 0.8), simulated_bench()
    test = relay_test(5, gains_V)
    with whole.loop.armed(LIMITS):
        break_away(whole.loop)
        whole.loop.run(test, "relay")
    fifth = test.detector.cycles[4]
    brake_s = fifth.start_s + phase * fifth.period_s
    bench, again = simulated_bench(), relay_test(8, gains_V)

    def brake(t_s: float) -> None:
        fast = abs(bench.driver.bench.state.v) > 0.6 and brake_s <= t_s < brake_s + 0.3
        bench.guard.settings = replace(GUARD, coast_tau_s=9.0) if fast else GUARD

    with bench.loop.armed(LIMITS):
        break_away(bench.loop)
        bench.loop.run(again, "relay", brake)
    assert bench.guard.braked_ticks > 3 and again.finished


GRID = Campaign(name="grid", experiments=1, seed=5)


@pytest.mark.parametrize("number", [0, 1, 2, *evidence(3, 4, 5)])
def test_no_healthy_motor_of_the_grid_is_accused(number: int) -> None:
    """Any friction ratio, resolution and noise: the search and both tests, or the grid's own gains."""
    rng, one = random.Random(number), draw(GRID, number)
    ratio = rng.choice((1.0, 1.2, 1.6))
    plus_V, minus_V = one.fc_V * rng.uniform(0.85, 1.15), one.fc_V
    friction = Friction(
        plus_V, minus_V, ratio * plus_V, ratio * minus_V, rng.choice((0.0, 0.3)) if ratio > 1.0 else 0.0
    )
    guard = replace(GUARD, max_speed_rad_s=24.0, coast_tau_s=0.1, limits=replace(LIMITS, soft_rad=(-1.6, 1.6)))
    motor = Motor(one.tau_s, one.K_rad_s_V, friction, one.asym_V)
    bench = simulated_bench(motor=motor, noise_rad=rng.choice((0.0, 0.004)), guard=guard, seed=number)
    with bench.loop.armed(guard.limits):
        check = break_away(bench.loop)
        pairs_V = [(one.h1_V, one.h2_V), one.second_gains(0.75)]
        if number % 2:
            detector = CycleDetector(30 * PERIOD_S, 20 * CALIBRATION.lsb_rad)
            search = GainSearch(
                DualChannelRelay(0.0, 0.0, 2.0 * one.period_s),
                detector,
                CycleTarget(0.8, one.period_s, 0.15),
                SearchRange(0.3, 0.1, 0.15, 0.6, h_max_V=3.0, sum_max_V=3.0, timeout_s=20.0),
                0.45 * (check.plus_V + check.minus_V),
                1.4,
            )
            with no_cycle_is_no_alarm():
                bench.loop.run(search, "search")
                pairs_V = [(search.relay.h1_V, search.relay.h2_V)]
                search.seek_second(0.75)
                bench.loop.run(search, "search")
                pairs_V.append((search.relay.h1_V, search.relay.h2_V))
        for pair_V in pairs_V:
            with no_cycle_is_no_alarm():
                bench.loop.run(relay_test(4, pair_V), "relay")
    assert bench.guard.fault is None
