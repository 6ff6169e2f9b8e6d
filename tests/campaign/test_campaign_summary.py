"""The metrics themselves, on rows whose sums are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from small_campaign import table

from rig.campaign import summary
from rig.identification.estimate import PARAMETERS


def test_errors_of_twice_the_bound_are_twice_the_bound() -> None:
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    found = summary.summarise(table(4, tau_s=1.0 + 0.02 * signs))["ok"]["parameters"]
    assert found["tau_s"]["rms_error"] == pytest.approx(0.02)
    assert found["tau_s"]["rms_bound"] == pytest.approx(0.01)
    assert found["tau_s"]["rms_over_bound"] == pytest.approx(2.0)
    assert found["tau_s"]["rms_ratio"] == pytest.approx(2.0)
    assert found["tau_s"]["standardised"] == pytest.approx(2.0)
    assert found["K_rad_s_V"]["rms_over_bound"] == 0.0


def test_the_two_ratios_weigh_differently() -> None:
    """One experiment with a large bound and an error of it, nine with small bounds and errors of three."""
    bounds = np.array([1.0] + [0.01] * 9)
    rows = table(10, bound_K_rad_s_V=bounds, K_rad_s_V=1.0 + bounds * ([1.0] + [3.0] * 9))
    found = summary.summarise(rows)["ok"]["parameters"]["K_rad_s_V"]
    assert found["rms_over_bound"] == pytest.approx(math.sqrt((1.0 + 9 * 0.03**2) / (1.0 + 9 * 0.01**2)))
    assert found["rms_ratio"] == pytest.approx(math.sqrt((1.0 + 9 * 9.0) / 10.0))


def test_median_95th_percentile_and_largest_are_relative_to_the_truth() -> None:
    errors = np.linspace(0.0, 0.04, 101)
    rows = table(101, true_fc_V=2.0, fc_V=2.0 - 2.0 * errors)
    found = summary.summarise(rows)["ok"]["parameters"]["fc_V"]
    assert (found["relative_median"], found["relative_p95"], found["relative_max"]) == pytest.approx(
        (0.02, 0.038, 0.04)
    )
    absolute = summary.summarise(table(101, asym_V=1.0 - errors, true_asym_V=1.0))["ok"]["parameters"]["asym_V"]
    assert absolute["absolute_median"] == pytest.approx(0.02)
    assert "relative_median" not in absolute


def test_what_was_known_has_no_coverage() -> None:
    found = summary.summarise(table(10, se_delay_s=0.0))["ok"]["parameters"]
    assert math.isnan(found["delay_s"]["coverage"])
    assert math.isfinite(found["tau_s"]["coverage"])


def test_coverage_counts_intervals_that_hold_the_truth() -> None:
    low = np.array([0.9] * 90 + [1.01] * 6 + [math.nan] * 4)
    found = summary.summarise(table(100, low_tau_s=low))["ok"]["parameters"]["tau_s"]
    assert found["coverage"] == pytest.approx(0.9)
    assert found["coverage_error"] == pytest.approx(0.03)
    assert all(math.isnan(x) for x in summary.coverage(np.array([], dtype=bool)))


def test_honest_intervals_cover_95_per_cent() -> None:
    errors = 0.01 * np.random.default_rng(8).standard_normal(20_000)
    rows = table(20_000, tau_s=1.0 + errors, low_tau_s=1.0 + errors - 0.0196, high_tau_s=1.0 + errors + 0.0196)
    found = summary.summarise(rows)["ok"]["parameters"]["tau_s"]
    assert found["coverage"] == pytest.approx(0.95, abs=4 * found["coverage_error"])
    assert found["rms_ratio"] == pytest.approx(1.0, abs=0.02)


def test_verdicts_are_counted_and_summed_apart() -> None:
    verdicts = ["ok", "ok", "doubtful", "refused", "refused"]
    tau = [1.0, 1.1, 1.5, 3.0, math.nan]
    found = summary.summarise(table(5, verdict=verdicts, tau_s=tau))
    assert found["number"] == 5
    assert found["verdicts"] == {"ok": 2, "doubtful": 1, "refused": 2, "failed": 0}
    assert found["ok"]["number"] == 2
    assert found["estimated"]["number"] == 4
    assert found["ok"]["parameters"]["tau_s"]["relative_max"] == pytest.approx(0.1)
    assert found["estimated"]["parameters"]["tau_s"]["relative_max"] == pytest.approx(2.0)
    assert found["ok_but_off"] == [1]
    assert found["far"] == [1, 2, 3]


def test_any_of_the_three_parameters_makes_an_experiment_off() -> None:
    found = summary.summarise(table(4, tau_s=[1.04, 1.06, 1.0, 1.0], K_rad_s_V=[1, 1, 0.9, 1], fc_V=[1, 1, 1, 1.07]))
    assert found["ok_but_off"] == [1, 2, 3]


def test_reasons_are_counted_without_their_numbers() -> None:
    reasons = ["fc_V is known to 12 %", "fc_V is known to 11.5 % | only 3 cycles", "", "only 4 cycles"]
    assert summary.summarise(table(4, reasons=reasons))["reasons"] == [
        ["fc_V is known to # %", 2], ["only # cycles", 2],
    ]  # fmt: skip


def test_no_bound_and_no_rows_are_nan_and_no_error() -> None:
    unbounded = summary.summarise(table(3, **{f"bound_{name}": math.nan for name in PARAMETERS}))
    assert math.isnan(unbounded["ok"]["parameters"]["tau_s"]["rms_ratio"])
    assert unbounded["ok"]["parameters"]["tau_s"]["coverage"] == 1.0
    nothing = summary.summarise(table(2, verdict="refused", **dict.fromkeys(PARAMETERS, math.nan)))
    assert nothing["ok"]["number"] == nothing["estimated"]["number"] == 0
    assert math.isnan(nothing["ok"]["parameters"]["fc_V"]["relative_p95"])


def test_the_second_test_is_compared_with_the_true_motor() -> None:
    found = summary.summarise(table(3, second_rms_rad=[1.0, 2.0, 3.0], second_own_rms_rad=[1.0, 1.0, 2.0]))
    assert found["second"]["median"] == pytest.approx(1.5)
    assert found["second"]["max"] == pytest.approx(2.0)
    assert "second" not in summary.summarise(table(3))
