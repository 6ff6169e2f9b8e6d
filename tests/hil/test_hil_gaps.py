"""A host that stands still: strokes end in the device, and no gap shorter than the watchdog ends a run."""

from __future__ import annotations

import math

import pytest
from evidence import evidence, examples
from hypothesis import given, settings
from hypothesis import strategies as st
from test_hil_pulses import LIMITS, driver_on
from virtual_host import HELD

from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.campaign.random_motors import draw
from rig.config.campaign import Campaign
from rig.core.faults import Fault
from rig.running.preflight.breakaway_strokes import UNSEEN_RAD
from rig.running.preflight.room_to_stop import longest_watchdog_s, room_rad, stopping_rad
from stalls.hostile_host import HostileHost, Stalls
from stalls.rows import config_of, row

CAMPAIGN = Campaign(name="stalls", experiments=500, seed=3)


class _LateHost(HostileHost):
    """Stands still once, before its next frame."""

    def stand_still(self, length_s: float) -> None:
        self._held_s = length_s


def test_a_reading_that_is_asked_for_late_is_no_time_out() -> None:
    host = _LateHost(VirtualBoard(HELD), Stalls(a_minute=0.0), seed=1)
    driver = driver_on(host)
    driver.write(0.5)
    host.stand_still(0.15)
    sample = driver.read()
    assert host.now_s() - sample.t_s < 0.01 and driver.link_statistics["timeouts"] == 0


def test_a_dead_link_is_a_time_out_when_the_watchdog_must_have_acted() -> None:
    board = VirtualBoard(HELD)
    driver = driver_on(board)
    driver.write(0.5)
    driven_s = board.now_s()
    board.read = lambda timeout_s: (board.sleep_until(board.now_s() + timeout_s), b"")[1]  # type: ignore[method-assign]
    with pytest.raises(Fault, match="LINK_TIMEOUT"):
        driver.read()
    assert board.now_s() - driven_s == pytest.approx(LIMITS.watchdog_s, abs=0.002)
    board.sleep_until(board.now_s() + 0.003)  # the drive was some time on its way
    assert board.truth().pin_V == 0.0


@pytest.mark.parametrize("number", [10, *evidence(22, 8, 15)])
def test_motors_that_a_stall_ended_once_are_whole(number: int) -> None:
    """By OVERSPEED after a gap, LINK_TIMEOUT, the check's short watchdog, and LATE; of `make stalls`."""
    found = row(CAMPAIGN, number, Stalls(), 0.25)
    assert found.fault == "" and found.stalls > 0 and found.beyond_rad == 0.0
    assert found.error is not None and found.bound is not None
    assert math.hypot(*(e / b for e, b in zip(found.error, found.bound, strict=True))) < 8.0


@settings(max_examples=examples(18, at_least=3), deadline=None)
@given(st.integers(0, 499), st.floats(5.0, 60.0), st.floats(0.1, 0.4))
def test_under_random_stalls_the_shaft_stays_inside_its_hard_limits(
    number: int, a_minute: float, watchdog_s: float
) -> None:
    stalls = Stalls(a_minute, 0.03, 0.95 * watchdog_s)
    found = row(CAMPAIGN, number, stalls, watchdog_s)
    assert found.beyond_rad == 0.0 and found.check_rad < UNSEEN_RAD
    assert found.fault.partition(":")[0] in ("", "NO_MOTION", "DEVICE_WATCHDOG", "NOT_IDENTIFIED", "LATE")


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(0, 499), st.floats(0.03, 0.4))
def test_the_longest_watchdog_has_room_to_stop(number: int, watchdog_s: float) -> None:
    e = config_of(draw(CAMPAIGN, number), CAMPAIGN, watchdog_s)
    slower = e.model_copy(update={"limits": e.limits.model_copy(update={"max_speed_rad_s": 2.0})})
    longest_s = longest_watchdog_s(slower)
    assert longest_s is not None and longest_s <= 0.5
    longest = slower.model_copy(update={"daq": slower.daq.model_copy(update={"watchdog_s": longest_s})})
    assert stopping_rad(longest.device) <= room_rad(longest.device)
    longer = slower.model_copy(update={"daq": slower.daq.model_copy(update={"watchdog_s": longest_s + 0.03})})
    assert longest_s == 0.5 or stopping_rad(longer.device) > room_rad(longer.device)
