"""One experiment: its row tells the truth, the estimate that `rig identify` gives, and the bound."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_campaign import UNREPEATABLE, small

from rig.campaign import random_motors
from rig.campaign.trial import COLUMNS, run_trial
from rig.config import Campaign
from rig.identification import identify, sampled_data
from rig.identification.estimate import PARAMETERS
from rig.run_folder.recording.csv_file import read_csv


def test_a_row_has_the_columns_in_their_order_and_kinds() -> None:
    row = run_trial(small(), 3)
    assert list(row) == list(COLUMNS)
    assert {name: type(value) for name, value in row.items()} == COLUMNS
    assert row["number"] == 3
    assert row["cycles"] == 6.0
    assert row["verdict"] == "ok"


def test_the_same_experiment_gives_the_same_row() -> None:
    first, again = run_trial(small(), 4), run_trial(small(99), 4)
    for name in COLUMNS:
        if name not in UNREPEATABLE:
            assert repr(first[name]) == repr(again[name])


@pytest.mark.parametrize("times_known", [False, True])
def test_the_estimate_is_that_of_rig_identify_on_the_csv_file(tmp_path: Path, times_known: bool) -> None:
    campaign = small(sampling={"times_known": times_known})
    row = run_trial(campaign, 5)
    test, rows = random_motors.simulate(campaign, random_motors.draw(campaign, 5))
    names = ["t_s", "u_V", "y_rad"] + (["t_u_s"] if times_known else [])
    columns = [getattr(test, name)[rows] for name in names]
    columns = [c - test.t_s[rows][0] if name in ("t_s", "t_u_s") else c for name, c in zip(names, columns, strict=True)]
    path = tmp_path / "one.csv"
    lines = [",".join(map(repr, map(float, values))) for values in zip(*columns, strict=True)]
    path.write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")
    estimate = identify([read_csv(path)]).estimates[sampled_data.METHOD]
    assert [row[name] for name in PARAMETERS] == [getattr(estimate, name) for name in PARAMETERS]
    plain = identify([read_csv(path)], choose_law=False).estimates[sampled_data.METHOD]  # as a campaign knows it
    assert row["verdict"] == plain.verdict
    assert (row["low_tau_s"], row["high_tau_s"]) == estimate.ci95["tau_s"]


def trial(campaign: Campaign, number: int) -> dict[str, Any]:
    """The row of an experiment, whose columns a test knows the kinds of."""
    return run_trial(campaign, number)


def test_without_noise_the_estimate_is_exact_and_there_is_no_bound() -> None:
    row = trial(small(sensor={"noise_rad": 0.0, "lsb_rad": 0.0}), 1)
    for name in PARAMETERS:
        assert row[name] == pytest.approx(row[f"true_{name}"], rel=1e-6)
        assert math.isnan(row[f"bound_{name}"])


def test_errors_are_of_the_bounds_size() -> None:
    rows = [trial(small(), k) for k in range(24)]
    for name in PARAMETERS:
        ratios = [(row[name] - row[f"true_{name}"]) / row[f"bound_{name}"] for row in rows]
        assert 0.6 < math.sqrt(np.mean(np.square(ratios))) < 1.5


def test_known_times_leave_no_delay_to_bound_and_tighten_tau() -> None:
    unknown, known = trial(small(), 2), trial(small(sampling={"times_known": True}), 2)
    assert math.isnan(known["bound_delay_s"])
    assert known["bound_tau_s"] < unknown["bound_tau_s"]


def test_a_clock_of_its_own_does_not_go_into_tau() -> None:
    clean = {"noise_rad": 0.0, "lsb_rad": 0.0}
    sampling = {"clock_ratio": (1.02, 1.02), "times_known": True}
    row = trial(small(sensor=clean, sampling=sampling), 1)
    assert row["true_clock_ratio"] == 1.02
    assert row["tau_s"] == pytest.approx(row["true_tau_s"], rel=1e-6)


def test_a_motor_that_sticks_is_refused_with_a_reason_and_no_number() -> None:
    row = trial(small(motor={"static_ratio": 40.0}), 0)
    assert row["verdict"] == "refused"
    assert row["reasons"]
    assert math.isnan(row["tau_s"])
    assert math.isnan(row["low_fc_V"])


def test_a_good_model_predicts_the_second_test_as_the_true_motor_does() -> None:
    row = trial(small(relay={"second": {"amplitude_ratio": 0.75}}), 3)
    assert row["second_own_rms_rad"] == pytest.approx(math.hypot(0.003, 4.2 / 1024 / math.sqrt(12)), rel=0.15)
    assert 0.98 < row["second_rms_rad"] / row["second_own_rms_rad"] < 1.3
    assert math.isnan(trial(small(), 3)["second_rms_rad"])


def test_disturbed_drives_disturb() -> None:
    quiet, disturbed = trial(small(), 6), trial(small(drive_noise={"coefficient": 0.9, "std_V": 0.1}), 6)
    assert disturbed["bound_tau_s"] == pytest.approx(quiet["bound_tau_s"], rel=0.5)
    assert disturbed["se_tau_s"] > 2.0 * quiet["se_tau_s"]
