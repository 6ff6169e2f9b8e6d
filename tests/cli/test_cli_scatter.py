"""`rig run --repeat`: the scatter between runs beside their intervals."""

import pytest

from rig.cli.terminal import show_scatter
from rig.run_folder.results import EstimateResult, RunResult


def result(tau_s: float) -> RunResult:
    ci95 = {"tau_s": [tau_s - 0.001, tau_s + 0.001], "K_rad_s_V": [6.4, 6.6], "fc_V": [0.47, 0.49]}
    estimate = EstimateResult(tau_s=tau_s, K_rad_s_V=6.5, fc_V=0.48, ci95=ci95)
    return RunResult(estimates={"sampled-data": estimate})


def test_scatter_beside_the_intervals(capsys: pytest.CaptureFixture[str]) -> None:
    show_scatter([result(0.170), result(0.172), RunResult()])
    shown = capsys.readouterr().out
    assert "2 of 3 runs" in shown
    row = next(line for line in shown.splitlines() if "tau_s" in line)
    assert row.split() == ["tau_s", "0.17100", "0.00277", "0.00100"]


def test_one_estimate_has_no_scatter_and_that_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    show_scatter([result(0.170), RunResult()])
    assert capsys.readouterr().out == "no scatter: it takes two answers, not refused, and 2 runs gave 1\n"
