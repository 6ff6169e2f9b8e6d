"""The estimator at the statistical limit: random motors of each ready campaign, as `rig campaign` runs them.

`make test` runs some on the grid; the numbers that the documents tell are of `make evidence`. How many there are
decides what a test can see. Intervals that hold the truth in 91 % of the motors instead of 95 % fail the wide band (93
to 97 %) with probability 0.987 at 1,000 motors and 0.999 at 2,000, right ones with 0.003 and 0.00004. The narrow band
(94 to 96 %) needs the 2,000.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rig.campaign import session
from rig.campaign.summary import Summary
from rig.config import load_campaign

pytestmark = pytest.mark.long

CONFIGS = Path(__file__).parents[2] / "config"
MOTORS = 2000
SOME = 40
MOTORS_OF_THE_OTHERS = 1000  # with coarse steps, with correlated noise
MAIN = ("tau_s", "K_rad_s_V", "fc_V")


def summary_of(name: str, folder: Path, motors: int, jobs: int = os.cpu_count() or 1) -> Summary:
    campaign = load_campaign(CONFIGS / f"{name}.yaml").model_copy(update={"experiments": motors})
    found = session.run(campaign, folder / name, jobs=jobs).summary
    assert found is not None and found["number"] == motors
    return found


@pytest.mark.evidence
def test_some_on_the_grid_are_near_the_bound(tmp_path: Path) -> None:
    """As below, as far as so few tell."""
    found = summary_of("campaign", tmp_path, SOME, jobs=1)
    for name in MAIN:
        sums = found["estimated"]["parameters"][name]
        assert 0.8 < sums["rms_ratio"] < 1.25, (name, sums)
        assert sums["relative_median"] <= 0.006, (name, sums)
        assert 0.88 <= sums["coverage"] <= 0.99, (name, sums)
    assert found["verdicts"]["ok"] > 0.85 * SOME
    assert found["ok_but_off"] == []


@pytest.mark.evidence
def test_on_the_grid_errors_are_at_the_bound_and_intervals_hold(tmp_path: Path) -> None:
    """RMS at most 1.1 times the Cramer-Rao bound, medians 0.5 %, 95th percentiles 1.7 %, coverage 94 to 96 %."""
    found = summary_of("campaign", tmp_path, MOTORS)
    for name in MAIN:
        sums = found["estimated"]["parameters"][name]
        assert 0.9 < sums["rms_ratio"] <= 1.1, (name, sums)
        assert 0.9 < sums["rms_over_bound"] <= 1.1, (name, sums)
        assert 0.0005 < sums["relative_median"] <= 0.005, (name, sums)
        assert sums["relative_p95"] <= 0.017, (name, sums)
        assert 0.94 <= sums["coverage"] <= 0.96, (name, sums)
    assert found["verdicts"]["ok"] > 0.9 * MOTORS
    assert found["ok_but_off"] == []
    assert found["far"] == []


@pytest.mark.evidence
@pytest.mark.parametrize("name", ["campaign-coarse", "campaign-correlated"])
def test_intervals_hold_with_coarse_steps_and_with_correlated_noise(name: str, tmp_path: Path) -> None:
    found = summary_of(name, tmp_path, MOTORS_OF_THE_OTHERS)
    for parameter in MAIN:
        sums = found["estimated"]["parameters"][parameter]
        assert 0.93 <= sums["coverage"] <= 0.97, (parameter, sums)
        assert sums["rms_ratio"] <= 1.1, (parameter, sums)
    # errors of four and a half standard errors happen: one correlated record in 2,000 is called ok and is 5.1 % off
    assert len(found["ok_but_off"]) <= 1
