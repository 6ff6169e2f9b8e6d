"""One estimate of everything driven: what counts, what is left out, and what is an objection."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic import LSB_RAD, Bench, dcr, motor, record, simulate

from rig.identification import identify
from rig.identification.estimate import Estimate
from rig.identification.identification import Identification
from rig.identification.motions import in_parts, motions
from rig.model.motor import State
from rig.run_folder.recording.reader import read
from rig.run_folder.recording.recording import Recording
from rig.run_folder.recording.series import TimeSeries, Window
from rig.run_folder.recording.stage import StageKind
from rig.run_folder.results import RunEvent

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "simulated"
LED_BY = ("sampled-data",)
TRUTH = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48}


@pytest.fixture(scope="module")
def run() -> Recording:
    """A whole run: breakaway, search, two relay tests, tracking."""
    return read(GOLDEN)


def leading(found: Identification) -> Estimate:
    return found.estimates["sampled-data"]


def plain(run: Recording, *without: str) -> Estimate:
    return leading(identify([run], LED_BY, choose_law=False, without=without))


def in_search(run: Recording) -> np.ndarray:
    return np.asarray(run.stage == str(StageKind.SEARCH))


def test_records_of_another_gain_are_an_objection_and_no_mean(run: Recording) -> None:
    alone = plain(run, "search", "breakaway")
    stretched = replace(run, y_rad=np.where(in_search(run), 1.05 * run.y_rad, run.y_rad))
    estimate = plain(stretched)
    assert estimate.verdict == "doubtful"
    assert any("search and the tests do not agree" in why and "K is 6.8" in why for why in estimate.reasons)
    assert estimate.K_rad_s_V == pytest.approx(alone.K_rad_s_V, rel=1e-9)


def test_a_touched_stretch_of_the_search_is_left_out_with_all_that_follows(run: Recording) -> None:
    rows = run.stage_rows("search")
    hand = np.zeros(len(run))
    middle = (rows.start + rows.stop) // 2
    hand[middle : middle + 40] = 0.25 * np.sin(np.linspace(0.0, np.pi, 40))
    found = identify([replace(run, y_rad=run.y_rad + hand)], LED_BY, choose_law=False)
    assert any("search: not in the plain motor's fit from row" in note for note in found.notes)
    for name, true in TRUTH.items():
        assert leading(found).ci95[name][0] < true < leading(found).ci95[name][1]


@pytest.mark.parametrize("rows_of_test", [0, 12])
def test_a_run_that_ends_in_its_search_or_soon_after_tells_the_motor_by_it(run: Recording, rows_of_test: int) -> None:
    last = run.stage_rows("search").stop - 1 + rows_of_test
    fault = RunEvent(t_s=float(run.t_s[last]), kind="fault", code="NO_CYCLE")
    estimate = plain(replace(run.select(0, last), events=(*run.events, fault)))
    assert estimate.verdict == "ok"
    for name, true in TRUTH.items():
        assert estimate.ci95[name][0] < true < estimate.ci95[name][1]
        assert getattr(estimate, name) == pytest.approx(true, rel=0.005)


@pytest.mark.parametrize("rows", [25, 40])
def test_a_test_that_is_too_short_to_tell_the_motor_by_itself_leaves_it_to_the_search(
    run: Recording, rows: int
) -> None:
    """Of 40 rows, one way, a fit has a covariance that is none: it ended the command."""
    short = run.select(0, run.stage_rows("relay-1").start + rows)
    assert plain(short, "search").verdict == "refused"
    found = identify([short], LED_BY, choose_law=False)
    assert any("too little alone to tell the motor" in note for note in found.notes)
    estimate = leading(found)
    assert estimate.verdict == "ok"
    for name, true in TRUTH.items():
        assert getattr(estimate, name) == pytest.approx(true, rel=0.005)


def test_short_tests_that_never_settled_are_enough_beside_the_search(run: Recording) -> None:
    """As a run has them that stops when its motor is known: a second or so of each relay."""
    first, second = run.stage_rows("relay-1"), run.stage_rows("relay-2")
    short = run.select(0, second.start + 150)
    begun = np.array([*run.stage[: first.start + 100], *(["strokes-1"] * (second.start - first.start - 100))])
    stages = np.concatenate((begun, run.stage[second.start : second.start + 151]))
    found = identify([replace(short, stage=stages)])
    assert leading(found).verdict == "ok", leading(found).reasons
    assert found.relays == []
    assert all(found.estimates[name].verdict == "refused" for name in found.estimates.keys() - {"sampled-data"})
    assert any("describing-function: " in note for note in found.notes)


def strokes(levels_V: tuple[float, ...], rows: int, fs_V: float) -> TimeSeries:
    """Strokes of each level to and fro, half a second each, half a second of rest between."""

    def law(t_s: float, y_rad: float, z_rad_s: float) -> float:
        k, phase = divmod(t_s, 1.0)
        return (-1.0) ** k * levels_V[int(k) % len(levels_V)] if phase >= 0.5 else 0.0

    bench = Bench(noise_rad=0.003, lsb_rad=LSB_RAD)
    return record(simulate(motor(fc_V=0.4, fs_V=fs_V), law, rows, bench, State()))


def test_motions_begin_and_end_at_rest() -> None:
    series = strokes((0.9,), 600, 0.4)
    found = motions(Window(series, 0, len(series)), 0.0032, LSB_RAD)
    assert len(found) == 6
    for k, motion in enumerate(found):
        assert motion.from_rest
        assert 100 * k + 35 <= motion.first <= 100 * k + 50  # a few rows at rest, then the drive
        assert 100 * k + 100 <= motion.stop <= 100 * k + 135


def test_a_drive_that_friction_holds_is_no_motion() -> None:
    series = strokes((0.42, 0.9), 600, 0.48)  # every other stroke is between moving and static friction
    found = motions(Window(series, 0, len(series)), 0.0032, LSB_RAD)
    assert [motion.first // 100 for motion in found] == [1, 3, 5]


def test_a_relay_test_is_one_motion() -> None:
    bench = Bench(noise_rad=0.003, lsb_rad=LSB_RAD)
    series = record(simulate(motor(), dcr(0.42, 0.84), 1000, bench))
    found = motions(Window(series, 0, len(series)), 0.0032, LSB_RAD, through=True)
    assert [(motion.first, motion.stop) for motion in found] == [(0, 1000)]
    parts = in_parts(found, 300)
    assert [(part.first, part.stop) for part in parts] == [(0, 333), (333, 667), (667, 1000)]


def test_a_shaft_at_rest_has_no_motions() -> None:
    series = strokes((0.3,), 300, 0.4)
    assert motions(Window(series, 0, len(series)), 0.0032, LSB_RAD) == []
