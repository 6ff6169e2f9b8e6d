"""Counts, rad, V and drive units: exact inverses, directions, and what is refused."""

import math
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rig.core.calibration import Calibration, DriveMap, TachometerScale, polarity

DEMO = [(24, -2.0015625), (1000, 2.0015625)]


@st.composite
def calibrations(draw: st.DrawFn) -> list[tuple[int, float]]:
    n = draw(st.integers(2, 8))
    counts = draw(st.lists(st.integers(0, 1023), min_size=n, max_size=n, unique=True))
    steps = draw(st.lists(st.floats(0.01, 2.0), min_size=n, max_size=n))
    rad = [sum(steps[: k + 1]) - 4.0 for k in range(n)]
    if draw(st.booleans()):
        rad.reverse()
    return list(zip(sorted(counts), rad, strict=True))


drive_maps = st.builds(
    DriveMap,
    supply_V=st.floats(5.0, 48.0),
    bridge_drop_V=st.floats(0.0, 3.0),
    dead_band_plus=st.floats(0.0, 0.45),
    dead_band_minus=st.floats(0.0, 0.45),
    reversed=st.booleans(),
    full_units=st.integers(50, 32767),
)


def test_two_points_of_the_demo() -> None:
    calibration = Calibration(DEMO)
    assert calibration.to_rad(512) == pytest.approx(0.0, abs=1e-12)
    assert calibration.to_rad(513) - calibration.to_rad(512) == pytest.approx(4.2 / 1024, rel=1e-3)
    assert calibration.lsb_rad == pytest.approx(2 * 2.0015625 / 976)


def test_a_table_by_hand_with_both_ends_extrapolated() -> None:
    calibration = Calibration([(500, 0.0), (100, -1.0), (600, 1.0)])  # any order
    expected = {100: -1.0, 300: -0.5, 500: 0.0, 550: 0.5, 600: 1.0, 0: -1.25, 700: 2.0}
    assert {counts: calibration.to_rad(counts) for counts in expected} == pytest.approx(expected)
    assert {c: calibration.to_counts(r) for c, r in expected.items()} == pytest.approx({c: c for c in expected})


@given(points=calibrations(), counts=st.floats(-200, 1300))
def test_inverse_both_ways_rising_or_falling(points: list[tuple[int, float]], counts: float) -> None:
    calibration = Calibration(points)
    assert calibration.to_counts(calibration.to_rad(counts)) == pytest.approx(counts, abs=1e-6)


@given(points=calibrations(), a=st.floats(-200, 1300), b=st.floats(-200, 1300))
def test_monotonic_in_its_direction(points: list[tuple[int, float]], a: float, b: float) -> None:
    assume(b - a > 1e-3)
    calibration = Calibration(points)
    assert (calibration.to_rad(b) - calibration.to_rad(a)) * calibration.direction > 0.0
    assert calibration.direction == (1 if points[-1][1] > points[0][1] else -1)


@given(points=calibrations())
def test_passes_through_its_points(points: list[tuple[int, float]]) -> None:
    calibration = Calibration(points)
    assert [calibration.to_rad(c) for c, _ in points] == pytest.approx([r for _, r in points], abs=1e-9)
    assert [calibration.to_counts(r) for _, r in points] == pytest.approx([c for c, _ in points], abs=1e-6)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([(1, 0.0)], "at least two points"),
        ([(1, 0.0), (1, 1.0)], "1 counts are given twice"),
        ([(1, 0.0), (2, 0.0)], "only rise or only fall"),
        ([(0, 0.0), (10, 1.0), (20, 0.5), (30, 2.0)], "from 10 to 20 counts they go from 1 to 0.5 rad"),
        ([(0, 3.0), (10, 1.0), (20, 1.5)], "only rise or only fall"),
        ([(0, 0.0), (10, math.nan)], "finite"),
    ],
)
def test_refused_calibrations(points: list[tuple[int, float]], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Calibration(points)


@given(drive=drive_maps, data=st.data())
def test_units_to_volts_and_back_is_exact(drive: DriveMap, data: st.DataObject) -> None:
    units = data.draw(st.integers(-drive.full_units, drive.full_units))
    dead = drive.dead_band_plus if units > 0 else drive.dead_band_minus
    volts = drive.to_volts(units)
    assert abs(volts) <= drive.full_V
    if abs(units) <= dead * drive.full_units:
        assert volts == 0.0
    else:
        assert drive.to_units(volts) == units


@given(drive=drive_maps, share=st.floats(-1.0, 1.0))
def test_volts_come_back_within_half_a_unit_and_with_their_sign(drive: DriveMap, share: float) -> None:
    u_V = share * drive.full_V
    dead = drive.dead_band_plus if u_V * drive.sign > 0 else drive.dead_band_minus
    half_unit_V = 0.5 * drive.full_V / (drive.full_units * (1.0 - dead))
    assert drive.quantised(u_V) == pytest.approx(u_V, abs=half_unit_V * (1 + 1e-9))
    assert drive.quantised(drive.quantised(u_V)) == drive.quantised(u_V)
    assert drive.to_units(u_V) * u_V * drive.sign >= 0.0


@given(drive=drive_maps, a=st.floats(-1.0, 1.0), b=st.floats(-1.0, 1.0))
def test_more_volts_never_give_less_drive(drive: DriveMap, a: float, b: float) -> None:
    low, high = sorted((a * drive.full_V, b * drive.full_V))
    assert drive.quantised(low) <= drive.quantised(high)


def test_a_bridge_by_hand() -> None:
    """12 V less 2 V of an L298; the first tenth of duty passes nothing forward, the first fifth backward."""
    drive = DriveMap(supply_V=12.0, bridge_drop_V=2.0, dead_band_plus=0.1, dead_band_minus=0.2, full_units=1000)
    assert drive.full_V == 10.0
    assert drive.to_units(0.0) == 0
    assert drive.to_units(5.0) == 550
    assert drive.to_units(-5.0) == -600
    assert drive.to_units(10.0) == 1000
    assert drive.to_volts(100) == 0.0
    assert drive.to_volts(-200) == 0.0
    assert drive.to_volts(-600) == pytest.approx(-5.0)


def test_a_reversed_bridge_keeps_the_dead_band_with_the_duty() -> None:
    drive = DriveMap(supply_V=10.0, dead_band_plus=0.1, dead_band_minus=0.2, reversed=True, full_units=1000)
    assert drive.to_units(5.0) == -600
    assert drive.to_units(-5.0) == 550
    assert drive.to_volts(550) == pytest.approx(-5.0)


@pytest.mark.parametrize("u_V", [10.0001, -10.0001, math.inf, math.nan])
def test_no_clipping_without_a_word(u_V: float) -> None:
    with pytest.raises(ValueError, match="beyond the"):
        DriveMap(supply_V=12.0, bridge_drop_V=2.0).to_units(u_V)
    with pytest.raises(ValueError, match="full duty"):
        DriveMap(supply_V=12.0, full_units=799).to_volts(-800)


@pytest.mark.parametrize(
    "wrong",
    [{"bridge_drop_V": 12.0}, {"bridge_drop_V": -1.0}, {"dead_band_plus": 1.0}, {"dead_band_minus": -0.1},
     {"full_units": 0}, {"supply_V": math.inf}],
)  # fmt: skip
def test_refused_drive_maps(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        DriveMap(**{"supply_V": 12.0, **wrong})


@pytest.mark.parametrize("rising", [True, False])
@pytest.mark.parametrize("turned", [True, False])
def test_polarity_is_what_positive_units_do_to_counts(rising: bool, turned: bool) -> None:
    calibration = Calibration(DEMO if rising else [(c, -r) for c, r in DEMO])
    drive = DriveMap(supply_V=12.0, reversed=turned)
    moved_rad = 0.1 * math.copysign(1.0, drive.to_volts(100))  # positive voltage raises the position
    moved_counts = calibration.to_counts(moved_rad) - calibration.to_counts(0.0)
    assert polarity(calibration, drive) == math.copysign(1.0, moved_counts)


def test_tachometer_behind_a_gear() -> None:
    scale = TachometerScale(rad_s_per_count=-0.09, zero_counts=512.0, gear_ratio=9.0)
    assert scale.to_rad_per_s(412) == pytest.approx(1.0)
