"""Drives that act a period or more after their sample: what the rows say, and that identification needs no more."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from simulated_bench import DEMO, GUARD, LIMITS, PERIOD_S, SCALING, ListSink

from rig.backends.clock import VirtualClock
from rig.backends.simulated.driver import SimulatedDriver, SimulatedLatency
from rig.control.guard import Guard
from rig.control.law import Law
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.relay import DualChannelRelay
from rig.core.signals import FLAG_SATURATED, Order, Sample
from rig.identification import sampled_data
from rig.run_folder.recording.series import TimeSeries


class Steps:
    """A drive that changes its sign every 50 ms, for 2 s."""

    yd_rad = z_rad_s = math.nan
    finished = False

    def step(self, sample: Sample) -> float:
        self.finished = sample.t_s > 2.0
        return 0.3 if int(sample.t_s / 0.05) % 2 else -0.3


class Ended:
    """A law for so many ticks."""

    yd_rad = math.nan
    finished = False

    def __init__(self, law: Law, ticks: int) -> None:
        self._law, self._left = law, ticks
        self.z_rad_s = law.z_rad_s

    def step(self, sample: Sample) -> float:
        self._left -= 1
        self.finished = self._left <= 0
        u_V = self._law.step(sample)
        self.z_rad_s = self._law.z_rad_s
        return u_V


def relay_test(order: Order, latency_s: float) -> tuple[list[dict[str, Any]], Loop]:
    """Twelve cycles on the demo's motor; rows of a bench with this order and latency."""
    clock = VirtualClock()
    driver = SimulatedDriver(clock, DEMO, SCALING, SimulatedLatency(latency_s, 0.0), 1, order)
    guard = Guard(GUARD)
    guard.sign_proven = True
    record = ListSink()
    loop = Loop(driver, clock, guard, record, PERIOD_S, StopRequest())
    with loop.armed(LIMITS):
        loop.run(Ended(DualChannelRelay(0.45, 0.8, 1.0), 1200), "relay-1")
    return record.rows, loop


def test_a_drive_that_goes_out_with_the_next_exchange_may_act_late_in_that() -> None:
    """Later than a period, as an exchange takes its time: the loop measures it, for the observer."""
    clock = VirtualClock()
    latency = SimulatedLatency(0.0, 0.0)
    driver = SimulatedDriver(clock, DEMO, SCALING, latency, 1, "write_first")
    read = driver.read
    driver.read = lambda: (sample := read())._replace(t_u_s=sample.t_u_s + 0.003)  # type: ignore[method-assign]  # for this test
    loop = Loop(driver, clock, Guard(GUARD), ListSink(), PERIOD_S, StopRequest())
    with loop.armed(LIMITS):
        loop.run(Ended(DualChannelRelay(0.0, 0.0, 1.0), 20), "relay-1")
    assert loop.latency_s == pytest.approx(PERIOD_S + 0.003, abs=1e-9)


@pytest.mark.parametrize(("order", "latency_s"), [("write_first", 0.0), ("sample_first", 0.0172)])
def test_a_drive_that_acts_a_period_or_more_later_is_in_its_rows_and_identified_as_well(
    order: Order, latency_s: float
) -> None:
    """Same motor, same truth: the rows say when each drive acted, and that is all that identification needs."""
    at_once, _ = relay_test("sample_first", 0.0012)
    later, loop = relay_test(order, latency_s)
    for row in later[5:-1]:
        if order == "write_first":
            assert row["t_u_s"] - row["t_s"] == pytest.approx(PERIOD_S, abs=1e-9)
    if order == "write_first":
        assert loop.latency_s == pytest.approx(PERIOD_S, abs=1e-9)
    estimates = []
    for rows in (at_once, later):
        t_s, y_rad, t_u_s, u_V = (
            np.array([row[name] for row in rows[300:-2]], dtype=float) for name in ("t_s", "y_rad", "t_u_s", "u_V")
        )
        estimates.append(sampled_data.fit([TimeSeries(t_s, y_rad, t_u_s, u_V, name="relay-1")]))
    for name, truth in (("tau_s", 0.17), ("K_rad_s_V", 6.5), ("fc_V", 0.48)):
        assert getattr(estimates[1], name) == pytest.approx(truth, rel=0.02)
        assert getattr(estimates[1], name) == pytest.approx(getattr(estimates[0], name), rel=0.02)


@pytest.mark.parametrize("latency_s", [0.0172, 0.035, 0.1])
def test_a_delay_of_many_ticks_is_followed_once_the_strokes_have_told_it(latency_s: float) -> None:
    """Reports tell it modulo a period; drives that wait do not count as drives that the device cut down."""
    clock, record = VirtualClock(), ListSink()
    driver = SimulatedDriver(clock, DEMO, SCALING, SimulatedLatency(latency_s + 0.002, 0.001), 1)
    loop = Loop(driver, clock, Guard(GUARD), record, PERIOD_S, StopRequest())
    loop.expect_delay(latency_s)

    with loop.armed(LIMITS):
        loop.run(Steps(), "steps")
    assert loop.latency_s == pytest.approx(latency_s + 0.002, abs=0.0005)
    assert not any(row["flags"] & FLAG_SATURATED for row in record.rows if row["t_s"] > 0.2)


def test_a_drive_within_its_own_tick_is_followed_as_ever() -> None:
    clock = VirtualClock()
    driver = SimulatedDriver(clock, DEMO, SCALING, SimulatedLatency(0.004, 0.0), 1)
    loop = Loop(driver, clock, Guard(GUARD), ListSink(), PERIOD_S, StopRequest())
    loop.expect_delay(0.004)
    assert loop.latency_s == 0.0
    assert loop.waits(PERIOD_S)
    assert not loop.waits(0.9 * PERIOD_S)
