"""The compiled stroke test decides as the host's law does, on the same counts, at every tick."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from device_strokes import DeviceStrokes
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.backends.driver import StrokesCommand
from rig.control.strokes_on_counts import StrokesOnCounts
from rig.core.faults import Fault
from rig.core.signals import Sample

Plan = Sequence[tuple[int, int]]  # drive in units, by the position's sign; turning point in counts


def decisions(
    plan: Plan, centre: int, times: tuple[int, int], still: int, counts: Sequence[int], ways: tuple[int, int]
) -> list[int]:
    """Drive of each tick; asserts that both agree at every tick.

    ways  +1 or -1: whether positions rise with the counts, and whether positive units raise the position
    """
    direction, sign = ways
    device = DeviceStrokes([(sign * drive, turn) for drive, turn in plan], centre, times, still, direction * sign)
    of_host = tuple((float(drive), turn) for drive, turn in plan)
    host = StrokesOnCounts(StrokesCommand(of_host, centre, direction, *times, still))
    drives = []
    for tick, reading in enumerate(counts):
        try:
            expected = host.step(Sample(1e-3 * tick, 0.0, reading))
        except Fault as fault:
            assert fault.code in ("SENSOR_STUCK", "NO_CYCLE")
            expected = 0.0
        drive = device.step(reading)
        assert drive == sign * expected, (tick, reading)
        drives.append(drive)
    return drives


@st.composite
def plans(draw: st.DrawFn, low: int, high: int) -> Plan:
    """Strokes to and fro."""
    first = draw(st.sampled_from([1, -1]))
    n = 2 * draw(st.integers(1, 4))
    size, turn = st.integers(1, 300), st.integers(low, high)
    return [(first * (-1) ** k * draw(size), draw(turn)) for k in range(n)]


all_ways = st.tuples(st.sampled_from([1, -1]), st.sampled_from([1, -1]))
short = st.tuples(st.integers(1, 30), st.integers(1, 12))


@settings(max_examples=examples(400), deadline=None)
@given(
    plan=plans(490, 530),
    centre=st.integers(500, 520),
    times=short,
    still=st.integers(1, 6),
    counts=st.lists(st.integers(485, 535), min_size=1, max_size=300),
    ways=all_ways,
)
def test_any_readings(
    plan: Plan, centre: int, times: tuple[int, int], still: int, counts: list[int], ways: tuple[int, int]
) -> None:
    decisions(plan, centre, times, still, counts, ways)


@settings(max_examples=examples(300), deadline=None)
@given(
    plan=plans(400, 600),
    times=short,
    still=st.integers(1, 6),
    runs=st.lists(st.tuples(st.integers(-9, 9), st.integers(1, 25)), min_size=1, max_size=40),
    ways=all_ways,
)
def test_readings_that_move_and_stand_still(
    plan: Plan, times: tuple[int, int], still: int, runs: list[tuple[int, int]], ways: tuple[int, int]
) -> None:
    """Steady motion of some counts a tick, or none, for some ticks each: turns, standstills and strokes too slow."""
    counts, at = [], 512
    for step, ticks in runs:
        for _ in range(ticks):
            at += step
            counts.append(at)
    decisions(plan, 512, times, still, counts, ways)


@settings(max_examples=examples(100), deadline=None)
@given(
    plan=plans(-(2**31), 2**31 - 1),
    centre=st.integers(-(2**31), 2**31 - 1),
    counts=st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=60),
    ways=all_ways,
)
def test_any_encoder(plan: Plan, centre: int, counts: list[int], ways: tuple[int, int]) -> None:
    decisions(plan, centre, (30, 12), 65535, counts, ways)


@pytest.mark.parametrize("ways", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_a_run_that_shows_every_case(ways: tuple[int, int]) -> None:
    """Turns of every stroke, one that fails by time, one by standstill, both forgiven; two in a row at last."""
    direction, sign = ways
    plan = [
        (50, 512 + 60 * direction),
        (-70, 512 - 50 * direction),
        (60, 512 + 40 * direction),
        (-80, 512 - 30 * direction),
    ]

    def moved(*positions: int) -> list[int]:
        return [512 + direction * y for y in positions]

    to_and_fro = moved(*range(0, 64, 4), *range(60, -54, -6), *range(-50, 44, 6), *range(40, -34, -6))
    slow = moved(*range(-30, 11))  # 30 ticks are too few for the first stroke's 60 counts
    still = moved(*[-20] * 14)
    back = moved(*range(-20, -60, -6))
    drives = decisions(plan, 512, (30, 8), 3, to_and_fro + slow + back + still + still + moved(70, -70), ways)
    assert set(drives) == {sign * u for u in (50, -70, 60, -80)} | {0}
    assert drives[-1] == 0
