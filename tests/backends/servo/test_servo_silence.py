"""The host falls silent at any phase: the duty is 0 soon after the watchdog's time, and the next run says so."""

from __future__ import annotations

import random

import pytest
from evidence import evidence
from servo_bench import PERIOD_S, Bench

LATER_S = 0.02  # after the watchdog's time: its unit, and a step
PHASES = 200


def silent_at(phase: int) -> None:
    rng = random.Random(phase)
    bench = Bench(
        watchdog_fed_by=rng.choice(["any", "own"]),
        stopped_by_watchdog=rng.choice(["brake", "coast"]),
        resumes=rng.random() < 0.5,
    )
    bench.armed()
    driver = bench.driver
    for _ in range(rng.randrange(1, 30)):
        bench.tick(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, bench.limits.max_u_V))
    if rng.random() < 0.5:  # within a tick: behind its reading, or behind its drive
        driver.read()
        bench.bus.sleep_until(bench.bus.now_s() + rng.uniform(0.0, 0.5) * PERIOD_S)
    if rng.random() < 0.5:
        driver.write(rng.choice([-1.0, 1.0]) * bench.limits.max_u_V)
    silent_s = bench.bus.now_s()
    bench.bus.sleep_until(silent_s + bench.limits.watchdog_s + LATER_S)
    truth = bench.servo.truth()
    assert truth.duty == 0.0, phase
    bench.bus.sleep_until(silent_s + 1.0)
    assert not any(volts for t_s, volts in bench.bus.outputs[0] if t_s > silent_s + bench.limits.watchdog_s + LATER_S)
    info = bench.another().open()
    assert info.acknowledged == ("DEVICE_WATCHDOG",), phase
    assert any("without putting" in remark for remark in info.remarks)
    bench.driver.arm(bench.limits)
    bench.tick(0.3)
    bench.driver.safe_stop()
    bench.driver.close()
    assert bench.wrong() == []


@pytest.mark.parametrize(("first", "end"), [(0, 8), *evidence((8, 20), *((k, k + 20) for k in range(20, PHASES, 20)))])
def test_the_duty_is_0_after_the_watchdogs_time_and_the_next_run_says_so(first: int, end: int) -> None:
    for phase in range(first, end):
        silent_at(phase)


def test_a_host_that_comes_back_after_the_watchdog_has_acted_ends_with_its_name() -> None:
    bench = Bench()
    bench.armed()
    for _ in range(5):
        bench.tick(0.5)
    bench.bus.sleep_until(bench.bus.now_s() + 0.2)
    fault = bench.fault_within(1, 0.5)
    assert fault is not None and fault.code == "DEVICE_WATCHDOG"
    assert bench.driver.safe_stop()
    assert not bench.servo.is_on and bench.servo.truth().duty == 0.0
    assert bench.wrong() == []
