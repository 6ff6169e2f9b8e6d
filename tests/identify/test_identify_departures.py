"""Motors that are not what the plain model says, simulated by another integrator: their laws, numbers and budgets."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from evidence import evidence
from synthetic import dcr, record, simulate

from campaign_real.departing_motor import Bench, Departures, PlainMotor, relay_test
from campaign_real.kinds import KINDS, Case, case
from rig.config.campaign import Campaign
from rig.identification import sampled_data
from rig.identification.departures import DEPARTURES, laws
from rig.identification.departures.choice import Columns
from rig.identification.departures.fit import CORE, Known, Normal, Problem, limits_of, solve, start
from rig.identification.departures.pieces import Cut
from rig.identification.estimate import Estimate
from rig.identification.identification import Identification, identify
from rig.identification.motor_law import _listed, motor_law
from rig.identification.thinning import thinned
from rig.model.friction import coulomb, tustin
from rig.model.motor import Motor
from rig.model.real_motor import PARTS, Frame, RealMotor
from rig.run_folder.recording.series import TimeSeries
from shared.pieces import Pieces, response

pytestmark = pytest.mark.long

CAMPAIGN = Campaign(name="real", experiments=1, seed=1)
BY_NAME = {kind.name: kind for kind in KINDS}
OF = ("tau_s", "K_rad_s_V", "fc_V")


def _case(name: str, number: int = 1) -> Case:
    return case(CAMPAIGN, number, [BY_NAME[name]])


def _identified(one: Case) -> Identification:
    return identify(one.recordings(), ("sampled-data",))


@functools.cache
def _found(name: str) -> tuple[Case, Identification]:
    one = _case(name)
    return one, _identified(one)


def _estimate(found: Identification) -> Estimate:
    law = found.motor_law
    return (None if law is None else law.estimate) or found.estimates["sampled-data"]


def _errors(found: Identification, one: Case) -> list[float]:
    estimate = _estimate(found)
    return [abs(getattr(estimate, name) / getattr(one.truth, name) - 1.0) for name in OF]


def test_there_is_a_law_for_each_part_of_the_model() -> None:
    assert [law.name for law in DEPARTURES] == list(PARTS)
    for law in DEPARTURES:
        assert set(law.fields) == set(PARTS[law.name])


@pytest.mark.parametrize(
    "name",
    [
        "force_over_position 0.05",
        "backlash 10",
        *evidence(
            "dead_band 0.05",
            "stribeck 0.15",
            "gain_by_sign 3",
            "sag 3",
            "lag 10",
            "viscous_by_direction 10",
            "drag 0.05",
            "bristle 30",
            "friction_over_position 10",
            "cogging 0.05",
            "linearity 10",
            "drift 15",
        ),
    ],
)
def test_the_law_of_a_motor_is_named_and_its_numbers_are_right_with_it(name: str) -> None:
    one, found = _found(name)
    assert found.motor_law is not None
    named = [law.law.name for law in found.motor_law.found]
    alike = {other for group in found.motor_law.not_told_apart if len(group) <= 3 for other in group}
    assert name.split()[0] in {*named, *alike}
    u95 = found.motor_law.budget.u95
    estimate = _estimate(found)
    assert all(abs(getattr(estimate, key) - getattr(one.truth, key)) < u95[key] for key in OF)
    assert max(_errors(found, one)) < 0.025
    assert estimate.rms_rad < 1.1 * math.hypot(one.bench.noise_rad, one.bench.lsb_rad / math.sqrt(12.0))
    answer = found.answer
    assert answer is not None and answer.law is not None
    assert [law.name for law in answer.law] == named


@pytest.mark.parametrize("number", [2, *evidence(3, 4)])
def test_a_plain_motor_has_no_law_and_keeps_its_plain_estimate(number: int) -> None:
    one = case(CAMPAIGN, number, [])
    found = _identified(one)
    plain = identify(one.recordings(), ("sampled-data",), choose_law=False).estimates["sampled-data"]
    assert found.motor_law is not None
    assert found.motor_law.found == ()
    assert found.estimates["sampled-data"].covariance == pytest.approx(plain.covariance)
    assert [getattr(found.estimates["sampled-data"], name) for name in OF] == [getattr(plain, name) for name in OF]


def test_a_law_that_the_tests_cannot_show_is_in_the_uncertainty_and_makes_the_estimate_doubtful() -> None:
    one = _case("dead_band 0.02")
    found = _identified(one)
    estimate = found.estimates["sampled-data"]
    assert max(_errors(found, one)) > 0.05, "the tests show this dead band: take another"
    assert estimate.verdict == "doubtful"
    assert any("f_c is only known" in reason and "dead band" in reason for reason in estimate.reasons)
    assert found.motor_law is not None
    assert abs(estimate.fc_V - one.truth.fc_V) < 2.0 * found.motor_law.budget.u95["fc_V"]


def test_u95_is_at_least_the_scatter_and_its_lines_add_up() -> None:
    _, found = _found("force_over_position 0.05")
    assert found.motor_law is not None
    lines = found.motor_law.budget
    scatter = next(entry for entry in lines.entries if entry.source == "scatter")
    for name in OF:
        assert lines.u95[name] >= getattr(scatter, name) > 0.0
        own = [getattr(entry, name) for entry in lines.entries if not entry.absolute]
        assert lines.u95[name] == pytest.approx(math.sqrt(sum(part**2 for part in own)))


@pytest.mark.parametrize(
    ("fs_V", "stribeck_rad_s", "level_V", "names"),
    [
        (0.65, 0.0, (0.65, 0.03), ["static"]),
        (0.65, 0.0, None, []),  # the relay tests never hold the shaft
        (0.5, 0.0, (0.53, 0.03), []),
        *evidence((0.65, 0.5, (0.68, 0.03), ["stribeck"])),
    ],
)
def test_breakaway_ramps_show_static_friction_that_is_clearly_above_that_in_motion(
    fs_V: float, stribeck_rad_s: float, level_V: tuple[float, float] | None, names: list[str]
) -> None:
    motor = Motor(0.17, 6.5, tustin(0.5, fs_V, stribeck_rad_s))
    bench = synthetic.Bench(noise_rad=0.003, lsb_rad=synthetic.LSB_RAD)
    tests = [record(simulate(motor, dcr(0.8, h2_V), 800, bench), first=200) for h2_V in (1.0, 1.3)]
    plain = sampled_data.fit(tests)
    law = motor_law(tests, plain, [None, None], level_V=level_V)
    assert [one.law.name for one in law.found] == names
    if names:
        assert law.estimate is not None
        low, high = law.found[0].ci95
        assert low < fs_V - 0.5 < high < 0.3
    estimate = law.estimate or plain
    assert [getattr(estimate, name) for name in OF] == pytest.approx([0.17, 6.5, 0.5], rel=0.02)
    if "static" in names:  # what is at rest alone leaves the motion as it is
        assert [getattr(estimate, name) for name in OF] == pytest.approx([getattr(plain, n) for n in OF], rel=2e-3)


@pytest.mark.evidence
def test_a_slow_drive_shows_static_friction_without_ramps() -> None:
    """A stair of drives up and down: the shaft stands on steps that would move it without a static level."""

    def stairs(top_V: float) -> Callable[[float, float, float], float]:
        return lambda t, y, z: top_V * round(4.0 * math.sin(math.pi * t)) / 4.0

    motor = Motor(0.17, 6.5, coulomb(0.3, 0.45))
    tests = [
        record(simulate(motor, stairs(top_V), 1200, synthetic.Bench(noise_rad=0.003, lsb_rad=synthetic.LSB_RAD)))
        for top_V in (0.8, 1.2)
    ]
    law = motor_law(tests, sampled_data.fit(tests), [None, None])
    assert [one.law.name for one in law.found] == ["static"]
    low, high = law.found[0].ci95
    assert low < 0.15 < high < 0.3
    assert law.estimate is not None
    assert [getattr(law.estimate, name) for name in OF] == pytest.approx([0.17, 6.5, 0.3], rel=0.01)
    assert all(law.budget.u95[name] < 0.05 * getattr(law.estimate, name) for name in OF)


def _fit() -> tuple[Problem, RealMotor, Cut]:
    one = _case("plain")
    tests = [TimeSeries(r.t_s, r.y_rad, r.t_s + one.bench.delay_s, r.u_V) for r in one.records]
    cut = Cut.whole(tests, 0.0).every(0.5)
    motor = RealMotor(1.05 * one.motor.tau_s, one.motor.K_rad_s_V, one.motor.fc_V, one.motor.bias_V)
    return Problem(cut, CORE, limits_of(CORE, cut, (0.0, 0.0)), 0.003), motor, cut


def test_the_normal_equations_without_the_starts_are_those_of_the_whole_jacobian() -> None:
    problem, motor, cut = _fit()
    guess = start(problem, motor)
    rows = problem.rows(guess.motor, guess.starts)
    normal = Normal.of(rows, cut)
    wide = np.zeros((cut.t_s.size, 2 * cut.begins.size))
    for k in range(2):
        wide[np.arange(cut.t_s.size), 2 * cut.piece + k] = rows.by_start[:, k]
    whole = np.column_stack((rows.by_number, wide))
    step = np.linalg.lstsq(whole, -rows.residual, rcond=None)[0]
    change, starts = normal.step(np.zeros(len(CORE), dtype=bool), 0.0)
    assert change == pytest.approx(step[: len(CORE)], rel=1e-6)
    assert starts.ravel() == pytest.approx(step[len(CORE) :], rel=1e-4, abs=1e-7)
    left = rows.residual + whole @ step
    assert normal.squares + normal.gradient @ change == pytest.approx(left @ left, rel=1e-6)


def test_the_gain_of_a_column_is_the_fall_of_the_squares_with_it() -> None:
    problem, motor, cut = _fit()
    fit = solve(start(problem, motor))
    columns = Columns(fit)
    law = next(law for law in DEPARTURES if law.name == "gain_by_sign")
    gain, size = columns.gain(columns.of(law, {})[0])
    richer = Problem(cut, (*CORE, "gain_by_sign"), problem.limits, problem.sigma_rad)
    with_it = solve(start(richer, fit.motor))
    assert fit.cost - with_it.cost == pytest.approx(gain, rel=0.02, abs=0.02)
    assert with_it.motor.gain_by_sign == pytest.approx(float(size[0]), rel=0.02, abs=1e-6)


def test_what_is_known_from_beside_the_tests_is_a_row_of_the_fit() -> None:
    plain, motor, _ = _fit()
    level_V = motor.fc_V + 0.2
    problem = replace(plain, known=Known.of_sum(("fc_V", "static_V"), level_V, 0.02))
    fit = solve(start(problem, motor))
    assert fit.motor.fc_V == pytest.approx(solve(start(plain, motor)).motor.fc_V, rel=0.005)
    columns = Columns(fit)
    law = next(law for law in DEPARTURES if law.name == "static")
    gain, size = columns.gain(columns.of(law, {})[0])
    assert gain == pytest.approx(problem.surprise(fit.motor), rel=0.02)
    assert size[0] == pytest.approx(level_V - fit.motor.fc_V, rel=0.02)


@pytest.mark.parametrize("length_s", [0.2, 0.5, 2.0, math.inf])
def test_a_cut_has_all_rows_once(length_s: float) -> None:
    _, _, cut = _fit()
    pieces = cut if math.isinf(length_s) else cut.every(length_s)
    assert sum(pieces.lengths) == cut.t_s.size
    assert min(pieces.lengths) >= 12
    assert np.bincount(pieces.piece).tolist() == pieces.lengths
    if not math.isinf(length_s):
        assert pieces.longest_s < 1.6 * length_s


PARTS_OF = {
    "dead_band": Departures(dead_band_V=0.05),
    "lag": Departures(lag_s=0.01),
    "stribeck": Departures(stribeck_V=0.1, stribeck_rad_s=0.4),
    "bristle": Departures(bristle_V_rad=50.0),
    "cogging and backlash": Departures(cogging_V=0.05, cogging_per_rad=6.0, cogging_phase_rad=0.4, backlash_rad=0.01),
    "drag, sag, by direction": Departures(
        drag_V_s2_rad2=0.002, sag_per_V=0.02, viscous_V_s_rad=0.01, gain_by_sign=0.02
    ),
}


@pytest.mark.parametrize("name", PARTS_OF)
def test_the_generator_and_the_model_are_two_and_agree(name: str) -> None:
    d = PARTS_OF[name]
    bias_V = (
        0.0 if d.bristle_V_rad else 0.01
    )  # the model's bristles balance it before the start, the generator's do not
    plain = PlainMotor(0.2, 3.0, 0.3, bias_V)
    bench = Bench(delay_s=0.004, noise_rad=0.0, lsb_rad=0.0)
    record = relay_test(plain, d, bench, (0.6, 0.9), 300, (0.0, 3.0), np.random.SeedSequence(1))
    motor = RealMotor(
        plain.tau_s,
        plain.K_rad_s_V,
        plain.fc_V,
        plain.bias_V,
        bench.delay_s,
        dead_band_V=d.dead_band_V,
        gain_by_sign=d.gain_by_sign,
        sag_per_V=d.sag_per_V,
        lag_s=d.lag_s,
        viscous_by_direction_V_s_rad=d.viscous_V_s_rad,
        stribeck_V=d.stribeck_V,
        stribeck_rad_s=d.stribeck_rad_s if d.stribeck_V else 0.0,
        drag_V_s2_rad2=d.drag_V_s2_rad2,
        bristle_V_rad=d.bristle_V_rad,
        cogging_sin_V=d.cogging_V * math.cos(d.cogging_phase_rad),
        cogging_cos_V=d.cogging_V * math.sin(d.cogging_phase_rad),
        cogging_per_rad=d.cogging_per_rad,
        backlash_rad=d.backlash_rad,
    )
    edges = np.concatenate(([-1.0], record.t_s))
    drives = np.concatenate(([0.0], record.u_V))
    y = response(motor, Frame(), (edges, drives), record.t_s, Pieces.one(0.0, 0.0))
    assert float(np.abs(y - record.y_rad).max()) < 2e-4


def test_a_drive_that_changes_in_every_row_is_averaged_in_a_long_record() -> None:
    t_s = np.linspace(0.0, 0.099, 100)
    test = TimeSeries(t_s, np.sin(t_s), t_s, np.arange(100.0))
    thin = thinned(test, 10)
    assert thin.steps.u_V.tolist() == pytest.approx((np.arange(10) * 10.0 + 4.5).tolist())
    assert thin.steps.edge_s.tolist() == pytest.approx((0.01 * np.arange(10)).tolist())


@pytest.mark.evidence
def test_a_long_record_is_thinned_and_its_law_stays() -> None:
    """Sampled every 1 ms it has ten times as many rows; ten at a time give the numbers of the whole."""
    d = Departures(force_V=0.05, force_phase_rad=1.0)
    plain = PlainMotor(0.3, 3.0, 0.3)
    bench = Bench(period_s=0.001, delay_s=0.0005)
    record = relay_test(plain, d, bench, (0.6, 0.9), 12000, (0.0, 12.0), np.random.SeedSequence(2))
    test = TimeSeries(record.t_s, record.y_rad, record.t_s + bench.delay_s, record.u_V)
    thin = thinned(test, 10)
    assert len(thin) == 1200
    assert thin.u_V.mean() == pytest.approx(test.u_V[:-1].mean(), abs=1e-3)
    assert thinned(test, 1) is test
    assert all(np.array_equal(*pair) for pair in zip(thin.steps, test.steps, strict=True))
    late = thin.with_unknown_delay((0.0, 0.01))
    assert late.steps.edge_s == pytest.approx(test.steps.edge_s - bench.delay_s)
    law = motor_law([test], sampled_data.fit([test]), [None])
    assert [one.law.name for one in law.found] == ["force_over_position"]
    assert law.found[0].size == pytest.approx(0.05, rel=0.1)
    assert law.estimate is not None
    assert law.estimate.tau_s == pytest.approx(plain.tau_s, rel=0.02)


@pytest.mark.parametrize("law", ["runs_free", "no_brake"])
def test_what_is_to_be_recorded_is_one_list_though_an_item_has_a_comma(law: str) -> None:
    """It read: from several speeds and and a large drive."""
    told_by = laws.BY_NAME[law].told_by
    assert ", " in told_by and _listed([told_by]) == told_by
    assert _listed(["slow sweeps", "a relay test", told_by]) == f"slow sweeps, a relay test and {told_by}"
