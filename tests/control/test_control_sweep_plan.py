"""The plan of a survey's sweeps: within the travel and the time, or refused with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.sweep_plan import SETTLE, TURN, Room, TooShortError, sweep_plan

ROOM = Room((-1.1, 1.1), 4.9, 0.08, 8.0, 120.0)


@given(
    st.floats(0.3, 4.0), st.floats(-0.5, 0.5), st.floats(0.005, 0.2), st.floats(1.0, 12.0), st.floats(20.0, 300.0)
)  # fmt: skip
def test_the_reference_stays_in_the_travel_and_in_the_time(
    width: float, centre: float, slowest: float, bandwidth: float, longest_s: float
) -> None:
    room = Room((centre - width / 2, centre + width / 2), 4.9, slowest, bandwidth, longest_s)
    try:
        plan = sweep_plan(room)
    except TooShortError as error:
        assert "rad" in str(error)
        return
    assert plan.duration_s <= longest_s
    assert min(plan.speeds_rad_s) >= slowest * (1 - 1e-9) and max(plan.speeds_rad_s) <= 0.5 * 4.9
    assert list(plan.speeds_rad_s) == sorted(plan.speeds_rad_s, reverse=True)
    low, high = room.soft_rad
    y = [plan.at(t).y_rad for t in np.linspace(0.0, 1.01 * plan.duration_s, 400).tolist()]
    assert low < plan.low_rad <= min(y) + 1e-9 and max(y) - 1e-9 <= plan.high_rad < high
    # half of the travel at least is swept at a steady speed, by the fastest sweep too
    run_up_rad = max(plan.speeds_rad_s) * (0.5 * TURN + SETTLE) / plan.bandwidth_1_s
    assert 2.0 * run_up_rad <= 0.5 * (plan.high_rad - plan.low_rad) * (1 + 1e-9)


def test_speed_and_acceleration_are_the_derivatives_of_the_position() -> None:
    plan, h = sweep_plan(ROOM), 1e-5
    for t in np.linspace(0.01, plan.duration_s - 0.01, 333).tolist():
        before, now, after = plan.at(t - h), plan.at(t), plan.at(t + h)
        assert now.v_rad_s == pytest.approx((after.y_rad - before.y_rad) / (2 * h), abs=1e-4)
        near_a_corner = before.a_rad_s2 != after.a_rad_s2
        assert near_a_corner or now.a_rad_s2 == pytest.approx((after.v_rad_s - before.v_rad_s) / (2 * h), abs=1e-4)


def test_each_speed_is_swept_both_ways_for_as_long_as_the_travel_is() -> None:
    plan = sweep_plan(ROOM)
    t = np.arange(0.0, plan.duration_s, 0.005)
    v = np.array([plan.at(at).v_rad_s for at in t.tolist()])
    for speed in plan.speeds_rad_s:
        for way in (1.0, -1.0):
            steady_s = 0.005 * np.count_nonzero(np.abs(v - way * speed) < 1e-9)
            travel = plan.high_rad - plan.low_rad
            assert steady_s == pytest.approx(travel / speed - plan.turn_s, abs=0.02)


def test_wanted_speeds_are_taken_as_they_are() -> None:
    assert sweep_plan(ROOM, (0.1, 0.5, 0.25)).speeds_rad_s == (0.5, 0.25, 0.1)


@pytest.mark.parametrize(
    ("room", "wanted", "words"),
    [
        (replace(ROOM, soft_rad=(-0.1, 0.1)), (), "slowest sweep that the sensor resolves is at 0.08 rad/s"),
        (replace(ROOM, longest_s=5.0), (), "take at least 3[0-9] s, longer than 5 s"),
        (ROOM, (0.1, 3.0), "3 rad/s is too fast for a travel of 1.98 rad: at most 0.7"),
        (ROOM, (0.01, 0.5), "0.01 rad/s is too slow .* at least 0.08"),
        (replace(ROOM, longest_s=20.0), (0.1, 0.5), "these sweeps take 5[0-9] s, longer than 20 s"),
    ],
)
def test_too_little_travel_or_time_is_refused_in_words(room: Room, wanted: tuple[float, ...], words: str) -> None:
    with pytest.raises(TooShortError, match=words):
        sweep_plan(room, wanted)
