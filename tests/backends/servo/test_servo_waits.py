"""How long a driver awaits answers is what preflight counts into the room to stop, whatever the config says."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable

import pytest
from late_bus import LateBus, longest_reaction_s
from servo_bench import PROTOCOLS, Bench
from test_servo_faults import alert, protects, torque_off

from rig.backends.servo.line import setup_of
from rig.config.schema import Experiment
from rig.core.faults import Fault
from rig.running.preflight.room_to_stop import guard_settings_of, reaction_periods, stopping_rad, stopping_sum

SLACK_S = 1e-6
SEEDS = 40
QUICK_S = 0.0018  # of an exchange that nobody disturbs, the dither of a Feetech's included


def experiment(
    timeout_s: float = 0.01,
    watchdog_s: float = 0.06,
    attached: str = "nothing",
    protocol: str = "feetech",
    period_s: float = 0.01,
) -> Experiment:
    e = Bench(protocol).e
    assert e.daq.servo is not None
    servo = e.daq.servo.model_copy(update={"attached": attached, "supply_switch": "the red one"})
    daq = {"timeout_s": timeout_s, "watchdog_s": watchdog_s, "servo": servo}
    return e.model_copy(update={"period_s": period_s, "daq": e.daq.model_copy(update=daq)})


def bench_of(e: Experiment, protocol: str = "feetech") -> Bench:
    bench = Bench(protocol)
    bench.e, bench.setup = e, setup_of(e.device)
    bench.another()
    return bench


def counted_s(e: Experiment) -> tuple[float, float]:
    """How long a loop needs to react, as guard and sum of the room to stop count it, s."""
    limits = e.device.limits
    in_sum_s = stopping_rad(e.device) / limits.max_speed_rad_s - limits.coast_tau_s
    return guard_settings_of(e).reaction_s, in_sum_s


def longest_wait_s(bench: Bench, limits_s: float | None = None) -> float:
    """The longest from a request to the fault that says no answer came, s."""
    waits_s = []
    for asks_to_come in range(4):
        bench.another().open()
        limits = bench.limits if limits_s is None else dataclasses.replace(bench.limits, watchdog_s=limits_s)
        bench.driver.arm(limits)
        bench.tick(1.0)
        left, asked_s, real = asks_to_come, 0.0, bench.bus.write

        def write(data: bytes, real: Callable[[bytes], None] = real) -> None:
            nonlocal left, asked_s
            left, asked_s = left - 1, bench.bus.now_s()
            bench.servo.is_mute = left < 0
            real(data)

        bench.bus.write = write  # type: ignore[method-assign]  # of this bus alone
        with pytest.raises(Fault, match="LINK_TIMEOUT"):
            for _ in range(3):
                bench.tick(1.0)
        waits_s.append(bench.bus.now_s() - asked_s)
        bench.servo.is_mute, bench.bus.write = False, real  # type: ignore[method-assign]
        bench.driver.safe_stop()
        bench.driver.close()
    return max(waits_s)


@pytest.mark.parametrize(("timeout_s", "watchdog_s", "period_s"), [
    (0.004, 0.04, 0.01), (0.01, 0.06, 0.01), (0.01, 0.2, 0.01), (0.02, 0.06, 0.02),
])  # fmt: skip
@pytest.mark.parametrize("attached", ["nothing", "joint"])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_loop_reacts_within_the_time_that_the_room_to_stop_counts(
    timeout_s: float, watchdog_s: float, period_s: float, attached: str, protocol: str
) -> None:
    """Answers, or requests, that are as late as the driver bears, in every order: none alone need be late."""
    e = experiment(timeout_s, watchdog_s, attached, protocol, period_s)
    bench = bench_of(e, protocol)
    bench.opened()
    driver, longest_s = bench.driver, 0.0
    for seed in range(SEEDS):
        driver.arm(bench.limits)
        bench.bus.bus.disturbance = late = LateBus(
            lambda: driver._waits.left_s(bench.bus.now_s()), QUICK_S, timeout_s, seed
        )
        reaction_s = longest_reaction_s(driver, bench.bus, late, e.period_s, reaction_periods(e.device), 1.0)
        longest_s = max(longest_s, reaction_s)
        bench.bus.bus.disturbance = None
        assert driver.safe_stop()
    by_guard_s, in_sum_s = counted_s(e)
    assert longest_s <= min(by_guard_s, in_sum_s) + SLACK_S
    assert longest_s >= in_sum_s - 2.0 * e.period_s  # and it rides over what there is room for
    assert ("lost reply" in stopping_sum(e.device)) == (protocol == "feetech")


def test_no_answer_is_awaited_longer_than_the_breakaway_check_counts() -> None:
    """It counts the time that it arms the device with: a stroke is longer by so much."""
    assert longest_wait_s(bench_of(experiment()), 0.02) <= 0.02 + SLACK_S


@pytest.mark.parametrize(("late", "protocol"), [
    ("the answer", "feetech"), ("the host", "feetech"), ("the host", "dynamixel"),
])  # fmt: skip
@pytest.mark.parametrize(("late_s", "ends"), [
    ([0.045], False), ([0.015], False), ([0.014] * 3, False), ([0.02] * 9, True), ([0.03, 0.0] * 3, True),
    ([0.025, 0.0, 0.0, 0.0, 0.0, 0.0] * 3, False),
])  # fmt: skip
def test_late_answers_end_a_run_only_where_together_they_take_longer_than_one_may(
    late_s: list[float], ends: bool, late: str, protocol: str
) -> None:
    """A host that stood still for 15 ms ended a run. All of them fall into the time in which a loop reacts."""
    bench, coming = Bench(protocol), list(late_s)
    bench.armed()
    bench.tick(1.0)
    real = bench.bus.write

    def stands_still(data: bytes) -> None:
        real(data)
        bench.bus.sleep_until(bench.bus.now_s() + (coming.pop(0) if coming else 0.0))

    if late == "the host":
        bench.bus.write = stands_still  # type: ignore[method-assign]  # of this bus alone
    else:
        bench.bus.bus.disturbance = lambda direction, data, _: (
            [(coming.pop(0) if coming and direction == "reply" else 0.0, data)]
        )
    fault = bench.fault_within(12, 1.0)
    assert (fault is not None and fault.code == "LINK_TIMEOUT") if ends else fault is None


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_whose_answers_are_often_late_runs_on(seed: int) -> None:
    """A fifth of them come 2 to 8 ms late, as behind a busy USB: nine runs of ten ended."""
    bench, rng = bench_of(experiment(attached="joint")), random.Random(seed)
    bench.armed()
    bench.bus.bus.disturbance = lambda direction, data, _: (
        [(rng.uniform(0.002, 0.008) if direction == "reply" and rng.random() < 0.2 else 0.0, data)]
    )
    assert all(bench.fault_within(1, 1.0 if k % 2 else -1.0) is None for k in range(300))


@pytest.mark.parametrize("happens", [alert, protects, torque_off])
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_question_about_what_a_reading_shows_waits_no_longer_than_its_tick(
    protocol: str, happens: Callable[[Bench], None]
) -> None:
    """The servo answers that it is not well, and nothing more; its last drive acts on meanwhile."""
    e = experiment(attached="joint", protocol=protocol)
    bench = bench_of(e, protocol)
    bench.armed()
    bench.tick(1.0)
    bench.tick(1.0)
    happens(bench)
    for _ in range(4):
        begun_s, heard = bench.bus.now_s(), len(bench.bus.bus.log)
        bench.bus.bus.disturbance = lambda direction, data, _, heard=heard: (
            [(0.0, data)] if direction == "request" or len(bench.bus.bus.log) == heard + 1 else []
        )
        if (fault := bench.fault_within(1, 1.0)) is not None:
            break
        bench.bus.bus.disturbance = None
    assert fault is not None and bench.bus.now_s() - begun_s <= bench.driver._waits.longest_s + SLACK_S


@pytest.mark.parametrize(("stands_s", "ends"), [
    ([0.045], False), ([0.008] * 9, False), ([0.025, 0.0, 0.0, 0.0] * 3, False),
    ([0.045] * 9, True), ([0.028] * 9, True),
])  # fmt: skip
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_host_that_stands_still_between_exchanges_again_and_again_ends_the_run(
    stands_s: list[float], ends: bool, protocol: str
) -> None:
    """Each tick 45 ms late, where 60 were counted for all: it drove on, and reacted within 196 ms for 100."""
    bench, faults = Bench(protocol), []
    bench.armed()
    for host_s in [0.0, *stands_s, 0.0]:
        faults.append(bench.fault_within(1, 1.0))
        bench.bus.sleep_until(bench.bus.now_s() + host_s)
    if not ends:
        assert not any(faults)
        return
    late = next(k for k, fault in enumerate(faults) if fault is not None)
    assert str(faults[late]).startswith("LATE") and sum(stands_s[: late - 2]) <= bench.driver._waits.longest_s


@pytest.mark.parametrize("late", ["the next drive", "a question behind a late drive"])
def test_a_servo_whose_watchdog_readings_keep_quiet_is_driven_and_asked_no_more_once_ticks_came_too_late(
    late: str,
) -> None:
    """Its last drive was older than the watchdog bears, so nothing was late: it drove for 300 ms beyond what counts."""
    bench = bench_of(experiment(protocol="dynamixel"), "dynamixel")
    bench.armed()
    bench.tick(1.0)
    bus, driver, real = bench.bus, bench.driver, bench.bus.write
    driver.read()
    if late == "the next drive":
        driver.write(1.0)
        bus.sleep_until(bus.now_s() + 0.045)
        driver.read()
        bus.sleep_until(bus.now_s() + 0.04)
    else:
        bus.sleep_until(bus.now_s() + 0.03)

        def stands_still(data: bytes) -> None:
            real(data)
            bus.sleep_until(bus.now_s() + 0.045)

        bus.write = stands_still  # type: ignore[method-assign]  # of this bus alone
    heard = len(bus.bus.log)
    with pytest.raises(Fault, match="all that `rig check` counts"):
        driver.write(-1.0)
    assert len(bus.bus.log) == heard + (late != "the next drive")


def test_a_host_that_stood_still_behind_its_question_takes_no_servo_for_restarted() -> None:
    """Its clock went on by 10 ms, the host's by 139: for longer than a restart is told by."""
    bench = bench_of(experiment(watchdog_s=0.2, protocol="dynamixel"), "dynamixel")
    bench.armed()
    bench.tick(1.0)
    bench.tick(-1.0)
    real = bench.bus.write

    def stands_still(data: bytes) -> None:
        bench.bus.write = real  # type: ignore[method-assign]  # of this bus alone
        real(data)
        bench.bus.sleep_until(bench.bus.now_s() + 0.13)

    bench.bus.write = stands_still  # type: ignore[method-assign]
    assert bench.fault_within(10, 1.0) is None


def test_a_further_look_at_a_late_drive_ends_no_run_that_has_little_time_left() -> None:
    """It waited for what was left, 0.09 ms, and its answer came later."""
    bench = bench_of(experiment(protocol="dynamixel"), "dynamixel")
    bench.armed()
    bench.tick(1.0)
    bench.driver.read()
    bus, waits, real = bench.bus, bench.driver._waits, bench.bus.write

    def stands_still(data: bytes) -> None:
        bus.write = real  # type: ignore[method-assign]  # of this bus alone
        real(data)
        bus.sleep_until(waits._begun_s + waits.longest_s - 1e-4)

    bus.sleep_until(bus.now_s() + 0.03)
    bus.write = stands_still  # type: ignore[method-assign]
    bench.driver.write(-1.0)
    assert bench.fault_within(5, 1.0) is None
