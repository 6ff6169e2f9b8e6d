"""The position over turns: the first within half a turn of zero, the others beside it, and no jump unseen."""

from __future__ import annotations

import math
import random
import statistics

import pytest
from evidence import evidence
from hypothesis import given
from hypothesis import strategies as st
from servo_bench import PROTOCOLS, Bench

from rig.backends.servo.steps import STEP_S, WRAPS, Steps
from rig.core.faults import Fault

COUNT_RAD = 2.0 * math.pi / 4096


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("zero_counts", [0, 100, 2048, 4000])
def test_a_shaft_that_crosses_the_end_of_its_turn_is_followed(protocol: str, zero_counts: int) -> None:
    bench = Bench(protocol, setup={"zero_counts": zero_counts}, zero_counts=zero_counts)
    bench.servo.place(-1.0)
    bench.armed()
    for k in range(80):
        bench.servo.place(-1.0 + 0.025 * k)
        bench.bus.sleep_until(bench.bus.now_s() + 0.002)
        sample = bench.driver.read()
        assert sample.y_rad == pytest.approx(bench.servo.truth().y_rad, abs=1.01 * COUNT_RAD)


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("first", [0, *evidence(*range(1, 201, 50))])
def test_more_than_half_a_turn_in_a_tick_is_a_jump(protocol: str, first: int) -> None:
    """From anywhere, either way, at any phase of the servo's step and of the tick."""
    for phase in range(first, first + 50) if first else (0,):
        bench, rng = Bench(protocol), random.Random(phase)
        begin_rad = rng.uniform(-1.0, 1.0)
        bench.servo.place(begin_rad)
        bench.armed()
        for _ in range(rng.randrange(1, 4)):
            bench.tick(0.0)
        if rng.random() < 0.5:
            bench.driver.read()
            bench.bus.sleep_until(bench.bus.now_s() + rng.uniform(0.0, 0.009))
        bench.servo.place(begin_rad + rng.choice([-1, 1]) * rng.uniform(0.55, 0.95) * math.pi)
        with pytest.raises(Fault, match="SENSOR_JUMP"):
            for _ in range(2):
                bench.tick(0.0)
        assert bench.driver.safe_stop() and not bench.servo.is_on, phase


@given(
    began_s=st.floats(0.0, 1e-3),
    gaps_s=st.lists(st.floats(1e-4, 0.02), min_size=30, max_size=60),
    first=st.integers(0, WRAPS - 1),
)
def test_the_steps_of_a_servo_are_found_from_its_clock(began_s: float, gaps_s: list[float], first: int) -> None:
    """Bounds hold the truth; the time of a reading's step is no more than a step before it."""
    steps, t_s = Steps(), 0.1
    for gap_s in gaps_s:
        t_s += gap_s
        number = math.floor((t_s - began_s) / STEP_S)
        told_s = steps.take((first + number) % WRAPS, t_s, t_s)
        assert t_s - STEP_S - 1e-9 <= told_s <= t_s + 1e-9
        true_s = began_s + number * STEP_S
        assert abs(told_s - true_s) <= 0.5 * (steps.high_s - steps.low_s) + 1e-9
        assert t_s - 1e-9 <= steps.next_s(t_s) <= t_s + STEP_S + 1e-9


def test_a_clock_of_another_pace_is_followed() -> None:
    steps, began_s, step_s = Steps(), 0.0004, STEP_S * 1.0002
    for k in range(3000):
        t_s = 0.1 + 0.01 * k
        number = math.floor((t_s - began_s) / step_s)
        told_s = steps.take(number % WRAPS, t_s, t_s)
        assert t_s - step_s - 1e-9 <= told_s <= t_s + 1e-9


@pytest.mark.parametrize("pace", [-0.02, -0.005, 0.005, 0.02])
def test_the_pace_of_a_clock_is_learnt_also_where_replies_are_late(pace: float) -> None:
    """Else a quick clock is told by the latest of its replies: 1 ms late in the mean, and 3 ms at most."""
    steps, rng, errors_s = Steps(), random.Random(1), []
    for k in range(2000):
        t_s = 0.01 * k
        number = math.floor(t_s / (STEP_S * (1.0 + pace)))
        told_s = steps.take(number % WRAPS, t_s, t_s + rng.uniform(0.0, 0.003))
        errors_s.append(told_s - number * STEP_S * (1.0 + pace))
    assert max(map(abs, errors_s[200:])) < STEP_S
    assert abs(statistics.mean(errors_s[200:])) < 0.3 * STEP_S


def test_a_clock_that_stands_or_jumps_spoils_no_later_time() -> None:
    """Not every restart of a servo shows in its clock."""
    steps, began_s = Steps(), 0.0004
    for k in range(1000):
        t_s = 0.1 + 0.01 * k
        stood = 5 if k < 20 else math.floor((t_s - began_s) / STEP_S) - (80 if k > 100 else 0)
        told_s = steps.take(stood, t_s, t_s)
        assert t_s - 1.03 * STEP_S - 1e-9 <= told_s <= t_s + 1e-9
    assert steps.step_s == pytest.approx(STEP_S, rel=1e-3)


@given(held_up_s=st.lists(st.floats(0.0, 0.004), min_size=40, max_size=80), share=st.floats(0.0, 1.0))
def test_readings_that_the_machine_held_up_do_not_move_the_steps(held_up_s: list[float], share: float) -> None:
    """Wherever in the exchange the delay was: the bounds hold the truth."""
    steps, began_s = Steps(), 0.0004
    for k, delay_s in enumerate(held_up_s):
        sent_s = 0.1 + 0.01037 * k
        number = math.floor((sent_s + share * delay_s - began_s) / STEP_S)
        told_s = steps.take(number % WRAPS, sent_s, sent_s + delay_s)
        assert abs(told_s - (began_s + number * STEP_S)) <= 0.5 * (steps.high_s - steps.low_s) + 1e-9
