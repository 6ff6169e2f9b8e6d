"""The machine is suspended in a run: its clock stands still, the device's goes on.

On the compiled firmware, in virtual time. 35 minutes on, half of the device's 32-bit microseconds, its time could be
taken for an earlier one.
"""

from __future__ import annotations

import time

import pytest
from evidence import one_of_each
from raised import fault_of
from simulated_bench import DEMO, GUARD, LIMITS, PERIOD_S, SCALING, ListSink

from rig.backends import clock as clocks
from rig.backends.clock import MonotonicClock
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.control.guard import Guard
from rig.control.law import Constant, Rest
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.loop.suspend import EXPLAINED, SuspendWatch
from rig.core.faults import Fault

MINUTES = 60.0
WRAPS_SOON = 2**32 - 30_000_000  # of a device's clock, us
LONGEST_S = 71.6 * MINUTES  # then the device's clock wraps


class SleepyHost:
    """Port and clock of a host whose machine sleeps: its time is the device's, without what it has slept."""

    absolute = True

    def __init__(self, board: VirtualBoard) -> None:
        self.board = board
        self._asleep_s = 0.0

    def suspend(self, for_s: float) -> None:
        self.board.sleep_until(self.board.now_s() + for_s)
        self._asleep_s += for_s

    def asleep_s(self) -> float:
        return self._asleep_s

    def now_s(self) -> float:
        return self.board.now_s() - self._asleep_s

    def sleep_until(self, t_s: float) -> float:
        return max(self.board.sleep_until(t_s + self._asleep_s) - self._asleep_s, t_s)  # but for rounding

    def write(self, data: bytes) -> None:
        self.board.write(data)

    def read(self, timeout_s: float) -> bytes:
        return self.board.read(timeout_s)

    def close(self) -> None:
        self.board.close()


def bench(clock_start_us: int = 0) -> tuple[SleepyHost, Loop, ListSink]:
    host = SleepyHost(VirtualBoard(DEMO, clock_error_ppm=4000, clock_start_us=clock_start_us))
    driver = SerialDriver(host, SCALING)
    driver.open()
    record = ListSink()
    return host, Loop(driver, host, Guard(GUARD), record, PERIOD_S, StopRequest()), record


@pytest.mark.parametrize(
    ("for_s", "clock_start_us"),
    one_of_each((5.0, WRAPS_SOON), (34.0 * MINUTES, 0), (37.0 * MINUTES, WRAPS_SOON), (LONGEST_S, 0)),
)
def test_a_suspend_in_a_pause_ends_the_run_before_anything_drives(for_s: float, clock_start_us: int) -> None:
    host, loop, record = bench(clock_start_us)
    with loop.armed(LIMITS):
        loop.run(Rest(0.05), "rest")
    rows = len(record.rows)
    host.suspend(for_s)

    def go_on() -> None:
        with loop.armed(LIMITS):
            loop.run(Constant(0.3, 0.2), "jog")

    fault = fault_of(go_on)
    assert fault.code == "SUSPENDED" and f"for {for_s:.1f} s" in fault.detail
    assert len(record.rows) == rows  # none with a time that is off
    truth = host.board.truth()
    assert not truth.armed and truth.pin_V == 0.0


@pytest.mark.parametrize("for_s", [0.05, 5.0, 37.0 * MINUTES])
@pytest.mark.parametrize("at", ["after the write", "after the sleep", "in the reading"])
def test_a_suspend_while_armed_is_named_and_the_watchdog_has_stopped_the_drive(for_s: float, at: str) -> None:
    """Whatever the device then says: it was disarmed by its watchdog, or its time seems to go back."""
    host, loop, _ = bench()
    suspended: list[float] = []
    sleep_until, read = host.sleep_until, host.read

    def may_sleep(here: str) -> None:
        if at == here and host.now_s() > begun_s + 0.1 and not suspended:
            host.suspend(for_s)
            suspended.append(host.board.truth().pin_V)

    def sleepy(t_s: float) -> float:
        woke_s = sleep_until(t_s)
        may_sleep("after the sleep")
        return woke_s

    def sleepy_read(timeout_s: float) -> bytes:
        may_sleep("in the reading")
        return read(timeout_s)

    host.sleep_until, host.read = sleepy, sleepy_read  # type: ignore[method-assign]  # for this test
    begun_s = host.now_s()

    def drive() -> None:
        with loop.armed(LIMITS):
            loop.run(Constant(0.3, 1.0), "jog", lambda _: may_sleep("after the write"))

    fault = fault_of(drive)
    assert fault.code == "SUSPENDED" and f"for {for_s:.1f} s" in fault.detail
    assert (suspended == [0.0]) is (for_s > LIMITS.watchdog_s)  # at the pin, before the host was awake
    assert host.board.truth().pin_V == 0.0


def test_what_a_suspend_explains_is_said_with_it_and_nothing_else_is_hidden() -> None:
    host, _, _ = bench()
    watch = SuspendWatch(host)

    def after(code: str) -> Fault:
        def fails() -> None:
            with watch.told():
                raise Fault(code, "as it was")

        return fault_of(fails)

    assert after("DEVICE_RESET").code == "DEVICE_RESET"  # it was not suspended
    host.suspend(3.0)
    for code in EXPLAINED:
        assert after(code).code == "SUSPENDED" and f"then {code}" in after(code).detail
    for code in ("DEVICE_ESTOP", "DEVICE_TRAVEL", "TRAVEL_HARD", "POLARITY"):
        assert after(code).code == code


def test_the_machines_clock_tells_a_suspend_by_the_clock_that_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both clocks of the system, in one test; preemption between two readings of them is no suspend."""
    now, asleep_s, preempted_s = [100.0], [7.0], [0.0]

    def monotonic() -> float:
        now[0] += preempted_s[0]
        return now[0]

    def boot(_: int) -> float:
        now[0] += preempted_s[0]
        return now[0] + asleep_s[0]

    monkeypatch.setattr(clocks, "_BOOTTIME", 7)
    monkeypatch.setattr(time, "monotonic", monotonic)
    monkeypatch.setattr(time, "clock_gettime", boot)
    for preempted_s[0] in (0.0, 0.6):
        before_s = preempted_s[0]
        clock = MonotonicClock()
        preempted_s[0] = 0.0  # only as the clock was made
        assert clock.asleep_s() == 0.0
        preempted_s[0] = before_s
        asleep_s[0] += 12.0
        assert 12.0 - 2.0 * preempted_s[0] <= clock.asleep_s() <= 12.0
    monkeypatch.setattr(clocks, "_BOOTTIME", None)
    assert MonotonicClock().asleep_s() == 0.0


def test_a_machine_that_is_awake_is_not_suspended() -> None:
    clock = MonotonicClock()
    SuspendWatch(clock).check()
    assert clock.asleep_s() == pytest.approx(0.0, abs=1e-3)
