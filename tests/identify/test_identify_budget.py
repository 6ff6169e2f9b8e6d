"""The uncertainty budget: its sums against closed forms, and what the verdict makes of them."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from synthetic import LSB_RAD, Bench, dcr, motor, record, simulate

from campaign_real.kinds import KINDS, case
from rig.config.campaign import Campaign
from rig.control.simulation import Sampling
from rig.control.simulation import simulate as simulate_real
from rig.core.signals import Sample
from rig.identification import identify, sampled_data
from rig.identification.departures import DEPARTURES
from rig.identification.departures.budget import COVERAGE, PRESENT, Budget, Entry, Hidden, Shifts, absolute, instead_of
from rig.identification.departures.departure import Departure
from rig.identification.departures.in_place import InPlace
from rig.identification.departures.laws import BY_NAME, SOFT_COUPLING
from rig.identification.departures.nuisances import Nuisance
from rig.identification.departures.profile import Profile
from rig.identification.identification import Identification, other_times_explain
from rig.identification.model_error import TIMES
from rig.identification.stated_errors import CLOCK_ERROR, ScaleErrors, StatedErrors
from rig.model.real_motor import RealMotor
from rig.output.text import law_causes
from rig.run_folder.recording.recording import from_columns
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.results import RunMeta, SensorBelieved, SupplyBelieved
from rig.run_folder.results.budget_lines import BudgetLine, that_matter

OF = ("tau_s", "K_rad_s_V", "fc_V")
LAW = {law.name: law for law in DEPARTURES}
STATED = RunMeta(
    sensor=SensorBelieved(
        linearity_percent=0.2, full_range_rad=5.0, calibration_error_rad=0.02, calibration_rad=(-2.0, 2.0)
    ),
    drive=SupplyBelieved(supply_error_percent=3.0),
)


@cache
def relay_test(h1_V: float = 0.8, h2_V: float = 1.0) -> TimeSeries:
    bench = Bench(noise_rad=0.002, lsb_rad=LSB_RAD)
    return record(simulate(motor(), dcr(h1_V, h2_V), 900, bench), True, 100)


def test_drives_that_may_all_have_acted_earlier_or_later_than_they_say_widen_tau_by_as_much() -> None:
    """A servo without a clock: tau was 0.4 % too small beside 0.08 %."""
    test, shift_s, truth_s = relay_test(), 1e-3, motor().tau_s
    assert test.t_u_s is not None
    off = replace(test, t_u_s=test.t_u_s + shift_s)
    tau_s, u95_s, told = {}, {}, {}
    for told_s in (None, shift_s):
        found = identified(off, meta=RunMeta(times_error_s=shift_s, times_shift_s=told_s), methods=("sampled-data",))
        assert found.motor_law is not None
        told[told_s] = any(entry.source == TIMES for entry in found.motor_law.budget.entries)
        tau_s[told_s], u95_s[told_s] = found.estimates["sampled-data"].tau_s, found.motor_law.budget.u95["tau_s"]
    assert tau_s[None] == tau_s[shift_s] and told == {None: False, shift_s: True}
    assert u95_s[None] < abs(tau_s[None] - truth_s) < u95_s[shift_s]


def identified(*tests: TimeSeries, meta: RunMeta | None = None, **how: Any) -> Identification:
    recordings = [
        from_columns(Path(f"test-{k}.csv"), t.t_s, t.u_V, t.y_rad, t.t_u_s, meta=meta) for k, t in enumerate(tests)
    ]
    return identify(recordings, **how)


@cache
def two_amplitudes() -> Identification:
    return identified(relay_test(), relay_test(0.55, 0.8), meta=STATED, methods=("sampled-data",))


# -- scales -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scale", "power"), [("volt", (0, -1, 1)), ("radian", (0, 1, 0)), ("second", (1, -1, 0))])
def test_a_scale_that_is_wrong_moves_the_estimate_as_its_line_says(scale: str, power: tuple[int, ...]) -> None:
    """The same record in other units, identified again: tau, K and f_c scale exactly, as the lines have it."""
    one = relay_test()
    share = 0.013
    assert one.t_u_s is not None
    by = {"volt": 1.0, "radian": 1.0, "second": 1.0} | {scale: 1.0 + share}
    other = replace(
        one,
        t_s=one.t_s * by["second"],
        t_u_s=one.t_u_s * by["second"],
        u_V=one.u_V * by["volt"],
        y_rad=one.y_rad * by["radian"],
    )
    before, after = sampled_data.fit([one]), sampled_data.fit([other])
    moved = [getattr(after, name) / getattr(before, name) for name in OF]
    assert moved == pytest.approx([(1.0 + share) ** p for p in power], abs=1e-5)
    found = absolute(
        RealMotor(*(getattr(before, name) for name in OF)), ScaleErrors(**dict.fromkeys(by, 0.0) | {scale: share})
    )
    parts = [math.hypot(*(getattr(entry, name) for entry in found)) / getattr(before, name) for name in OF]
    assert parts == pytest.approx([COVERAGE * share * abs(p) for p in power])


def test_two_calibrated_angles_give_the_slope_between_them() -> None:
    stated = StatedErrors(calibration_error_rad=0.01, calibration_rad=(-1.5, 2.5))
    exact = 0.01 * math.sqrt(2.0 / 3.0) / 4.0
    assert stated.radian_error(-0.4, 0.6) == pytest.approx(exact)
    assert stated.radian_error(3.0, 4.0) == pytest.approx(exact)  # beyond the angles the line goes on
    assert StatedErrors(calibration_error_rad=0.01).radian_error(-0.5, 0.5) == pytest.approx(4.0 * exact)


def test_a_table_of_angles_counts_by_the_best_line_over_the_travel() -> None:
    """Against random errors of each angle, drawn and fitted."""
    angles = np.array([-2.0, -0.6, 0.1, 0.9, 2.0])
    rng = np.random.default_rng(1)
    y = np.linspace(-0.8, 1.0, 400)
    wrong = rng.uniform(-0.01, 0.01, (4000, angles.size))
    slopes = np.polyfit(y, np.array([np.interp(y, angles, one) for one in wrong]).T, 1)[0]
    stated = StatedErrors(calibration_error_rad=0.01, calibration_rad=tuple(angles.tolist()))
    assert stated.radian_error(-0.8, 1.0) == pytest.approx(float(np.std(slopes)), rel=0.04)


def test_errors_are_read_from_meta_and_an_older_one_has_the_defaults() -> None:
    stated = StatedErrors.of(STATED)
    assert stated == StatedErrors(0.2, 5.0, 0.02, (-2.0, 2.0), 3.0)
    assert stated.linearity_rad(1.0) == pytest.approx(0.01)
    old = StatedErrors.of(RunMeta(drive=SupplyBelieved(supply_V=12.0)))
    assert repr(old) == repr(StatedErrors())  # the range is nan: not known
    assert old.linearity_rad(1.0) == pytest.approx(0.01 * old.linearity_percent)
    damaged = STATED.model_copy(update={"drive": SupplyBelieved(supply_error_percent=-1.0)})
    assert StatedErrors.of(damaged).supply_error_percent == StatedErrors().supply_error_percent


# -- laws -------------------------------------------------------------------------------------------------------------


TWO_SIDED = np.zeros(3, dtype=bool)
FROM_0 = np.zeros(3)  # means of laws beforehand


def nuisance(law: Departure, first: int, starts: int = 1) -> Nuisance:
    return Nuisance(law, first, 1, starts)


@pytest.mark.parametrize("mean_before", [0.0, 2.0])
def test_the_odds_of_laws_and_what_they_move_are_those_integrals(mean_before: float) -> None:
    """Two nuisances against a sum over a grid of their sizes, also where the size of one is known beforehand."""
    centre = np.array([mean_before, 0.0])
    inside = np.array([[3.0, -2.2], [-2.2, 2.5]])
    pull = np.array([-0.7, 1.1])
    moves = np.array([[0.2, 0.1], [1.0, -0.3], [0.0, 0.5]])
    odds, mean, variance = Shifts(np.ones(3), moves, inside, pull, centre, TWO_SIDED[:2]).by(np.array([[0, 1]]))
    x = np.linspace(-8.0, 8.0, 801)
    a, b = np.meshgrid(x, x)
    size = np.stack((a.ravel(), b.ravel()))
    weight = np.exp(-0.5 * np.sum(size * (inside @ size), axis=0) - pull @ size)
    weight *= np.exp(-0.5 * np.sum((size - centre[:, None]) ** 2, axis=0))
    total = weight.sum()
    assert odds[0] == pytest.approx(total * (x[1] - x[0]) ** 2 / (2.0 * math.pi), rel=1e-6)
    assert mean[0] == pytest.approx((moves @ size) @ weight / total, rel=1e-6)
    assert mean[0] ** 2 + variance[0] == pytest.approx((moves @ size) ** 2 @ weight / total, rel=1e-6)


@pytest.mark.parametrize("pull", [-3.0, 0.0, 4.0])
def test_a_law_that_is_never_below_0_is_weighed_above_it(pull: float) -> None:
    """Against a sum over a grid of its sizes from 0 on, where it is twice as dense beforehand."""
    moves = np.array([[0.2], [-1.0], [0.5]])
    shifts = Shifts(np.ones(3), moves, np.array([[3.0]]), np.array([pull]), FROM_0, np.array([True]))
    odds, mean, variance = shifts.by(np.array([[0]]))
    size = np.linspace(0.0, 9.0, 200_001)
    weight = 2.0 * np.exp(-0.5 * 3.0 * size**2 - pull * size) * norm.pdf(size)
    total = weight.sum()
    assert odds[0] == pytest.approx(total * size[1], rel=1e-3)
    assert mean[0] == pytest.approx((moves * size) @ weight / total, rel=1e-3)
    assert variance[0] == pytest.approx((moves * size) ** 2 @ weight / total - mean[0] ** 2, rel=1e-3)


@pytest.mark.parametrize("coupling", [-2.5, 0.0, 2.5])
@pytest.mark.parametrize("pull", [(-0.7, 1.1), (-2.0, -2.0), (2.0, 0.5)])
def test_two_laws_that_are_never_below_0_are_weighed_there(coupling: float, pull: tuple[float, float]) -> None:
    """Against a sum over a grid: what is left of the first counts as normal for the second."""
    inside, moves = np.array([[3.0, coupling], [coupling, 3.0]]), np.array([[0.2, 0.1], [1.0, 0.3], [0.0, 0.5]])
    shifts = Shifts(np.ones(3), moves, inside, np.array(pull), FROM_0, np.array([True, True]))
    odds, mean, variance = shifts.by(np.array([[0, 1]]))
    x = np.linspace(0.0, 6.0, 601) + 0.005
    size = np.stack([axis.ravel() for axis in np.meshgrid(x, x)])
    weight = 4.0 * np.exp(-0.5 * np.sum(size * (inside @ size), axis=0) - np.array(pull) @ size)
    weight *= norm.pdf(size).prod(axis=0)
    assert odds[0] == pytest.approx(weight.sum() * 1e-4, rel=0.02)
    moved = moves @ size
    assert mean[0] == pytest.approx(moved @ weight / weight.sum(), rel=0.08)
    assert np.sqrt(mean[0] ** 2 + variance[0]) == pytest.approx(np.sqrt(moved**2 @ weight / weight.sum()), rel=0.1)


def test_an_improbable_law_that_would_break_the_promise_is_counted_by_its_probability() -> None:
    laws = [nuisance(LAW["drag"], 0)]
    shifts = Shifts(
        np.ones(3), np.array([[0.0], [0.1], [0.0]]), np.zeros((1, 1)), np.zeros(1), FROM_0, np.array([True])
    )
    probability, named = Hidden.of(shifts, laws).beyond("K_rad_s_V", 0.1)
    assert named == ("drag",)
    assert probability == pytest.approx(PRESENT * 2.0 * norm.sf(1.0), rel=0.2)  # of a half normal distribution
    assert Hidden.of(shifts, laws).beyond("tau_s", 0.1)[0] == 0.0


@pytest.mark.parametrize("pull", [2e3, 3e4, 1e6])
def test_a_law_far_below_0_leaves_numbers_that_are_numbers(pull: float) -> None:
    laws = [nuisance(LAW["drag"], 0), nuisance(LAW["sag"], 1)]
    one_sided = np.array([True, False])
    shifts = Shifts(np.ones(3), np.full((3, 2), 0.1), 3.0 * np.eye(2), np.array([pull, 0.0]), FROM_0, one_sided)
    hidden = Hidden.of(shifts, laws)
    assert np.all(hidden.variance >= 0.0)
    for name in OF:
        assert 0.0 < hidden.beyond(name, 0.1)[0] < 0.1


def test_a_law_that_the_record_cannot_see_keeps_its_whole_range_and_its_odds() -> None:
    shifts = Shifts(
        np.ones(3), np.array([[0.3], [0.1], [0.0]]), np.zeros((1, 1)), np.zeros(1), FROM_0, np.array([True])
    )
    [entry] = Hidden.of(shifts, [nuisance(LAW["drag"], 0)]).lines()
    assert (entry.source, entry.laws) == ("drag", ("drag",))
    assert entry.tau_s == pytest.approx(COVERAGE * math.sqrt(PRESENT) * 0.3)


def test_three_laws_that_hide_each_other_count_though_each_alone_is_excluded() -> None:
    """Their sum acts as nothing on the record: it says much of each, and nothing of all three."""
    laws = [nuisance(law, k) for k, law in enumerate((LAW["drag"], LAW["sag"], LAW["stribeck"]))]
    away = np.eye(3) - np.ones((3, 3)) / 3.0
    shifts = Shifts(np.ones(3), np.full((3, 3), 0.1), 1e9 * away, np.zeros(3), FROM_0, TWO_SIDED)
    entries = {entry.source: entry for entry in Hidden.of(shifts, laws).lines()}
    together = entries.pop("laws that hide each other")
    assert set(together.laws) == {"drag", "sag", "stribeck"}
    assert all(together.tau_s > 10.0 * entry.tau_s for entry in entries.values())


def test_a_soft_coupling_is_more_likely_than_other_laws() -> None:
    shifts = Shifts(np.ones(3), np.full((3, 1), 0.1), np.zeros((1, 1)), np.zeros(1), FROM_0, np.array([True]))
    [entry] = Hidden.of(shifts, [nuisance(SOFT_COUPLING, 0)]).lines()
    odds = 4.0 * PRESENT / (1.0 - PRESENT)
    assert entry.tau_s == pytest.approx(COVERAGE * math.sqrt(odds / (1.0 + odds)) * 0.1)


def test_a_law_with_several_starts_has_its_odds_once() -> None:
    shifts = Shifts(np.ones(3), np.full((3, 3), 0.1), np.zeros((3, 3)), np.zeros(3), FROM_0, np.ones(3, dtype=bool))
    [entry] = Hidden.of(shifts, [nuisance(LAW["stribeck"], k, 3) for k in range(3)]).lines()
    assert entry.tau_s == pytest.approx(COVERAGE * math.sqrt(PRESENT) * 0.1)


def test_a_law_that_is_known_size_by_size_has_the_odds_of_each() -> None:
    """Two sizes that the record tells apart: by hand."""
    moves = np.array([[0.01, 0.2, 0.03], [0.02, 0.4, 0.06]])
    known = Profile(LAW["dead_band"], np.array([0.5, 0.25 * math.exp(-1.0)]), moves, np.zeros((2, 3)))
    none = Shifts(np.ones(3), np.zeros((3, 1)), np.zeros((1, 1)), np.zeros(1), FROM_0, np.ones(1, dtype=bool))
    hidden = Hidden.of(none, [nuisance(LAW["dead_band"], 0)], [known])
    odds = PRESENT / (1.0 - PRESENT) * np.array([0.5, 0.25 * math.exp(-1.0)])
    chances = odds / (1.0 + odds.sum())
    [entry] = hidden.lines()
    assert entry.source == "dead_band"
    assert entry.fc_V == pytest.approx(COVERAGE * math.sqrt(chances @ moves[:, 2] ** 2))
    assert hidden.beyond("fc_V", 0.05)[0] == pytest.approx(chances[1])


def test_a_law_that_explains_as_well_in_place_of_another_is_as_likely() -> None:
    moves = np.array([0.01, 0.2, 0.03])
    [entry] = instead_of([InPlace(LAW["drag"], LAW["stribeck"], 0.0, moves)])
    assert entry.source == "another law instead of drag"
    assert [entry.tau_s, entry.K_rad_s_V, entry.fc_V] == pytest.approx((COVERAGE * math.sqrt(0.5) * moves).tolist())
    [rare] = instead_of([InPlace(LAW["drag"], LAW["stribeck"], 20.0, moves)])
    assert rare.tau_s < 0.01 * entry.tau_s


def test_the_sums_are_roots_of_squares_and_only_the_absolute_one_has_the_scales() -> None:
    found = Budget(
        (Entry("scatter", 3.0, 0.0, 1.0), Entry("drag", 4.0, 2.0, 1.0), Entry("supply", 0.0, 1.5, 1.0, True))
    )
    assert found.u95 == pytest.approx({"tau_s": 5.0, "K_rad_s_V": 2.0, "fc_V": math.sqrt(2.0)})
    assert found.u95_absolute == pytest.approx({"tau_s": 5.0, "K_rad_s_V": 2.5, "fc_V": math.sqrt(3.0)})


# -- verdict ----------------------------------------------------------------------------------------------------------


def test_two_amplitudes_are_ok_and_the_result_says_what_ok_asks_for() -> None:
    found = two_amplitudes()
    estimate = found.estimates["sampled-data"]
    assert estimate.verdict == "ok", estimate.reasons
    result = found.as_result()
    assert result.ok_asks_u95_percent == 2.5
    answer = result.answer
    assert answer is not None and answer.u95 is not None and answer.u95_absolute is not None
    assert all((answer.u95[name] or math.inf) <= 0.025 * getattr(estimate, name) for name in OF)
    by_source = {entry.source: entry for entry in result.budget or ()}
    assert [source for source, entry in by_source.items() if entry.absolute] == ["supply", "calibration", "clock"]
    gain = estimate.K_rad_s_V
    bounds = {"supply": 0.03, "calibration": 0.02 * math.sqrt(2.0) / 4.0, "clock": CLOCK_ERROR}
    for source, bound in bounds.items():
        assert by_source[source].K_rad_s_V == pytest.approx(2.0 * bound / math.sqrt(3.0) * gain, rel=1e-3)
    assert (answer.u95_absolute["K_rad_s_V"] or 0.0) > 0.03 * gain


@pytest.mark.parametrize(("probability", "bears"), [(0.009, True), (0.02, False)])
def test_ok_bears_one_percent_of_an_improbable_law_that_would_break_its_promise(
    probability: float, bears: bool
) -> None:
    """A dead band that would move friction by 12 %: as a root mean square it is below what u95 may be."""
    law = two_amplitudes().motor_law
    assert law is not None
    estimate = two_amplitudes().estimates["sampled-data"]
    moves = np.array([[0.0, 0.0, 0.12 * estimate.fc_V]])
    hidden = Hidden((("dead_band",),), np.array([probability]), moves, np.zeros((1, 3)))
    reasons = replace(law, budget=replace(law.budget, hidden=hidden)).reservations(estimate, 1.0)
    if bears:
        assert reasons == []
    else:
        [reason] = reasons
        assert reason.startswith("f_c is more than 5 % off with a probability of 2 %; ok bears 1 %: ")
        assert "dead band of the drive, which these tests do not exclude; record " in reason


def test_a_plain_estimate_that_is_off_by_a_fit_in_pieces_which_is_refused_is_not_said_to_be_from_it() -> None:
    law, plain = two_amplitudes().motor_law, two_amplitudes().estimates["sampled-data"]
    assert law is not None and not law.found
    pieces = replace(plain, K_rad_s_V=3.0 * plain.K_rad_s_V, verdict="refused")
    said = replace(law, estimate=pieces).instead_of(plain, 1.0)
    assert said is not None and said.endswith("by all records in pieces: and that fit is refused")


@pytest.mark.parametrize(
    ("law_of_each", "told_by"),
    [("level_each", "all of it in one recording"), ("drift_each", "one long recording after the bench has warmed up")],
)
def test_laws_that_are_not_told_apart_are_said_though_one_is_of_each_recording(law_of_each: str, told_by: str) -> None:
    """It was an exception, and no answer; and an answer named the law in no words."""
    assert law_of_each in law_causes()
    law = two_amplitudes().motor_law
    assert law is not None
    notes = replace(law, not_told_apart=((law_of_each, "dead_band"),)).notes()
    words = f"law: {BY_NAME[law_of_each].title} and dead band of the drive are not told apart; record {told_by}"
    assert notes[-1] == words


def test_one_amplitude_is_doubtful_and_the_reason_says_what_would_tell() -> None:
    found = identified(relay_test(), methods=("sampled-data",))
    [reason] = found.estimates["sampled-data"].reasons
    assert reason.startswith("K is more than 5 % off with a probability of ")
    assert "; ok bears 1 %: most of it is sag of the drive, which these tests do not exclude; " in reason
    assert reason.endswith("; record a relay test of another amplitude")


def test_another_method_alone_is_judged_by_the_same_budget() -> None:
    found = identified(relay_test(), methods=("triple-relay",))
    assert list(found.estimates) == ["triple-relay"]
    answer = found.answer
    assert answer is not None and (answer.method, answer.verdict) == ("triple-relay", "doubtful")
    assert answer.u95 is not None


def test_without_a_budget_nothing_is_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*given: object, **named: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(sys.modules["rig.identification.identification"], "motor_law", fails)
    estimate = identified(relay_test(), relay_test(0.55, 0.8), methods=("sampled-data",)).estimates["sampled-data"]
    assert estimate.verdict == "doubtful"
    assert any("there is no u95: these tests give no answer (SVD did not converge)" in r for r in estimate.reasons)


def test_a_plain_estimate_far_from_that_with_the_laws_is_not_ok() -> None:
    found = two_amplitudes()
    law, plain = found.motor_law, found.estimates["sampled-data"]
    assert law is not None
    own = replace(law, estimate=replace(plain, K_rad_s_V=1.04 * plain.K_rad_s_V))
    assert any(r.startswith("K is 4 % off, by all records in pieces") for r in own.reservations(plain, 1.8))
    near = replace(law, estimate=replace(plain, K_rad_s_V=1.01 * plain.K_rad_s_V))
    assert near.reservations(plain, 1.8) == []


@cache
def with_a_load() -> Identification:
    """A load that pulls over the travel: no plain motor explains either test, one motor with the load explains both."""
    kind = next(kind for kind in KINDS if kind.name == "force_over_position 0.2")
    return identify(case(Campaign(name="real", experiments=1, seed=1), 1, [kind]).recordings(), ("sampled-data",))


@pytest.mark.evidence
def test_where_a_law_explains_the_tests_the_plain_estimate_sends_to_it_before_all_else() -> None:
    reasons = with_a_load().estimates["sampled-data"].reasons
    assert reasons[0].endswith("% off, for the motor has force over position: the answer has it")
    assert len(reasons) == 2 and "do not agree" in reasons[1]


def test_one_motor_with_a_law_is_not_doubted_because_it_looks_like_two_plain_ones() -> None:
    found = with_a_load()
    assert any("do not agree" in reason for reason in found.estimates["sampled-data"].reasons)
    answer = found.answer
    assert answer is not None
    assert answer.verdict == "ok", answer.reasons


@pytest.mark.evidence
def test_another_supply_between_two_recordings_stays_a_doubt() -> None:
    """A motor of its own explains each of them: then a law that explains both proves nothing."""
    one, other = relay_test(), relay_test(0.55, 0.8)
    found = identified(one, replace(other, u_V=0.95 * other.u_V), methods=("sampled-data",))
    law = found.motor_law
    assert law is not None
    judged = found.estimates["sampled-data"] if law.estimate is None else law.estimate
    assert judged.verdict == "doubtful"
    assert any("do not agree" in reason for reason in judged.reasons)


@pytest.mark.parametrize(
    ("slipped_mrad", "plain_mrad", "with_laws_mrad", "explains"),
    [(3.1, 10.0, 3.0, True), (4.0, 10.0, 3.0, False), (3.34, 3.34, 3.19, False), (math.inf, 10.0, 3.0, False)],
)
def test_other_times_of_the_drive_explain_laws_away_only_where_they_better_the_plain_motor(
    slipped_mrad: float, plain_mrad: float, with_laws_mrad: float, explains: bool
) -> None:
    """The third: a load of 0.05 V, which moves f_c by 6 %, in two relay tests with 3 mrad of noise."""
    assert other_times_explain(1e-3 * slipped_mrad, 1e-3 * plain_mrad, 1e-3 * with_laws_mrad) is explains


class ToAndFro:
    """Strokes: levels, V, each until the shaft has passed its turning point, rad."""

    def __init__(self, *strokes: tuple[float, float]) -> None:
        self._strokes, self._number = strokes, 0

    def step(self, sample: Sample) -> float:
        u_V, turn_rad = self._strokes[self._number % len(self._strokes)]
        self._number += (sample.y_rad - turn_rad) * u_V > 0.0
        return self._strokes[self._number % len(self._strokes)][0]


@pytest.mark.evidence
def test_the_lag_of_a_winding_is_no_wrong_time_of_the_drive() -> None:
    """Where the device tells when its drive acted: 2 ms later would explain these strokes as well as the lag does."""
    true = RealMotor(0.083, 14.4, 0.42, lag_s=0.002)
    plans = (
        ToAndFro((0.75, 0.35), (-0.6, -0.3), (1.0, 0.2), (-0.9, -0.45)),
        ToAndFro((0.55, 0.2), (-0.75, -0.2), (0.6, 0.45), (-1.1, -0.1)),
    )
    sampling = Sampling(noise_rad=0.003, resolution_rad=LSB_RAD)
    found = identify([simulate_real(true, plan, 6.0, sampling) for plan in plans], ("sampled-data",))
    answer = found.answer
    assert answer is not None and found.motor_law is not None
    assert [one.law.name for one in found.motor_law.found] == ["lag"]
    assert answer.tau_s == pytest.approx(true.tau_s, rel=0.01)
    assert not any("t_u_s" in reason for reason in answer.reasons)


# -- lines of a table -------------------------------------------------------------------------------------------------


def test_the_lines_that_matter_are_measured_by_the_sum_that_they_count_in() -> None:
    lines = [
        BudgetLine("u95", (1.0, 1.0, math.nan), is_sum=True),
        BudgetLine("u95_absolute", (1.0, 4.0, math.nan), is_sum=True, absolute=True),
        BudgetLine("drag", (0.0, 0.3, math.nan)),
        BudgetLine("sag", (0.1, 0.1, math.nan)),
        BudgetLine("supply", (0.0, 0.3, math.nan), absolute=True),
        BudgetLine("calibration", (0.0, 3.0, math.nan), absolute=True),
    ]
    assert [line.source for line in that_matter(lines, 0.2)] == ["u95", "u95_absolute", "drag", "calibration"]
