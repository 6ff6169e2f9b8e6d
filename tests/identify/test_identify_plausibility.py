"""What a recording's columns are compared with: where a reading that stands still is the end of a sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.identification.estimate import Estimate
from rig.identification.plausibility import judge_motor, judge_records, one_way, without_holes
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.recording.stage import Stage, StageKind

Array = NDArray[np.float64]
STEP_RAD = 2.0 * np.pi / 3200.0


def to_and_fro(noise_rad: float, end_rad: float = np.inf) -> TimeSeries:
    """A millisecond's rows of a shaft that turns back again and again, read in steps, up to the end of a sensor."""
    t_s: NDArray[np.float64] = np.linspace(0.0, 3.0, 3001)
    noise = noise_rad * np.random.default_rng(1).normal(size=t_s.size)
    y_rad = STEP_RAD * np.round((0.25 * np.sin(12.0 * t_s) + noise) / STEP_RAD)
    return TimeSeries(t_s, np.minimum(y_rad, end_rad), t_s, np.sign(np.sin(12.0 * t_s)))


@pytest.mark.parametrize("noise_rad", [0.0, 0.3 * STEP_RAD, 0.7 * STEP_RAD])
def test_a_turn_within_a_step_is_no_end_of_a_sensor(noise_rad: float) -> None:
    assert judge_records([to_and_fro(noise_rad)]) == []


@pytest.mark.parametrize("noise_rad", [0.7 * STEP_RAD, 2.0 * STEP_RAD])
def test_a_reading_cut_off_in_spite_of_noise_is_one(noise_rad: float) -> None:
    (objection,) = judge_records([to_and_fro(noise_rad, 100 * STEP_RAD)])
    assert "stays at exactly" in objection.reason


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_a_shaft_that_friction_holds_at_its_turn_as_it_does_elsewhere_is_at_no_end_of_a_sensor(share: float) -> None:
    """A position loop's shaft stands still under its drive wherever it turns; elsewhere for a part of the time."""
    cut = to_and_fro(0.7 * STEP_RAD, 100 * STEP_RAD)
    longest = max(len(run) for run in np.split(cut.y_rad, np.flatnonzero(np.diff(cut.y_rad)) + 1))
    rows = round(share * longest) + 1
    held = np.concatenate((np.arange(1000), np.full(rows, 1000), np.arange(1001, cut.t_s.size - rows + 1)))
    y_rad, u_V = cut.y_rad[held], cut.u_V[held]
    assert abs(y_rad[1000]) < 0.8 * y_rad.max()
    assert judge_records([replace(cut, y_rad=y_rad, u_V=u_V)]) == []
    softly = u_V * np.where(held == 1000, 0.3, 1.0)
    (objection,) = judge_records([replace(cut, y_rad=y_rad, u_V=softly)])
    assert "stays at exactly" in objection.reason  # elsewhere it stands under a third of this drive alone


def _test_of_run(name: str, travel_rad: float, seed: int = 1) -> TimeSeries:
    """A relay test of a run over so much travel, 100 rows a second."""
    t_s: NDArray[np.float64] = np.linspace(0.0, 6.0, 601)
    noise = 0.003 * np.random.default_rng(seed).normal(size=t_s.size)
    y_rad = 0.5 * travel_rad * np.sin(6.0 * t_s) + noise
    return TimeSeries(t_s, y_rad, t_s, np.sign(np.cos(6.0 * t_s)), name=name, stage=Stage.parse(name))


def test_a_test_that_hardly_moves_takes_nothing_from_one_that_does() -> None:
    moved, still = _test_of_run("relay-1", 1.0), _test_of_run("relay-2", 0.01)
    assert judge_records([moved, still]) == []
    *_, objection = judge_records([moved, replace(still, stage=None, name="another.csv")])
    assert "no more than its noise" in objection.reason


def test_many_tests_with_one_defect_are_one_sentence() -> None:
    tests = [_test_of_run(f"relay-{k}", 0.03, k) for k in range(1, 20)]
    (objection,) = judge_records(tests)
    assert objection.reason.startswith("relay-1: the position moves by")
    assert objection.reason.endswith("(and 18 other tests alike)")


def test_a_reading_that_stays_while_there_is_no_drive_is_a_shaft_at_rest() -> None:
    moved = to_and_fro(0.7 * STEP_RAD, 100 * STEP_RAD)
    at_end = moved.y_rad == moved.y_rad.max()
    assert judge_records([replace(moved, u_V=np.where(at_end, 0.0, moved.u_V))]) == []


def test_a_speed_that_is_cut_off_at_0_is_a_shaft_that_has_not_broken_away() -> None:
    """A published log of a speed loop begins at rest, under a drive that grows: it was refused."""
    (objection,) = judge_records([cut := to_and_fro(0.7 * STEP_RAD, 100 * STEP_RAD)])
    assert "stays at exactly" in objection.reason
    assert judge_records([replace(cut, reads="speed")]) == []


def test_parts_between_gaps_that_are_too_short_to_fit_are_not_recommended() -> None:
    whole = _test_of_run("relay-1", 1.0)
    kept = np.flatnonzero(np.arange(601) % 40 < 18)
    gap, *_ = judge_records([TimeSeries(whole.t_s[kept], whole.y_rad[kept], None, whole.u_V[kept])])
    assert gap.reason.endswith("no part without one is long enough; log every tick")


def test_a_shaft_that_only_turns_backwards_under_a_drive_without_a_sign_may_be_reversed() -> None:
    turns = TimeSeries(t_s := np.linspace(0.0, 3.0, 601), -2.0 * t_s**2, None, 4.0 * t_s)
    (objection,) = judge_records([turns])
    assert "the shaft turns backwards" in objection.reason and objection.reason.endswith("--reversed")


def test_a_position_against_its_name_is_asked_about_with_what_to_type_if_the_name_is_right() -> None:
    moved = to_and_fro(0.0)
    turns = replace(moved, y_rad=110.0 * moved.y_rad, name="steps.csv")
    (objection,) = judge_records([turns])
    assert "span 54.9 rad, 8.7 turns" in objection.reason
    assert "For degrees type --position y_rad:deg; if they are radians, --position y_rad:rad" in objection.reason
    assert judge_records([replace(turns, units_stated=True)]) == []


@pytest.mark.parametrize(
    ("u_V", "lacks"),
    [
        (lambda u, way: np.abs(u), True),
        (lambda u, way: np.full_like(u, 3.0), True),
        (lambda u, way: u, False),
        (lambda u, way: np.where(way > 0.0, np.abs(u), 4.0 - np.abs(u)), False),  # a load that turns it back
    ],
)
def test_a_drive_without_its_sign_is_named(u_V: Callable[[Array, Array], Array], lacks: bool) -> None:
    t_s: Array = 0.005 * np.arange(2000.0)
    way = np.where((np.arange(2000) // 200) % 2 == 0, 1.0, -1.0)
    drive = way * np.where((np.arange(2000) // 400) % 2 == 0, 1.0, 3.0)
    y_rad: Array = np.cumsum(0.005 * 5.0 * drive)
    test = TimeSeries(t_s, y_rad, None, u_V(drive, way))
    said = [objection for objection in judge_records([test]) if "sign is missing" in objection.reason]
    assert [objection.verdict for objection in said] == (["refused"] if lacks else [])


def test_a_shaft_may_rest_at_an_end_of_its_travel_where_a_record_begins() -> None:
    """A chirp from rest was refused: "the end of the sensor's range"."""
    t_s: Array = 0.005 * np.arange(2000.0)
    rests: Array = np.concatenate((np.zeros(20), 1.0 - np.cos(2.0 * t_s[:-20])))
    noisy = rests + np.where(rests > 0.0, np.abs(np.random.default_rng(1).normal(0.0, 2e-3, rests.size)), 0.0)
    rows: Array = np.arange(rests.size, dtype=np.float64)
    for u_V, is_told in ((0.3, False), (5.0, True)):
        test = TimeSeries(t_s, noisy, None, np.where(rows < 25, u_V, 5.0 * np.sin(rows)))
        assert any("end of the sensor's range" in one.reason for one in judge_records([test])) == is_told


@pytest.mark.parametrize(("half_s", "spoils"), [(30.0, True), (6000.0, False)])
def test_a_tau_of_no_small_motor_is_the_columns_fault_only_where_the_record_says_it(
    half_s: float, *, spoils: bool
) -> None:
    estimate = Estimate("sampled-data", 60.0, 20.0, 0.6, ci95={"tau_s": (60.0 - half_s, 60.0 + half_s)})
    [objection] = judge_motor(estimate, [to_and_fro(0.0)])
    assert (objection.verdict, objection.spoils) == ("refused", spoils)


def test_of_a_run_of_rig_nobody_is_asked_to_name_a_columns_unit() -> None:
    """Its config says it: little motion is little motion."""
    little = replace(to_and_fro(0.0), y_rad=0.04 * to_and_fro(0.0).y_rad)
    for series, words in (
        (little, "--position y_rad:rad"),
        (replace(little, stage=Stage.test(StageKind.RELAY, 1)), "its config"),
    ):
        (reason,) = [one.reason for one in judge_records([series]) if "span only" in one.reason]
        assert words in reason


def test_the_drift_of_a_summed_velocity_is_no_turn_where_the_drive_never_asks_for_one() -> None:
    """It was taken for one: f_c came out 45 % off, graded exact."""
    t_s: NDArray[np.float64] = np.linspace(0.0, 19.99, 2000)
    u_V = np.where(t_s % 4.0 < 2.0, 0.0, 3.0)
    drift_rad = np.cumsum(0.0005 * np.random.default_rng(3).normal(size=t_s.size))
    drifts = TimeSeries(t_s, np.cumsum(0.05 * u_V) + drift_rad, t_s, u_V)
    assert one_way([drifts]) and one_way([replace(drifts, y_rad=-drifts.y_rad)])
    assert not one_way([replace(drifts, u_V=np.where(u_V == 0.0, -0.1, u_V))])


def test_of_several_gaps_the_largest_is_named_and_the_longest_part_without_one() -> None:
    whole = replace(_test_of_run("relay-1", 1.0), stage=None, t_u_s=None)
    kept = np.ones(whole.t_s.size, dtype=bool)
    kept[100:120] = kept[400:410] = False  # of 601: 100 rows, 280, 191
    test = replace(whole, t_s=whole.t_s[kept], y_rad=whole.y_rad[kept], u_V=whole.u_V[kept], first_row=10)
    (objection,) = judge_records([test])
    assert "2 gaps, the largest a gap of 0.21 s after row 109" in objection.reason
    assert "(--rows 110:389)" in objection.reason


def test_parts_between_gaps_are_series_of_their_own_and_short_or_idle_ones_are_left_out() -> None:
    whole = replace(_test_of_run("relay-1", 1.0), stage=None, t_u_s=None)
    kept = np.ones(whole.t_s.size, dtype=bool)
    kept[100:120] = kept[130:140] = kept[400:410] = False  # of 601: 100 rows, 10, 260, 191
    test = replace(whole, t_s=whole.t_s[kept], y_rad=whole.y_rad[kept], u_V=whole.u_V[kept], first_row=10)
    parts, (said,) = without_holes(test)
    assert [(part.first_row, len(part), part.name) for part in parts] == [
        (10, 100, test.name), (120, 260, test.name), (380, 191, test.name)
    ]  # fmt: skip
    assert (
        "3 gaps, the largest a gap of 0.21 s after row 109" in said
        and "10 rows in short or steady parts were left out" in said
    )
    idle = replace(test, u_V=np.where(test.t_s > whole.t_s[405], 0.0, test.u_V))
    idle = replace(idle, y_rad=np.where(test.t_s > whole.t_s[405], 1.0, test.y_rad))
    assert [part.first_row for part in without_holes(idle)[0]] == [10, 120]
    steady = replace(test, u_V=np.where(test.t_s > whole.t_s[405], 3.0, test.u_V))  # in it no fit finds a drive
    assert [part.first_row for part in without_holes(steady)[0]] == [10, 120]
    rare = np.zeros(whole.t_s.size, dtype=bool)
    rare[::10] = rare[:50] = True
    few = replace(whole, t_s=whole.t_s[rare], y_rad=whole.y_rad[rare], u_V=whole.u_V[rare])
    assert without_holes(few) == ([few], [])


def test_a_lost_row_is_a_gap_where_the_drive_stepped_meanwhile() -> None:
    whole = replace(_test_of_run("relay-1", 1.0), stage=None, t_u_s=None)
    steps = np.flatnonzero(np.diff(whole.u_V))
    kept = np.ones(601, dtype=bool)
    kept[[steps[2] + 1, steps[5] + 1, steps[3] + 20]] = False
    lost = replace(whole, t_s=whole.t_s[kept], y_rad=whole.y_rad[kept], u_V=whole.u_V[kept])
    parts, (said,) = without_holes(lost)
    assert [part.first_row for part in parts] == [0, steps[2] + 1, steps[5] - 1] and "2 gaps" in said
    changes = np.append(True, whole.u_V[1:] != whole.u_V[:-1]) | (
        np.arange(601) % 3 == 0
    )  # a row where something changes
    rare = replace(whole, t_s=whole.t_s[changes], y_rad=whole.y_rad[changes], u_V=whole.u_V[changes])
    assert without_holes(rare) == ([rare], [])


def test_a_position_that_is_set_anew_begins_another_part_and_a_spike_does_not() -> None:
    whole = replace(_test_of_run("relay-1", 1.0), stage=None, t_u_s=None)
    anew = replace(whole, y_rad=whole.y_rad - np.where(np.arange(601) > 250, 0.7, 0.0))
    parts, (said,) = without_holes(anew)
    assert [part.first_row for part in parts] == [0, 251] and "set anew after row 250" in said
    kick = replace(anew, u_V=np.where(np.arange(601) == 250, -3.0 * np.abs(anew.u_V).max(), anew.u_V))
    assert without_holes(kick) == ([kick], [])
    spike = replace(whole, y_rad=whole.y_rad + np.where(np.arange(601) == 250, 0.7, 0.0))
    assert without_holes(spike) == ([spike], []) and without_holes(whole) == ([whole], [])
    rests = np.arange(601) < 60
    speed = np.where(rests, 0.0, 1.0 - np.exp(-(whole.t_s - whole.t_s[60]) / 0.02))
    begins = replace(whole, y_rad=np.cumsum(0.01 * speed), u_V=np.where(rests, 0.0, 3.0))
    assert without_holes(begins) == ([begins], [])
    turns = replace(whole, y_rad=np.sin(whole.t_s), u_V=np.cos(whole.t_s))  # in a gap it moves on
    kept = np.abs(np.arange(601) - 240) > 1
    lost = replace(turns, t_s=turns.t_s[kept], y_rad=turns.y_rad[kept], u_V=turns.u_V[kept])
    assert without_holes(lost) == ([lost], [])


def test_a_part_of_a_file_may_lack_what_another_part_tells() -> None:
    whole = replace(_test_of_run("relay-1", 1.0), stage=None, t_u_s=None)
    little = replace(whole, y_rad=0.001 * whole.y_rad)
    assert judge_records([little]) and not judge_records([whole, little])
    assert judge_records([whole, replace(little, name="another")])
    fine = replace(whole, y_rad=30.0 * np.sin(whole.t_s), u_V=np.cos(whole.t_s))
    seems_coarse = replace(fine, y_rad=0.11 * np.round(fine.y_rad / 0.11))
    assert not judge_records([fine, seems_coarse])
    assert "in degrees" in judge_records([fine, replace(seems_coarse, name="another")])[0].reason


def test_a_quick_motor_turns_far_from_row_to_row_and_a_jump_that_no_motor_explains_is_one() -> None:
    t_s: NDArray[np.float64] = 0.005 * np.arange(400.0)
    way = np.tile(np.repeat([1.0, 0.0, -1.0, 0.0], [3, 22, 3, 22]), 8)
    y_rad = np.cumsum(0.9 * way) + np.random.default_rng(1).normal(0.0, 0.001, 400)
    test = TimeSeries(t_s, y_rad, None, 5.0 * way)
    quick = Estimate("sampled-data", 0.005, 40.0, 0.1, rms_rad=0.01)
    said = [[one for one in judge_records([test], motor) if "jumps" in one.reason] for motor in (quick, None)]
    assert (len(said[0]), len(said[1])) == (0, 1)
    assert any("jumps" in one.reason for one in judge_records([test], replace(quick, rms_rad=1.0)))


def test_a_shaft_whose_reading_lags_does_not_turn_against_its_drive() -> None:
    """The work of a relay was negative behind a filter of 60 ms: rig asked for --reversed."""
    t_s: NDArray[np.float64] = 0.01 * np.arange(600.0)
    test = TimeSeries(t_s, np.sin(6.0 * t_s), None, np.sign(np.cos(6.0 * t_s + 2.8)))
    lagging = Estimate("sampled-data", 0.1, 4.0, 0.1, rms_rad=0.01)
    for motor, said in (
        (lagging, 0),
        (None, 1),
        (replace(lagging, rms_rad=0.5), 1),
        (replace(lagging, delay_s=0.2), 1),
    ):
        assert sum("against its drive" in one.reason for one in judge_records([test], motor)) == said


@pytest.mark.parametrize(
    ("degrees", "stated", "verdicts"),
    [(True, False, ["doubtful"]), (True, True, ["ok"]), (False, False, []), (None, False, [])],
)
def test_degrees_that_a_fine_encoder_reads_show_as_a_speed_of_few_motors(
    *, degrees: bool | None, stated: bool, verdicts: list[str]
) -> None:
    """Of 16,384 counts a turn: in degrees their step divides no turn. A slower motor's speed tells nothing."""
    turn = 2.0 * np.pi if degrees is False else 360.0
    y_rad = turn / 16384 * np.round(4000.0 * np.sin(12.0 * to_and_fro(0.0).t_s))
    K = 20.0 if degrees is None else 126.0
    test = replace(to_and_fro(0.0), y_rad=y_rad, u_V=12.0 * to_and_fro(0.0).u_V, units_stated=stated)
    objections = judge_motor(Estimate("sampled-data", 0.08, K, 0.4), [test])
    assert [one.verdict for one in objections] == verdicts
    for one in objections:
        assert "1462 rad/s, 13,958 turns a minute" in one.reason and "in degrees?" in one.reason
    assert (
        judge_motor(Estimate("sampled-data", 0.08, K, 0.4), [replace(test, stage=Stage.test(StageKind.RELAY, 1))]) == []
    )
