"""Least squares on the transient of hysteretic relays (docs/theory.md 5.1): the paper's figures, and its failures."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evidence import evidence, examples
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import LSB_RAD, Bench, Samples, motor, record, simulate, write_csv

from rig.control.relay import HystereticRelay
from rig.core.signals import Sample
from rig.identification import IdentifyError, identify
from rig.identification.estimate import Estimate
from rig.identification.least_squares import Transient, batch, compared_with, fit, recursive, total
from rig.model.motor import Motor, State
from rig.run_folder.recording.csv_file import read_csv
from rig.run_folder.recording.series import TimeSeries

PAPER = ((0.8, 0.5), (1.0, 0.3))  # d in V, eps in rad: the runs of the paper's comparison
BOTH_WAYS = (*PAPER, (-0.8, 0.5), (-1.0, 0.3))
FINE = Bench(period_s=2e-4, delay_s=0.0)
REAL = Bench(delay_s=0.0012, jitter_s=3e-4, noise_rad=0.003, lsb_rad=LSB_RAD)


def run(shaft: Motor, d_V: float, eps_rad: float, bench: Bench, start_rad: float = 0.0, rest: int = 40) -> Samples:
    """``rest`` rows at 0 V, then the relay for two seconds."""
    relay = HystereticRelay(d_V, eps_rad)
    rows = iter(range(10**9))

    def law(t_s: float, y_rad: float, z_rad_s: float) -> float:
        return relay.step(Sample(t_s, y_rad, 0)) if next(rows) >= rest else 0.0

    return simulate(shaft, law, rest + round(2.0 / bench.period_s), bench, State(y=start_rad))


def runs(
    shaft: Motor,
    bench: Bench,
    relays: tuple[tuple[float, float], ...] = PAPER,
    starts_rad: tuple[float, ...] = (0.0,) * 8,
    known: bool = True,
    rest: int = 40,
) -> list[TimeSeries]:
    return [
        replace(record(run(shaft, d, eps, replace(bench, seed=100 * bench.seed + k), start, rest), known), name=f"r{k}")
        for k, ((d, eps), start) in enumerate(zip(relays, starts_rad, strict=False))
    ]


def columns(records: list[TimeSeries], rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the first ``rows`` samples after the drive took effect, and the drives."""
    found = [Transient.of(r) for r in records]
    return np.stack([t.y_rad[1 : rows + 1] for t in found], axis=1), np.array([t.d_V for t in found])


def test_without_noise_it_is_exact_and_gives_no_tau_and_no_gain() -> None:
    estimate = fit(runs(motor(), FINE))
    assert estimate.fc_V == pytest.approx(0.5, abs=1e-12)
    assert math.isnan(estimate.tau_s)
    assert math.isnan(estimate.K_rad_s_V)
    assert not estimate.is_motor
    shown = estimate.as_result().as_json()
    assert shown["tau_s"] is None
    assert shown["K_rad_s_V"] is None
    with pytest.raises(ValueError, match="no motor"):
        estimate.motor()


def test_the_papers_figures_are_those_of_a_recursion_that_starts_from_a_finite_covariance() -> None:
    """0.4921 ... 0.4988 after 1000 samples, for 0.5: from infinity it is exact, from 26 to 173 V^2/rad^2 it is this."""
    y, d = columns(runs(motor(), FINE), 1000)
    assert recursive(y, d)[-1] == pytest.approx(0.5, abs=1e-12)
    low, high = recursive(y, d, covariance=26.0)[-1], recursive(y, d, covariance=173.0)[-1]
    assert low == pytest.approx(0.4921, abs=1e-3)
    assert high == pytest.approx(0.4988, abs=2e-4)


@pytest.mark.parametrize("starts_rad", [(0.05, 0.0), *evidence(((0.05, 0.05),), ((0.0, 0.05),), ((-0.05, -0.05),))])
def test_from_a_start_that_is_not_zero_it_fails_and_is_refused_with_the_start(starts_rad: tuple[float, float]) -> None:
    estimate = fit(runs(motor(), FINE, starts_rad=starts_rad))
    assert abs(estimate.fc_V - 0.5) > 0.1
    assert estimate.verdict == "refused"
    reason = next(r for r in estimate.reasons if "do not start from zero" in r)
    for number, start in enumerate(starts_rad):
        assert f"{1e3 * start:+.1f} mrad (r{number})" in reason
    # it does not converge either: over the second half of the samples the recursion still goes somewhere
    trace = estimate.iterates[:, 2]
    assert abs(trace[-1] - trace[trace.size // 2]) > 0.05
    # what the interval is of knows the starts
    low, high = estimate.ci95["fc_V"]
    assert low < 0.5 + 1e-9
    assert high > 0.5 - 1e-9
    assert high - low < 1e-3


def test_the_recursions_last_value_is_the_batchs() -> None:
    estimate = fit(runs(motor(), REAL))
    assert estimate.iterates.shape == (estimate.iterations, 3)
    assert estimate.iterates[-1, 2] == pytest.approx(estimate.fc_V, rel=1e-9)
    assert np.isnan(estimate.iterates[:, :2]).all()


@settings(max_examples=examples(30), deadline=None)
@given(
    st.floats(0.05, 0.5),
    st.floats(1.0, 15.0),
    st.floats(0.0, 0.6),
    st.floats(-0.05, 0.05),
    st.lists(st.floats(0.15, 1.0), min_size=2, max_size=4),
)
def test_any_motor_any_number_of_runs(tau: float, K: float, fc: float, asym: float, beyond: list[float]) -> None:
    """Noise-free positions of any motor give friction towards rising positions, whichever way it is solved."""
    drives = np.array(sorted(fc - asym + x for x in beyond))
    t = np.linspace(0.005, 0.3, 60)
    g = K * (t - tau * (1.0 - np.exp(-t / tau)))
    y = np.outer(g, drives - (fc - asym))
    if np.ptp(drives) < 0.02:
        return
    assert batch(y, drives) == pytest.approx(fc - asym, abs=1e-9)
    assert recursive(y, drives)[-1] == pytest.approx(fc - asym, abs=1e-9)
    assert total(y, drives) == pytest.approx(fc - asym, abs=1e-6)


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 4))
def test_total_least_squares_is_the_best_of_all_frictions(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    drives = np.sort(rng.uniform(0.6, 1.5, count))
    y = np.outer(np.linspace(0.0, 0.5, 40), drives - 0.5) + 0.02 * rng.standard_normal((40, count))

    def left(f: float) -> float:
        w = drives - f
        return float(np.sum(y**2) - np.sum((y @ w) ** 2) / (w @ w))

    found = total(y, drives)
    assert left(found) <= min(left(f) for f in np.linspace(-2.0, 3.0, 2001)) * (1.0 + 1e-12)


@pytest.mark.evidence
def test_intervals_cover_although_noise_in_both_sides_bends_the_methods_value() -> None:
    """At 10 ms with 10 mrad of noise the method is off by four times what its scatter lets one expect of the mean."""
    noisy = Bench(delay_s=0.0012, jitter_s=3e-4, noise_rad=0.01)
    estimates = [fit(runs(motor(), replace(noisy, seed=seed), known=True)) for seed in range(1, 151)]
    values = np.array([e.fc_V for e in estimates]) - 0.5
    assert values.mean() > 4.0 * values.std() / math.sqrt(len(values))  # towards the mean of the drives, 0.9 V
    bounds = np.array([e.ci95["fc_V"] for e in estimates])
    middle = bounds.mean(axis=1) - 0.5
    assert abs(middle.mean()) < 3.0 * middle.std() / math.sqrt(len(middle))
    covered = np.mean((bounds[:, 0] < 0.5) & (bounds[:, 1] > 0.5))
    assert 0.90 < covered <= 1.0
    # and where that is a good part of the interval, it says so
    bent = [
        e for e, m in zip(estimates, middle, strict=True) if abs(e.fc_V - 0.5 - m) > 0.5 * np.ptp(e.ci95["fc_V"]) / 2
    ]
    assert len(bent) > 5
    assert all(any("noise in both sides" in r for r in e.reasons) for e in bent)


@pytest.mark.evidence
def test_intervals_cover_with_starts_of_a_real_homing() -> None:
    rng = np.random.default_rng(3)
    covered, doubted = [], 0
    for seed in range(1, 151):
        starts = tuple(rng.normal(0.0, 0.0015, 2).tolist())
        estimate = fit(runs(motor(), replace(REAL, seed=seed), starts_rad=starts))
        low, high = estimate.ci95["fc_V"]
        covered.append(low < 0.5 < high)
        doubted += any("do not start from zero" in r or "outside its interval" in r for r in estimate.reasons)
    assert 0.90 < np.mean(covered) <= 1.0
    assert doubted > 5


def test_both_ways_show_the_asymmetry_and_one_way_says_that_it_does_not() -> None:
    lopsided = motor(fc_V=0.48, asym_V=-0.03)
    both = fit(runs(lopsided, FINE, BOTH_WAYS))
    assert both.fc_V == pytest.approx(0.48, abs=1e-9)
    assert both.asym_V == pytest.approx(-0.03, abs=1e-9)
    assert both.verdict == "ok"
    one = fit(runs(lopsided, FINE))
    assert one.fc_V == pytest.approx(0.51, abs=1e-9)
    assert one.verdict == "doubtful"
    assert "rising positions alone" in one.reasons[0]


def test_runs_are_aligned_on_the_time_since_the_drive_took_effect() -> None:
    """Ticks of the two runs are 7 ms apart against their drives: by row number they would not belong together."""
    early = record(run(motor(), 0.8, 0.5, Bench(delay_s=0.001)))
    late = record(run(motor(), 1.0, 0.3, Bench(delay_s=0.008)))
    estimate = fit([early, late])
    assert estimate.fc_V == pytest.approx(0.5, abs=5e-4)
    blind = [replace(r, t_u_s=None) for r in (early, late)]
    assert abs(fit(blind).fc_V - 0.5) > 0.02
    assert any("equally late" in reason for reason in fit(blind).reasons)


def test_static_friction_does_not_matter_above_it() -> None:
    assert fit(runs(motor(fs_V=0.75), FINE)).fc_V == pytest.approx(0.5, abs=1e-9)


REFUSED = {
    "equal drives": (((0.8, 0.5), (0.8, 0.3)), {}, "do not differ"),
    "too little drive": (((0.45, 0.5), (1.0, 0.3)), {}, "does not move the shaft"),
    "between moving and static friction": (((0.6, 0.5), (1.0, 0.3)), {"fs_V": 0.7}, "more than static friction"),
    "never switched": (((0.8, 0.5), (1.0, 30.0)), {}, "ends before the first switching"),
    "one each way": (((0.8, 0.5), (-1.0, 0.3)), {}, "only one run"),
    "too few samples": (((2.0, 0.02), (3.0, 0.02)), {}, "too few"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_the_method_cannot_do_is_refused_with_its_reason(case: str) -> None:
    relays, changes, words = REFUSED[case]
    estimate = fit(runs(motor(**changes), replace(REAL, lsb_rad=0.0, noise_rad=1e-4), relays))
    assert estimate.verdict == "refused"
    assert math.isnan(estimate.fc_V)
    assert any(words in reason for reason in estimate.reasons)


def test_a_start_that_turns_is_refused() -> None:
    """The second run's drive comes while the shaft still coasts, just as it passes zero."""

    def law(t_s: float, y_rad: float, z_rad_s: float) -> float:
        return 0.3 if t_s < 0.2 else 0.0 if t_s < 0.4 else 1.0 if t_s < 0.8 else -1.0

    smooth = motor(fc_V=0.05)
    coasting = record(simulate(smooth, law, 120, Bench(noise_rad=1e-4)), first=25)
    coasting = replace(coasting, y_rad=coasting.y_rad - coasting.y_rad[14])
    still, other = runs(smooth, Bench(noise_rad=1e-4))
    assert not any("turns at" in reason for reason in fit([still, other]).reasons)
    estimate = fit([still, coasting])
    assert estimate.verdict == "refused"
    assert any("turns at" in reason for reason in estimate.reasons)


def test_a_start_of_which_nothing_is_recorded_is_doubtful() -> None:
    estimate = fit(runs(motor(), REAL, rest=0))
    assert estimate.verdict != "ok"
    assert any("to see that the shaft rests" in reason for reason in estimate.reasons)


def test_a_single_run_or_an_idle_one_is_an_error_with_a_cure() -> None:
    only = runs(motor(), REAL)[:1]
    with pytest.raises(IdentifyError, match="needs two runs") as caught:
        fit(only)
    assert "relay.hysteretic" in caught.value.cure
    idle = replace(only[0], u_V=np.zeros_like(only[0].u_V))
    with pytest.raises(IdentifyError, match="0 V throughout"):
        fit([only[0], idle])


def test_runs_that_are_no_multiples_of_one_curve_are_doubtful() -> None:
    """Two motors for one: the second has half the time constant. It takes many samples to see that."""
    often = replace(FINE, noise_rad=0.003)
    assert not any("multiples of one curve" in reason for reason in fit(runs(motor(), often)).reasons)
    mixed = [runs(motor(), often)[0], runs(motor(tau_s=0.08), often)[1]]
    assert any("multiples of one curve" in reason for reason in fit(mixed).reasons)


def test_it_is_held_to_the_estimate_of_the_whole_motor() -> None:
    """What a transient does not show, here another motor in the second run, shows beside a better estimate."""
    good = runs(motor(), REAL, BOTH_WAYS)
    mixed = [good[0], runs(motor(tau_s=0.12), REAL)[1]]
    whole = Estimate("sampled-data", 0.17, 6.5, 0.5, 0.0, ci95={"fc_V": (0.495, 0.505), "asym_V": (-0.002, 0.002)})
    for records, agrees in ((good, True), (good[:2], True), (good[2:], True), (mixed, False)):
        reasons = compared_with(fit(records), whole, records).reasons
        assert agrees == (not any("sampled-data estimate says" in reason for reason in reasons)), reasons
    lopsided = replace(whole, asym_V=-0.03)  # then 0.53 V one way, 0.47 V the other, 0.5 V both
    assert compared_with(fit(good), lopsided, good).verdict == fit(good).verdict
    for records, wanted in ((good[:2], "0.5300 V"), (good[2:], "0.4700 V")):
        assert any(wanted in reason for reason in compared_with(fit(records), lopsided, records).reasons)


def test_identify_takes_two_csv_files_as_runs_where_it_is_asked_to(tmp_path: Path) -> None:
    paths = [
        write_csv(tmp_path / f"{name}.csv", run(motor(), d, eps, replace(REAL, seed=k)), t_u_known=False)
        for k, (name, (d, eps)) in enumerate(zip("ab", PAPER, strict=True), start=1)
    ]
    recordings = [read_csv(path) for path in paths]
    found = identify(recordings, ["least-squares"])
    assert list(found.estimates) == ["least-squares"]
    estimate = found.estimates["least-squares"]
    assert estimate.fc_V == pytest.approx(0.5, rel=0.05)
    assert [entry.stage for entry in found.hysteretic] == ["a.csv", "b.csv"]
    assert found.hysteretic[1].d_V == 1.0
    slow_s, quick_s = (entry.switched_s for entry in found.hysteretic)
    assert slow_s is not None and quick_s is not None
    assert 0.1 < quick_s < slow_s < 0.6
    assert found.best is None  # friction alone is no motor
    # of itself it does not take any two records for hysteretic runs
    assert "least-squares" not in identify(recordings).estimates
    with pytest.raises(IdentifyError, match="needs two runs"):
        identify(recordings[:1], ["least-squares"])


def test_hysteretic_stages_are_found_and_the_sampled_data_estimator_takes_them_too(tmp_path: Path) -> None:
    recordings = [
        read_csv(write_csv(tmp_path / f"{k}.csv", run(motor(), d, eps, replace(REAL, seed=k)), stage=f"hysteretic-{k}"))
        for k, (d, eps) in enumerate(BOTH_WAYS, start=1)
    ]
    found = identify(recordings)
    assert list(found.estimates) == ["sampled-data", "least-squares"]
    exact = found.estimates["sampled-data"]
    for value, true in ((exact.tau_s, 0.17), (exact.K_rad_s_V, 6.5), (exact.fc_V, 0.5)):
        assert value == pytest.approx(true, rel=0.02)
    assert found.best is exact
    assert found.estimates["least-squares"].fc_V == pytest.approx(0.5, rel=0.05)
