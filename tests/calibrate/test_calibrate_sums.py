"""What comes of the measurements of a calibration, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import pytest
from evidence import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.running.calibrate.dialogue import Refusal
from rig.running.calibrate.steps.angles import Angle, Belief, objection, sensor_fit
from rig.running.calibrate.steps.dead_band import Volts, dead_band
from rig.running.calibrate.steps.travel import travel
from rig.running.calibrate.steps.turn import turn

DEGREE = math.radians(1.0)
FULL_RAD = math.radians(270.0)  # of the usual potentiometer, 10 bits
BELIEF = Belief(FULL_RAD / 1023, 1023, 0.5 * DEGREE, 0.5)


def read(*degrees: float, typed: dict[float, float] | None = None, bend: float = 0.0, sign: float = 1.0) -> list[Angle]:
    """Readings at these angles of a potentiometer; ``bend``: of a parabola, in share of the full range."""
    angles = []
    for at in degrees:
        share = at * DEGREE / FULL_RAD
        counts = 512 + sign * 1023 * (share + bend * (4.0 * share * share - 0.5))
        angles.append(Angle(round(counts), (typed or {}).get(at, at) * DEGREE))
    return angles


def objections(angles: list[Angle], belief: Belief = BELIEF) -> list[str]:
    """What is said while these angles are given one after the other, and at the end."""
    said: list[str] = []
    for number, new in enumerate(angles):
        try:
            found = objection(angles[:number], new, belief)
        except Refusal as refusal:
            found = refusal
        said += [] if found is None else [str(found)]
    return said


angles_deg = st.lists(st.integers(-120, 120), min_size=3, max_size=7, unique_by=lambda deg: deg // 6)


@settings(max_examples=examples(80), deadline=None)
@given(
    turned=angles_deg, off=st.lists(st.floats(-0.5, 0.5), min_size=8, max_size=8), bend=st.floats(-0.01, 0.01),
    range_deg=st.floats(60.0, 340.0), sign=st.sampled_from([1.0, -1.0]),
)  # fmt: skip
def test_true_angles_are_taken_and_the_line_is_found(
    turned: list[int], off: list[float], bend: float, range_deg: float, sign: float
) -> None:
    """Each angle off by up to what is stated, a sensor of any range and of up to 1 % curvature: nothing is refused."""
    scale = range_deg / 270.0
    centre, *others = [a for a in turned if abs(a) > 6] or [60]
    given_ = [0.0, *(float(a) * scale for a in [centre, *others])]
    angles = []
    for at, error in zip(given_, off, strict=False):
        share = at * DEGREE / (FULL_RAD * scale)
        counts = round(512 + sign * 1023 * (share + bend * (4.0 * share * share)))
        angles.append(Angle(counts, (at + error * (at != 0.0)) * DEGREE))
    if max(abs(a.rad) for a in angles) < 30.0 * DEGREE or len({round(a.rad, 6) for a in angles}) < 3:
        return
    belief = Belief(FULL_RAD * scale / 1023, 1023, 0.5 * DEGREE, 0.5)
    assert objections(angles, belief) == []
    fit = sensor_fit(angles, belief)
    span = max(a.rad for a in angles) - min(a.rad for a in angles)
    assert fit.rad_per_count == pytest.approx(sign * FULL_RAD * scale / 1023, rel=0.05 + 3.0 * DEGREE / span)
    assert sorted(fit.points) == list(fit.points)


@pytest.mark.parametrize("slip", [0.1, 10.0, -1.0, math.degrees(1.0), math.radians(1.0)])
@pytest.mark.parametrize("wrong", range(1, 5))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_mistyped_angle_is_refused(slip: float, wrong: int, sign: float) -> None:
    """One of five angles typed with a wrong decimal point, sign or unit: rig asks, wherever in the row it comes."""
    turned = [0.0, -80.0, 6.0, 45.0, 90.0]
    angles = read(*turned, typed={turned[wrong]: turned[wrong] * slip}, sign=sign)
    assert objections(angles) != []


def test_six_typed_as_0_6_is_named() -> None:
    said = objections(read(0.0, -90.0, 6.0, typed={6.0: 0.6}))
    assert len(said) == 1
    assert "did you mean 6° instead of 0.6° at 535 counts?" in said[0]


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        pytest.param(read(0.0, 90.0), "2 angles are too few", id="two"),
        pytest.param(read(0.0, 45.0, 90.0, typed={90.0: 30.0}), "only rise or only fall", id="back and forth"),
        pytest.param(
            [Angle(100, 0.0), Angle(500, 0.01), Angle(900, 0.02)], "readings 0 to 1023 span 1.465°", id="radians"
        ),
        pytest.param(read(0.0, 60.0, 120.0, typed={60.0: 110.0}), "no potentiometer is so curved", id="curved"),
    ],
)
def test_what_no_calibration_comes_of(angles: list[Angle], words: str) -> None:
    with pytest.raises(Refusal, match=words):
        sensor_fit(angles, BELIEF)


def test_a_sensor_that_stands_still_is_told() -> None:
    with pytest.raises(Refusal, match="the reading has not moved: 513 counts at 45°, as at 0°"):
        objection([Angle(512, 0.0)], Angle(513, 45.0 * DEGREE), BELIEF)


def test_an_angle_too_near_to_another_is_refused() -> None:
    with pytest.raises(Refusal, match="is too near to 0°: 1 counts apart"):
        objection([Angle(512, 0.0)], Angle(513, 0.2 * DEGREE), BELIEF)


def test_a_straight_sensor_gets_two_points_and_a_curved_one_a_table() -> None:
    turned = (-110.0, -55.0, 0.0, 55.0, 110.0)
    straight, curved = (sensor_fit(read(*turned, bend=bend), BELIEF) for bend in (0.0, 0.015))
    assert [counts for counts, _ in straight.points] == [95, 929]
    assert [rad / DEGREE for _, rad in straight.points] == pytest.approx([-110.0, 110.0], abs=0.15)
    assert straight.linearity_percent == pytest.approx(100.0 * 0.5 / 270.0, abs=0.05)
    assert len(curved.points) == 5 and not curved.is_straight
    # 4 x 0.015 x (110 / 270)^2 of the full range between middle and ends; the line halves it
    assert curved.bend_rad / FULL_RAD == pytest.approx(0.5 * 4.0 * 0.015 * (110.0 / 270.0) ** 2, rel=0.1)
    assert curved.linearity_percent == pytest.approx(100.0 * (curved.bend_rad / FULL_RAD + 0.5 / 270.0), rel=0.05)
    assert sensor_fit(read(*turned[1:]), BELIEF).linearity_percent is None


def test_limits_lie_inside_stops_and_calibration() -> None:
    found = travel((-2.0, 2.2), (-1.95, 1.9), ((-0.9, 0.9), (-1.6, 1.6)))
    assert found.hard_rad == (-1.8, 1.9)
    assert found.ends == ("stop", "calibration")
    assert found.soft_rad == (-1.01, 1.06)


@pytest.mark.parametrize(
    ("stops", "words"),
    [
        ((2.0, -2.0), "the wrong way round"),
        ((0.1, 2.0), "the centre, 0, is outside the travel"),
        ((-0.3, 2.0), "too little to stop and to measure in"),
    ],
)
def test_travel_that_cannot_be(stops: tuple[float, float], words: str) -> None:
    with pytest.raises(Refusal, match=words):
        travel(stops, (-1.9, 1.9), ((-0.9, 0.9), (-1.6, 1.6)))


def test_a_turn_confirms_or_corrects_an_encoder() -> None:
    whole = 2.0 * math.pi
    as_believed = turn(3198.0, whole, 2.0 * DEGREE, (64, 50.0))
    assert (as_believed.counts_per_turn, as_believed.sign) == (64, 1)
    lines_for_edges = turn(-1601.0, 0.5 * whole, 2.0 * DEGREE, (16, 50.0))
    assert (lines_for_edges.counts_per_turn, lines_for_edges.sign) == (64, -1)
    refused = ((70.0, 0.1, "too small"), (2500.0, whole, "correct counts_per_turn"))
    for moved, angle, words in refused:
        with pytest.raises(Refusal, match=words):
            turn(moved, angle, 2.0 * DEGREE, (64, 50.0))


def test_a_dead_band_is_where_the_line_begins() -> None:
    readings = [Volts(duty, max(10.0 * (duty - 0.03) / 0.97, 0.0)) for duty in (0.02, 0.1, 0.2, 0.3)]
    found = dead_band(readings, 12.0)
    assert found.duty == pytest.approx(0.03, abs=1e-4)
    assert found.full_V == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("readings", "words"),
    [
        ([(0.1, 0.0), (0.2, 0.01), (0.3, 0.02)], "next to nothing"),
        ([(0.1, 1.0), (0.2, 0.9), (0.3, 3.0)], "do not rise in a line"),
        ([(0.1, 1000.0), (0.2, 2000.0), (0.3, 3000.0)], "volts, not millivolts"),
    ],
)
def test_voltages_that_cannot_be(readings: list[Any], words: str) -> None:
    with pytest.raises(Refusal, match=words):
        dead_band([Volts(*reading) for reading in readings], 12.0)
