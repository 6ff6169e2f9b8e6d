"""How long a driver awaits an answer is what preflight counts into the room to stop, whatever the config says."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
from servo_bench import Bench

from rig.backends.servo.line import setup_of
from rig.config.schema import Experiment
from rig.core.faults import Fault
from rig.running.preflight.loop_settings import guard_settings_of
from rig.running.preflight.room_to_stop import device_watchdog_s, reaction_s, stopping_rad, stopping_sum

SLACK_S = 1e-6


def experiment(
    timeout_s: float = 0.01, watchdog_s: float = 0.06, attached: str = "nothing", protocol: str = "feetech"
) -> Experiment:
    e = Bench(protocol).e
    assert e.daq.servo is not None
    servo = e.daq.servo.model_copy(update={"attached": attached, "supply_switch": "the red one"})
    daq = {"timeout_s": timeout_s, "watchdog_s": watchdog_s, "servo": servo}
    return e.model_copy(update={"daq": e.daq.model_copy(update=daq)})


def bench_of(e: Experiment, protocol: str = "feetech") -> Bench:
    bench = Bench(protocol)
    bench.e, bench.setup = e, setup_of(e.device)
    bench.another()
    return bench


def counted_s(e: Experiment) -> tuple[float, float]:
    """For how long one lost reply lets a drive act on, as guard and sum of the room to stop count it, s."""
    d = e.device
    beside_s = reaction_s(d) + (device_watchdog_s(d) or 0.0)
    coasting_s = d.limits.coast_tau_s
    in_sum_s = stopping_rad(d) / d.limits.max_speed_rad_s - beside_s - coasting_s
    return guard_settings_of(e).reaction_s - beside_s, in_sum_s


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


@pytest.mark.parametrize("timeout_s", [0.004, 0.01])
@pytest.mark.parametrize("watchdog_s", [0.03, 0.06, 0.2])
@pytest.mark.parametrize("attached", ["nothing", "load", "joint"])
def test_no_answer_is_awaited_longer_than_the_room_to_stop_counts(
    timeout_s: float, watchdog_s: float, attached: str
) -> None:
    e = experiment(timeout_s, watchdog_s, attached)
    by_guard_s, in_sum_s = counted_s(e)
    wait_s = longest_wait_s(bench_of(e))
    assert wait_s <= by_guard_s + SLACK_S and wait_s <= in_sum_s + SLACK_S
    assert wait_s >= (timeout_s if attached == "joint" else min(watchdog_s, 0.1) - e.period_s)
    assert ("lost reply" in stopping_sum(e.device)) == (attached != "joint")


def test_a_joint_is_awaited_for_one_time_out_alone() -> None:
    """It could meet its stop meanwhile."""
    assert longest_wait_s(bench_of(experiment(attached="joint"))) <= 0.01 + SLACK_S


def test_no_answer_is_awaited_longer_than_the_breakaway_check_counts() -> None:
    """It counts the time that it arms the device with: a stroke is longer by so much."""
    assert longest_wait_s(bench_of(experiment()), 0.02) <= 0.02 + SLACK_S


@pytest.mark.parametrize("late", ["the answer", "the host"])
@pytest.mark.parametrize(("late_s", "ends"), [
    ([0.045], False), ([0.015], False), ([0.014] * 3, False), ([0.014] * 5, True), ([0.025, 0.0] * 3, True),
    ([0.025, 0.0, 0.0, 0.0, 0.0, 0.0] * 3, False),
])  # fmt: skip
def test_late_answers_end_a_run_only_where_together_they_take_longer_than_one_may(
    late_s: list[float], ends: bool, late: str
) -> None:
    """A host that stood still for 15 ms ended a run. All of them fall into the time in which a loop reacts."""
    bench, coming = Bench("feetech"), list(late_s)
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
