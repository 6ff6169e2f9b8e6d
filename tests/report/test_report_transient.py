"""Friction alone on the report's page: no motor is claimed, and nothing is to be driven with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.identification import Identification
from rig.identification.estimate import Estimate
from rig.output.report import fitted, transient
from rig.output.report.source import ReportedRun
from rig.output.report.style import AbsentError, style
from rig.output.report.words import headline
from rig.run_folder.recording.curves import Curves
from rig.run_folder.results import EstimateResult, RunMeta, RunResult

pytestmark = pytest.mark.drawn


def run_with(estimate: EstimateResult) -> ReportedRun:
    return ReportedRun(Path("run"), None, RunMeta(backend="here"), RunResult(estimates={"least-squares": estimate}))


def friction(**changes: Any) -> Estimate:
    trace = np.column_stack((np.full((20, 2), np.nan), 0.5 + 1.0 / np.arange(1.0, 21.0) ** 2))
    values: dict[str, Any] = {"fc_V": 0.5025, "ci95": {"fc_V": (0.49, 0.51)}, "iterates": trace} | changes
    return Estimate("least-squares", np.nan, np.nan, **values)


def curves_with(estimate: Estimate) -> Curves | None:
    return Identification({"least-squares": estimate}).curves


def test_the_headline_speaks_of_friction_and_not_of_a_motor() -> None:
    shown = headline(run_with(friction().as_result()))
    assert shown.title == "The friction is identified"
    assert [q.text for q in shown.quantities[:2]] == ["–", "–"]
    assert shown.quantities[2].text.startswith("0.50")
    assert not any("rig track" in step.command for step in shown.next_steps)
    assert not any("nan" in sentence for sentence in shown.sentences)


def test_the_recursion_is_drawn() -> None:
    estimate = friction()
    run = run_with(estimate.as_result())
    with style():
        picture = transient.recursion(run, curves_with(estimate))
        assert picture.uri.startswith("data:image/svg+xml")
        refused = friction(fc_V=np.nan, ci95={}, iterates=np.empty((0, 3)))
        with pytest.raises(AbsentError, match="no recursion"):
            transient.recursion(run_with(refused.as_result()), curves_with(refused))
        with pytest.raises(AbsentError, match="no hysteretic run"):
            transient.first_transients(run)
        assert fitted.forest(run).uri.startswith("data:")
