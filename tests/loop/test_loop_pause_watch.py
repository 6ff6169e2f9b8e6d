"""The pauses of a run, on a device that latches no e-stop by itself: it is read throughout, and then left alone."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest
from simulated_bench import LIMITS, PERIOD_S, simulated_bench

from rig.control.law import Rest
from rig.faults import Fault
from rig.loop.clock import MonotonicClock, VirtualClock
from rig.loop.pause_watch import VIRTUAL_PAUSE_S, PauseWatch
from rig.signals import Sample


class Card:
    """Reads, and tells who read it; from its n-th reading on the e-stop is seen."""

    def __init__(self, *, latches: bool = False, opens_at: int = 10**9) -> None:
        self.latches_stops, self.opens_at = latches, opens_at
        self.readers: list[threading.Thread] = []

    def read(self) -> Sample:
        self.readers.append(threading.current_thread())
        if len(self.readers) >= self.opens_at:
            raise Fault("DEVICE_ESTOP", "seen")
        return Sample(0.0, 0.0, 512)


def wait_until(true: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 20.0
    while not true():
        assert time.monotonic() < deadline_s, "nothing happened"
        time.sleep(0.001)


def test_a_device_that_latches_nothing_is_read_throughout_a_pause() -> None:
    bench = simulated_bench()
    for _ in range(2):
        with bench.loop.armed(LIMITS):
            bench.loop.run(Rest(0.05), "rest")
        before_s, ticks, read = bench.loop.now_s, [0], bench.driver.read

        def counted() -> Sample:
            ticks[0] += 1  # noqa: B023 -- called before the next round
            return read()  # noqa: B023

        bench.driver.read = counted  # type: ignore[method-assign]
        bench.loop.pause_watch.end()
        bench.driver.read = read  # type: ignore[method-assign]
        assert ticks[0] == round(VIRTUAL_PAUSE_S / PERIOD_S)
        assert bench.loop.now_s - before_s == pytest.approx(VIRTUAL_PAUSE_S, abs=PERIOD_S)


@pytest.mark.parametrize("latches", [True, False])
def test_one_that_latches_is_left_alone_and_so_is_any_before_the_first_pause(latches: bool) -> None:
    card = Card(latches=latches)
    watch = PauseWatch(card, VirtualClock(), PERIOD_S)  # type: ignore[arg-type]
    watch.end()
    assert card.readers == []
    watch.begin()
    watch.end()
    assert bool(card.readers) is not latches
    assert watch.longest_gap_s == 0.0  # in virtual time none is missed


def test_what_a_pause_shows_ends_the_run() -> None:
    clock = VirtualClock()
    watch = PauseWatch(Card(opens_at=7), clock, PERIOD_S)  # type: ignore[arg-type]
    watch.begin()
    with pytest.raises(Fault, match="DEVICE_ESTOP"):
        watch.end()
    assert clock.now_s() == pytest.approx(7 * PERIOD_S)


def test_in_real_time_it_is_seen_while_the_pause_lasts_and_stays_seen() -> None:
    card = Card(opens_at=3)
    watch = PauseWatch(card, MonotonicClock(), 0.001)  # type: ignore[arg-type]
    watch.begin()

    def told() -> bool:
        try:
            watch.check()
        except Fault as fault:
            return fault.code == "DEVICE_ESTOP"
        return False

    wait_until(told)
    assert threading.current_thread() not in card.readers
    for _ in range(2):
        with pytest.raises(Fault, match="DEVICE_ESTOP"):
            watch.end()


def test_nobody_else_uses_the_driver_after_the_pause() -> None:
    """The reading that is under way when the pause ends is waited for: a driver knows one user at a time."""
    entered, go_on = threading.Event(), threading.Event()

    class Slow(Card):
        def read(self) -> Sample:
            entered.set()
            go_on.wait(20.0)
            return super().read()

    card = Slow()
    watch = PauseWatch(card, MonotonicClock(), 0.001)  # type: ignore[arg-type]
    watch.begin()
    assert entered.wait(20.0)
    threading.Timer(0.05, go_on.set).start()
    watch.end()
    assert len(card.readers) == 1 and not card.readers[0].is_alive()
    watch.give_up()
