"""The stroke test: to and fro between turning points; a stroke that does not come to its turn never lasts for ever."""

from __future__ import annotations

import math

import pytest

from rig.control.strokes import Stroke, StrokeTest, StrokeTiming
from rig.core.faults import Fault
from rig.core.signals import Sample

PLAN = (Stroke(1.0, 0.3), Stroke(-0.8, -0.1), Stroke(0.6, 0.2), Stroke(-1.2, -0.4))
TIMING = StrokeTiming(longest_s=0.3, stroke_s=1.0, still_s=0.3)


def drives(test: StrokeTest, y_rad: list[float]) -> list[float]:
    """What the test drives at readings every 10 ms."""
    return [test.step(Sample(0.01 * k, y, 0)) for k, y in enumerate(y_rad)]


def test_each_stroke_lasts_until_its_turning_point_and_the_plan_repeats() -> None:
    test = StrokeTest(PLAN, TIMING, 0.02)
    readings = [0.0, 0.2, 0.31, 0.0, -0.2, 0.21, -0.1, -0.4, 0.1]
    assert drives(test, readings) == [1.0, 1.0, -0.8, -0.8, 0.6, -1.2, -1.2, 1.0, 1.0]
    assert test.ended == 4
    assert test.settled_start_s == 0.02
    assert test.settled_end_s == pytest.approx(0.07)


@pytest.mark.parametrize(("y_rad", "first_V"), [(-0.5, 1.0), (0.0, 1.0), (0.05, -0.8), (0.9, -0.8)])
def test_it_begins_inward(y_rad: float, first_V: float) -> None:
    assert StrokeTest(PLAN, TIMING, 0.02).step(Sample(0.0, y_rad, 0)) == first_V


def test_one_stroke_at_most_ends_at_a_sample() -> None:
    """Also where the reading is beyond the next turning point already: that stroke drives for one sample."""
    plan = (Stroke(1.0, -0.2), Stroke(-1.0, 0.2))
    assert drives(StrokeTest(plan, TIMING, 0.02), [0.0, 0.0, 0.0, 0.0]) == [-1.0, 1.0, -1.0, 1.0]


def test_it_ends_at_the_first_turn_after_its_time() -> None:
    test = StrokeTest(PLAN, TIMING, 0.001)
    for k in range(40):
        test.step(Sample(0.01 * k, 0.001 * k, 0))
        assert not test.finished
    test.step(Sample(0.4, 0.35, 0))
    assert test.finished


def test_a_stroke_that_takes_too_long_gives_way_to_the_next_and_two_in_a_row_end_the_test() -> None:
    """The shaft moves, but does not come to the turning points in time."""
    test = StrokeTest(PLAN, TIMING, 0.02)
    moving = [0.001 * k for k in range(102)]
    back = [0.101 - 0.001 * k for k in range(102)]
    assert drives(test, moving)[-2:] == [1.0, -0.8]
    with pytest.raises(Fault, match=r"two strokes in a row.*-0.80 V to -0.100 rad") as caught:
        for k, y in enumerate(back):
            test.step(Sample(1.02 + 0.01 * k, y, 0))
    assert caught.value.code == "NO_CYCLE"


def test_a_stroke_that_comes_to_its_turn_makes_up_for_one_that_did_not() -> None:
    test = StrokeTest(PLAN, TIMING, 0.02)
    drives(test, [0.001 * k for k in range(102)])
    test.step(Sample(1.02, -0.2, 0))
    drives_on = [test.step(Sample(1.03 + 0.01 * k, -0.2 + 0.001 * k, 0)) for k in range(102)]
    assert drives_on[0] == 0.6
    assert drives_on[-1] == -1.2


def test_a_reading_that_stands_still_in_both_directions_is_a_stuck_sensor() -> None:
    test = StrokeTest(PLAN, TIMING, 0.02)
    with pytest.raises(Fault, match=r"stood still for 0\.31 s") as caught:
        drives(test, [0.1] * 100)
    assert caught.value.code == "SENSOR_STUCK"


def test_a_reading_that_stands_still_under_drives_that_need_not_move_the_shaft_is_no_stuck_sensor() -> None:
    """Both drives have to be known to move it: where one is not the shaft may stick."""
    for moves_V, code in ((0.6, "SENSOR_STUCK"), (0.7, "NO_CYCLE"), (1.1, "NO_CYCLE")):
        with pytest.raises(Fault, match=r"stood still for 0\.31 s") as caught:
            drives(StrokeTest(PLAN, TIMING, 0.02, moves_V), [0.1] * 100)
        assert caught.value.code == code


@pytest.mark.parametrize(
    ("plan", "timing", "motion_rad"),
    [
        (PLAN[:1], TIMING, 0.02),
        (PLAN[:3], TIMING, 0.02),
        ((Stroke(1.0, 0.1), Stroke(1.0, 0.2)), TIMING, 0.02),
        ((Stroke(1.0, 0.1), Stroke(0.0, -0.2)), TIMING, 0.02),
        ((Stroke(1.0, math.nan), Stroke(-1.0, -0.2)), TIMING, 0.02),
        (PLAN, TIMING._replace(longest_s=0.0), 0.02),
        (PLAN, TIMING._replace(stroke_s=-1.0), 0.02),
        (PLAN, TIMING._replace(still_s=0.0), 0.02),
        (PLAN, TIMING, 0.0),
    ],
)
def test_strokes_and_times_out_of_range_are_refused(
    plan: tuple[Stroke, ...], timing: StrokeTiming, motion_rad: float
) -> None:
    with pytest.raises(ValueError, match="a stroke test needs"):
        StrokeTest(plan, timing, motion_rad)
