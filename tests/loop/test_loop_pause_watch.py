"""What a driver whose device latches no e-stop is asked in a pause."""

from __future__ import annotations

import threading

import pytest
from processes import PATIENCE_S
from raised import fault_of
from simulated_bench import LIMITS, PERIOD_S, simulated_bench

from rig.backends.clock import MonotonicClock, VirtualClock
from rig.control.law import Rest
from rig.control.loop.pause_watch import VIRTUAL_PAUSE_S, PauseWatch
from rig.core.faults import Fault
from rig.core.signals import Sample

RAILS = (5, 1018)


class Device:
    """A driver that counts readings, and may have something to say at one of them."""

    latches_stops = False
    counts = 512

    def __init__(self, fault: Exception | None = None, at: int = 5) -> None:
        self.readings = 0
        self.enough = threading.Event()
        self._fault, self._at = fault, at

    def read(self) -> Sample:
        self.readings += 1
        if self.readings >= self._at:
            self.enough.set()
            if self._fault is not None:
                raise self._fault
        return Sample(0.0, 0.0, self.counts)


def watch(device: Device, *, real: bool = False) -> PauseWatch:
    return PauseWatch(device, MonotonicClock() if real else VirtualClock(), 0.01, RAILS)  # type: ignore[arg-type]  # it only reads


def test_in_virtual_time_it_is_read_each_period_of_a_pause() -> None:
    device = Device()
    pause = watch(device)
    pause.end()  # none has begun
    assert device.readings == 0
    pause.begin()
    pause.end()
    assert device.readings == round(VIRTUAL_PAUSE_S / 0.01)
    pause.end()
    assert device.readings == round(VIRTUAL_PAUSE_S / 0.01)
    assert pause.longest_gap_s == 0.0


def test_a_fault_in_virtual_time_ends_the_pause() -> None:
    pause = watch(Device(Fault("DEVICE_ESTOP")))
    pause.begin()
    assert fault_of(pause.end).code == "DEVICE_ESTOP"


@pytest.mark.parametrize("counts", [5, 1018])
def test_a_sensor_at_its_rail_ends_the_pause(counts: int) -> None:
    device = Device()
    device.counts = counts
    pause = watch(device)
    pause.begin()
    assert fault_of(pause.end).code == "SENSOR_RAIL"
    assert device.readings == 1


def test_in_real_time_it_is_read_meanwhile_and_left_alone_afterwards() -> None:
    device = Device(at=10)
    pause = watch(device, real=True)
    pause.begin()
    assert device.enough.wait(PATIENCE_S)
    pause.end()
    readings = device.readings
    assert threading.active_count() == 1 or not any(t.name == "pause watch" for t in threading.enumerate())
    assert pause.longest_gap_s > 0.0
    pause.begin()  # the next pause
    pause.give_up()
    pause.give_up()
    assert device.readings >= readings


@pytest.mark.parametrize(
    ("seen", "code"), [(Fault("DEVICE_ESTOP"), "DEVICE_ESTOP"), (ZeroDivisionError("a defect"), "INTERNAL")]
)
def test_what_is_seen_in_real_time_is_raised_before_anything_arms(seen: Exception, code: str) -> None:
    device = Device(seen)
    pause = watch(device, real=True)
    pause.begin()
    assert device.enough.wait(PATIENCE_S)
    pause.give_up()
    assert device.readings == 5  # and it is not asked again
    assert fault_of(pause.check).code == code
    assert fault_of(pause.end).code == code


def test_a_device_that_latches_is_left_alone() -> None:
    device = Device()
    device.latches_stops = True
    pause = watch(device, real=True)
    pause.begin()
    pause.end()
    assert device.readings == 0


def test_nobody_else_uses_the_driver_after_the_pause() -> None:
    """The reading that is under way when the pause ends is waited for: a driver knows one user at a time."""
    entered, go_on = threading.Event(), threading.Event()

    class Slow(Device):
        def read(self) -> Sample:
            entered.set()
            go_on.wait(PATIENCE_S)
            return super().read()

    device = Slow()
    pause = watch(device, real=True)
    pause.begin()
    assert entered.wait(PATIENCE_S)
    threading.Timer(0.05, go_on.set).start()
    pause.end()
    assert device.readings == 1 and pause.longest_gap_s > 0.0


def test_a_pause_begins_where_a_block_that_is_armed_has_ended() -> None:
    bench = simulated_bench()
    with bench.loop.armed(LIMITS):
        bench.loop.run(Rest(0.05), "rest")
    before_s, readings, read = bench.loop.now_s, [0], bench.driver.read

    def counted() -> Sample:
        readings[0] += 1
        return read()

    bench.driver.read = counted  # type: ignore[method-assign]  # for this test
    bench.loop.pause_watch.end()
    assert readings[0] == round(VIRTUAL_PAUSE_S / PERIOD_S)
    assert bench.loop.now_s - before_s == pytest.approx(VIRTUAL_PAUSE_S, abs=PERIOD_S)
