"""The compiled relay decides as the host's law does, on the same counts, at every tick."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from device_relay import COUNT, COUNT_TICK, Z_MAX, DeviceRelay
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.control.relay import DualChannelRelay
from rig.core.signals import Sample

H1, H2 = 1.0, 3.0  # V; the four sums differ
DRIVE = (-4, 2, -2, 4)  # -h1 sgn(y) - h2 sgn(z), by state


def decisions(centre: int, z_bound: int, direction: int, counts: Sequence[int]) -> tuple[list[int], list[float]]:
    """Drive of each tick, and how often z or y was exactly zero; asserts that both agree at every tick."""
    device = DeviceRelay(centre, z_bound, DRIVE, direction)
    # counts and ticks instead of rad and s: binary fractions, so that the law in floating point is exact as well
    host = DualChannelRelay(H1, H2, z_bound / COUNT_TICK)
    drives, integrals = [], []
    for tick, reading in enumerate(counts):
        expected = host.step(Sample(float(tick), direction * (reading - centre / COUNT), reading))
        drive = device.step(reading)
        assert drive == expected, (tick, reading)
        assert device.z == COUNT_TICK * host.z_rad_s, (tick, reading)
        drives.append(drive)
        integrals.append(host.z_rad_s)
    assert device.bound_reached == host.bound_reached
    return drives, integrals


near = st.integers(508, 516)  # where readings and integrals of exactly zero are frequent
bounds = st.one_of(st.integers(1, 600), st.integers(1, Z_MAX), st.just(Z_MAX))
directions = st.sampled_from([1, -1])


@settings(max_examples=examples(300), deadline=None)
@given(
    centre=st.integers(508 * COUNT, 516 * COUNT),
    z_bound=bounds,
    direction=directions,
    counts=st.lists(near, min_size=1, max_size=400),
)
def test_near_the_centre(centre: int, z_bound: int, direction: int, counts: list[int]) -> None:
    decisions(centre, z_bound, direction, counts)


@settings(max_examples=examples(200), deadline=None)
@given(
    centre=st.integers(0, 0xFFFF * COUNT),
    z_bound=bounds,
    direction=directions,
    counts=st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=200),
)
def test_any_reading_any_centre(centre: int, z_bound: int, direction: int, counts: list[int]) -> None:
    decisions(centre, z_bound, direction, counts)


@settings(max_examples=examples(200), deadline=None)
@given(
    centre=st.integers(0, 1023),
    z_bound=bounds,
    direction=directions,
    runs=st.lists(st.tuples(st.integers(-4, 4), st.integers(1, 40)), min_size=1, max_size=40),
)
def test_runs_that_come_back_to_exactly_zero(
    centre: int, z_bound: int, direction: int, runs: list[tuple[int, int]]
) -> None:
    """Each stretch above the centre is followed by its mirror image: z comes back to exactly zero."""
    counts = [centre + 5]
    for above, ticks in runs:
        counts += [centre + 5 + above] * ticks + [centre + 5] + [centre + 5 - above] * ticks + [centre + 5]
    decisions((centre + 5) * COUNT, z_bound, direction, counts)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("fraction", [0, 1, 8, 15])
def test_cycles_that_show_every_case(direction: int, fraction: int) -> None:
    """Every state; z exactly at zero where the centre is a whole count; z at its bound where that is near."""
    wave = [512 + k for k in (*range(40, -40, -1), *range(-40, 40))] * 4
    centre = 512 * COUNT + fraction
    drives, integrals = decisions(centre, Z_MAX, direction, wave)
    assert set(drives) == set(DRIVE)
    if fraction == 0:
        assert integrals.count(0.0) == 8  # at the top and at the bottom of each wave
    drives, integrals = decisions(centre, 500 * COUNT_TICK, direction, wave)
    assert set(drives) == set(DRIVE)
    assert 500.0 in integrals and -500.0 in integrals
