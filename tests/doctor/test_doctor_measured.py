"""Ticks, wake-ups and margins, in virtual time and so exactly."""

from collections.abc import Callable

import pytest

from rig.backends.clock import VirtualClock
from rig.running.doctor import visit


class SleepyClock(VirtualClock):
    """Wakes late by the next of ``late_s``, again and again."""

    def __init__(self, late_s: tuple[float, ...]) -> None:
        super().__init__()
        self._late_s = late_s
        self._ticks = 0

    def sleep_until(self, t_s: float) -> float:
        self._ticks += 1
        return super().sleep_until(t_s + self._late_s[(self._ticks - 1) % len(self._late_s)])


def exchange_of(clock: VirtualClock, seconds: float) -> Callable[[], float]:
    return lambda: VirtualClock.sleep_until(clock, clock.now_s() + seconds)


def test_late_and_exchange_are_told_apart() -> None:
    clock = SleepyClock((0.0001, 0.0003))
    ticks = visit.run_ticks(clock, 0.01, 10, exchange_of(clock, 0.004))
    assert ticks.late_s == pytest.approx([0.0001, 0.0003] * 5, abs=1e-12)
    assert ticks.exchange_s == pytest.approx([0.004] * 10, abs=1e-12)
    assert ticks.skipped == 0
    assert ticks.longest_s == pytest.approx(0.0043)
    assert visit.verdict(ticks).state == "good"
    assert "margin 57 %" in visit.verdict(ticks).words


def test_an_exchange_longer_than_the_period_is_not_held_and_a_period_that_fits_is_proposed() -> None:
    clock = SleepyClock((0.0,))
    ticks = visit.run_ticks(clock, 0.01, 10, exchange_of(clock, 0.025))
    assert ticks.skipped == 2 * 10
    found = visit.verdict(ticks)
    assert found.state == "bad"
    assert "20 skipped" in found.words
    assert found.cure.startswith("period_s: 0.032 ")


def test_what_a_run_does_besides_reading_counts_for_the_period() -> None:
    """A reading of 5 ms says nothing good of a tick that also writes for 4 ms more."""
    clock = SleepyClock((0.0,))
    ticks = visit.run_ticks(clock, 0.01, 10, exchange_of(clock, 0.005))
    assert visit.verdict(ticks).state == "good"
    found = visit.verdict(ticks, 0.004)
    assert found.state == "poor"
    assert "by the config a tick that drives takes 4.00 ms more, margin 10 %" in found.words
    assert visit.verdict(ticks, 0.006).state == "bad"


def test_tight_is_said_before_it_breaks() -> None:
    clock = SleepyClock((0.0,))
    ticks = visit.run_ticks(clock, 0.01, 10, exchange_of(clock, 0.009))
    found = visit.verdict(ticks)
    assert found.state == "poor"
    assert "margin 10 %" in found.words
    assert found.cure.startswith("period_s: 0.012 "), "longer than the one that is tight"


def test_the_measured_round_trip_stands_beside_the_sum() -> None:
    clock = SleepyClock((0.0,))
    ticks = visit.run_ticks(clock, 0.02, 10, exchange_of(clock, 0.0062))
    good = visit.round_trip(ticks, 0.0062, "FC23 25 + 13 bytes = 3.45 ms, + 2.75 ms silences = 6.20 ms")
    assert good.state == "good"
    assert "6.20 / 6.20 / 6.20 ms" in good.words
    assert good.words.endswith("silences = 6.20 ms")
    slow = visit.round_trip(ticks, 0.002, "2.00 ms")
    assert slow.state == "poor"
    assert "latency timer" in slow.cure
    assert visit.round_trip(ticks, 0.0, "").state == "note"


def test_late_wake_ups_are_named() -> None:
    prompt = visit.run_ticks(SleepyClock((0.00005,)), 0.01, 20)
    late = visit.run_ticks(SleepyClock((0.00005, 0.002)), 0.01, 20)
    missed = visit.run_ticks(SleepyClock((0.00005, 0.012)), 0.01, 20)
    assert [visit.wake_ups(t).state for t in (prompt, late, missed)] == ["good", "poor", "bad"]
    assert "50 / 50 / 50 us" in visit.wake_ups(prompt).words
