"""The loop on an absolute grid: skips, true times, row semantics, and every end is a safe stop."""

from __future__ import annotations

import math
import os
import signal
from array import array
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import ParamSpec, TypeVar

import pytest
from simulated_bench import DEMO, GUARD, LIMITS, PERIOD_S, SCALING, BenchModel, ListSink, simulated_bench

from rig.backends.clock import MonotonicClock, VirtualClock
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.control.guard import Guard
from rig.control.law import Constant, Rest
from rig.control.loop.runner import Loop
from rig.control.loop.statistics import LoopStatistics, Times, quantiles
from rig.control.loop.stop_request import StopRequest, stop_on_signals
from rig.core.faults import Fault
from rig.core.signals import FLAG_SATURATED, FLAG_SKIPPED, Sample
from rig.run_folder.live.running import running
from rig.run_folder.live.stop_flag import StopFlag

P = ParamSpec("P")
R = TypeVar("R")


class Stalling:
    """0.3 V, and at chosen ticks the law itself takes too long."""

    z_rad_s = yd_rad = math.nan
    finished = False

    def __init__(self, bench: BenchModel, stalls_s: dict[int, float], ticks: int) -> None:
        self.bench, self.stalls_s, self.ticks, self.n = bench, stalls_s, ticks, 0

    def step(self, sample: Sample) -> float:
        clock = self.bench.clock
        clock.sleep_until(clock.now_s() + self.stalls_s.get(self.n, 0.0))
        self.n += 1
        self.finished = self.n >= self.ticks
        return 0.3


def test_ticks_lie_on_the_grid_and_late_ones_are_skipped_and_counted_never_caught_up() -> None:
    bench = simulated_bench()
    with bench.loop.armed(LIMITS):
        bench.loop.run(Stalling(bench, {10: 0.035, 20: 0.012}, 40), "jog")
    rows = bench.record.rows
    ticks = [row["tick"] for row in rows]
    skipped = [t for t in range(ticks[0], ticks[-1]) if t not in ticks]
    assert skipped == [ticks[10] + 1, ticks[10] + 2, ticks[10] + 3, ticks[20] + 1]
    assert bench.loop.statistics.skipped == 4
    assert [k for k, row in enumerate(rows) if row["flags"] & FLAG_SKIPPED] == [11, 21]
    for row in rows:
        # the grid never shifts: each row was sampled at its own tick's time
        assert row["t_s"] == pytest.approx(row["tick"] * PERIOD_S, abs=1e-9)
        assert row["late_us"] == pytest.approx(0.0, abs=1e-3)


def test_a_row_holds_the_drive_that_acts_from_its_effect_time_on() -> None:
    bench = simulated_bench()
    with bench.loop.armed(LIMITS):
        bench.loop.run(Constant(0.305, 0.1), "jog")
        bench.loop.run(Rest(0.05), "rest")
    rows = bench.record.rows
    for row in rows:
        assert 0.0008 < row["t_u_s"] - row["t_s"] < 0.0016
    # quantised as the device applies it: 799 steps of 12 V
    assert rows[3]["u_V"] == pytest.approx(20 * 12 / 799)
    assert rows[3]["asked_V"] == 0.305
    assert rows[-1]["u_V"] == 0.0


def test_a_drive_that_acts_otherwise_than_asked_is_flagged_unless_it_was_lost() -> None:
    """The device may clip it; of one that never arrived the effect time tells, and the one before still acts."""
    bench = simulated_bench()
    read, ticks = bench.driver.read, [0]

    def odd() -> Sample:
        ticks[0] += 1
        sample = read()
        if ticks[0] == 5:
            return sample._replace(u_V=0.1)
        if ticks[0] == 8:
            return sample._replace(u_V=0.1, t_u_s=sample.t_u_s - PERIOD_S)
        return sample

    bench.driver.read = odd  # type: ignore[method-assign]  # for this test
    with bench.loop.armed(LIMITS):
        bench.loop.run(Constant(0.3, 0.12), "jog")
    assert [k for k, row in enumerate(bench.record.rows) if row["flags"] & FLAG_SATURATED] == [3]
    assert [k for k, row in enumerate(bench.record.rows) if row["u_V"] == 0.1] == [3, 6]


def test_a_signal_that_comes_during_a_look_is_not_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a hundred Ctrl-C while the demo began some two were lost: the run went on to its end."""
    request = StopRequest(StopFlag.unseen())

    def interrupted() -> str:
        request(signal.SIGINT, None)
        return ""

    monkeypatch.setattr(request.flag, "asked_by", interrupted)
    assert request.look() == "SIGINT" and request.reason == "SIGINT"
    request = StopRequest(gone=interrupted)
    assert request.look() == "SIGINT"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP])
def test_signals_end_in_a_safe_stop_and_handlers_come_back(number: signal.Signals) -> None:
    bench = simulated_bench()
    before = signal.getsignal(number)
    with stop_on_signals() as request, pytest.raises(Fault) as caught:
        bench.loop._stop = request

        def watch(t_s: float) -> None:
            if t_s > 0.2 and request.reason is None:
                assert bench.driver.bench.pin_counts != 0 or t_s < 0.3
                os.kill(os.getpid(), number)

        with bench.loop.armed(LIMITS):
            bench.loop.run(Constant(0.3, 5.0), "jog", watch)
    assert caught.value.code == "INTERRUPTED"
    assert caught.value.detail == number.name
    assert bench.driver.bench.pin_counts == 0
    assert bench.record.events[-1]["kind"] == "stop"
    assert bench.loop.now_s < 0.4
    assert signal.getsignal(number) is before


def test_any_exception_of_a_law_ends_in_a_safe_stop() -> None:
    class Broken(Constant):
        def step(self, sample: Sample) -> float:
            if sample.t_s > 0.1:
                raise ZeroDivisionError("a bug in a law")
            return 0.3

    bench = simulated_bench()
    with pytest.raises(ZeroDivisionError), bench.loop.armed(LIMITS):
        bench.loop.run(Broken(0.3, 1.0), "jog")
    assert bench.driver.bench.pin_counts == 0
    assert bench.driver.bench.motor_V == 0.0


def test_the_reading_that_ended_the_run_is_the_records_last_row() -> None:
    class Failing(Constant):
        def step(self, sample: Sample) -> float:
            return math.nan if sample.t_s > 0.115 else 0.3

    bench = simulated_bench()
    with pytest.raises(Fault, match="LAW_FAILED"), bench.loop.armed(LIMITS):
        bench.loop.run(Failing(0.3, 1.0), "jog")
    *_, before, last = bench.record.rows
    assert last["t_s"] == pytest.approx(0.12) and last["u_V"] == 0.0 and last["t_u_s"] is None
    assert before["t_s"] == pytest.approx(0.11) and before["t_u_s"] is not None


def test_a_clock_that_goes_back_is_a_reset() -> None:
    """The reading is in no row: a record whose time goes back cannot be read."""
    bench = simulated_bench()
    read = bench.driver.read
    bench.driver.read = lambda: (  # type: ignore[method-assign]  # for this test
        sample._replace(t_s=sample.t_s - 1.0) if (sample := read()).t_s > 0.2 else sample
    )
    with pytest.raises(Fault, match="DEVICE_RESET"), bench.loop.armed(LIMITS):
        bench.loop.run(Constant(0.3, 5.0), "jog")
    times = [row["t_s"] for row in bench.record.rows]
    assert times == sorted(times) and times[-1] > 0.15
    assert bench.driver.bench.pin_counts == 0


def test_a_dead_recorder_ends_the_run() -> None:
    bench = simulated_bench()

    def dead() -> None:
        if bench.loop.now_s > 0.5:
            raise Fault("RECORDER_DEAD", "test")

    bench.record.check = dead  # type: ignore[method-assign]  # for this test
    with pytest.raises(Fault, match="RECORDER_DEAD"), bench.loop.armed(LIMITS):
        bench.loop.run(Constant(0.3, 5.0), "jog")
    assert bench.loop.now_s < 1.0
    assert bench.driver.bench.pin_counts == 0


def test_the_grid_goes_on_after_a_pause_between_two_armings() -> None:
    bench = simulated_bench()
    with bench.loop.armed(LIMITS):
        bench.loop.run(Rest(0.1), "rest")
    bench.clock.sleep_until(bench.clock.now_s() + 1.2345)
    with bench.loop.armed(LIMITS):
        bench.loop.run(Rest(0.1), "rest")
    assert bench.loop.statistics.skipped == 0
    times = [row["t_s"] for row in bench.record.rows]
    assert times == sorted(times)
    assert bench.record.rows[-1]["t_s"] == pytest.approx(bench.record.rows[-1]["tick"] * PERIOD_S, abs=1e-9)


def test_a_stand_before_a_pause_is_none_after_it() -> None:
    """The guard forgets what it saw before: else the pause would count as a stand under the drive."""
    bench = simulated_bench()
    bench.guard.static_V = 0.2  # so that a drive that moves nothing counts
    for _ in range(2):
        with bench.loop.armed(LIMITS):
            bench.loop.run(Stalling(bench, {}, 20), "jog")  # it drives to its end
        bench.clock.sleep_until(bench.clock.now_s() + 1.0)


def test_quantiles_are_values_that_occurred() -> None:
    values = array("d", [float(k) for k in range(1, 1001)])
    assert quantiles(values) == {"p50": 500.0, "p99": 990.0, "p999": 999.0, "max": 1000.0}
    assert quantiles(array("d")) == {"p50": None, "p99": None, "p999": None, "max": None}
    statistics = LoopStatistics()
    statistics.tick(3.0, 200.0)
    assert statistics.summary(0.01).as_json()["late_us"] == {"p50": 3.0, "p99": 3.0, "p999": 3.0, "max": 3.0}


def test_each_part_of_a_tick_is_told_by_its_own_time() -> None:
    """Reading takes 1 ms, the law 2, writing 3, the record's row 0.5."""
    bench = simulated_bench()
    clock = bench.clock

    def takes(what: Callable[P, R], time_s: float) -> Callable[P, R]:
        def slow(*given: P.args, **named: P.kwargs) -> R:
            clock.sleep_until(clock.now_s() + time_s)
            return what(*given, **named)

        return slow

    bench.driver.read = takes(bench.driver.read, 1e-3)  # type: ignore[method-assign]  # for this test
    bench.driver.write = takes(bench.driver.write, 3e-3)  # type: ignore[method-assign]  # for this test
    bench.record.sample = takes(bench.record.sample, 0.5e-3)  # type: ignore[method-assign]  # for this test
    with bench.loop.armed(LIMITS):
        bench.loop.run(Stalling(bench, dict.fromkeys(range(20), 2e-3), 20), "jog")
    told = bench.loop.summary().as_json()
    assert (told["ticks"], told["skipped"]) == (20, 0)
    for part, time_us in (
        ("io_us", 1000),
        ("compute_us", 2000),
        ("write_us", 3000),
        ("record_us", 500),
        ("late_us", 0),
    ):
        assert told[part] == pytest.approx(dict.fromkeys(("p50", "p99", "p999", "max"), time_us), abs=2.0), part


def test_times_of_an_endless_run_keep_the_last_and_the_largest() -> None:
    times = Times(kept=100)
    for k in range(1000):
        times.add(5000.0 if k == 10 else float(k))
    assert times.count == 1000
    assert times.quantiles().as_json() == {"p50": 949.0, "p99": 998.0, "p999": 999.0, "max": 5000.0}
    assert len(times._last) == 100


def test_clocks_never_wake_early_and_never_run_backwards() -> None:
    for clock in (MonotonicClock(), VirtualClock()):
        last = clock.now_s()
        for _ in range(20):
            due = clock.now_s() + 0.001
            clock.sleep_until(due)
            assert clock.now_s() >= due - 1e-9
            assert clock.now_s() >= last
            last = clock.now_s()
        clock.sleep_until(last - 1.0)  # the past: returns at once


def test_in_real_time_nothing_drives_that_no_stop_knows_of(tmp_path: Path) -> None:
    for flag, may in ((None, False), (StopFlag(), False), (StopFlag.unseen(), True)):
        clock = MonotonicClock()
        driver = SimulatedDriver(clock, DEMO, SCALING, SimulatedLatency(0.001, 0.0), 1)
        driver.open()
        loop = Loop(driver, clock, Guard(GUARD), ListSink(), PERIOD_S, StopRequest(flag))
        with nullcontext() if may else pytest.raises(ValueError, match="no stop flag"), loop.armed(LIMITS):
            pass
        loop.close()


@pytest.mark.parametrize("confirms", [True, False])
def test_a_stop_that_the_device_does_not_confirm_is_not_told_as_0_V(tmp_path: Path, confirms: bool) -> None:
    clock = VirtualClock()
    driver = SimulatedDriver(clock, DEMO, SCALING, SimulatedLatency(0.001, 0.0), 1)
    driver.open()
    with StopFlag() as flag:
        flag.open(tmp_path, "home")
        loop = Loop(driver, clock, Guard(GUARD), ListSink(), PERIOD_S, StopRequest(flag))
        driver.safe_stop = lambda: confirms  # type: ignore[method-assign]  # of this driver alone
        with nullcontext() if confirms else pytest.raises(Fault, match="STOP_UNCONFIRMED"), loop.armed(LIMITS):
            assert [one.runner.drives for one in running(tmp_path)] == [True]
        assert [one.runner.drives for one in running(tmp_path)] == [not confirms]
        loop.close()
