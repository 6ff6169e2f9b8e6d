"""How the estimate narrowed: the figure, the sentence beside it, and what there is without an estimate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.output.report import narrowing
from rig.output.report.source import ReportedRun
from rig.output.report.style import AbsentError, style
from rig.run_folder.recording.recording import assembled
from rig.run_folder.results import LiveResult, RunEvent, RunMeta, RunResult, StoppedResult, TrueMotor

pytestmark = pytest.mark.drawn


def live(of_s: float, percent: float) -> RunEvent:
    values = LiveResult(
        row=int(100 * of_s), of_s=of_s, tau_s=0.17, K_rad_s_V=6.5, fc_V=0.48, tau_percent=percent, K_percent=percent,
        fc_percent=None, residual_over_noise=1.0, drives_differ=True,
    )  # fmt: skip
    return RunEvent.model_validate({"t_s": of_s, "kind": "live", **values.model_dump()})


@pytest.fixture
def reported() -> ReportedRun:
    t_s = 0.01 * np.arange(400)
    stage = np.array(["search"] * 200 + ["strokes-1"] * 200)
    columns: dict[str, Any] = {"t_s": t_s, "y_rad": np.sin(t_s), "u_V": np.ones(400), "stage": stage}
    stopped = StoppedResult(
        why="all is known", known=True, t_s=4.0, tests_s=4.0, cycles=3, wanted_percent=1.0, interval_percent=0.8
    )
    return ReportedRun(
        Path("run"),
        assembled(Path("run"), columns, range(400), columns_present=tuple(columns)),
        RunMeta(backend="a bench"),
        RunResult(stopped=stopped, truth=TrueMotor(tau_s=0.171, K_rad_s_V=6.5, fc_V=0.48)),
        events=tuple(live(*one) for one in ((1.0, 60.0), (2.0, 8.0), (3.0, 1.2), (4.0, 0.8))),
    )


def test_the_picture_says_what_it_shows_and_whose_values_are_dotted(reported: ReportedRun) -> None:
    with style():
        picture = narrowing.narrowing(reported)
    assert picture.uri.startswith("data:image/svg+xml;base64,") and "a bench" in picture.alt
    assert "Dotted: the emulated motor's values." in picture.caption


def test_an_estimate_that_lacks_numbers_is_no_trouble(reported: ReportedRun) -> None:
    damaged = RunEvent.model_validate({"t_s": 2.5, "kind": "live", "of_s": 2.5, "tau_s": "much"})
    with style():
        assert narrowing.narrowing(replace(reported, events=(damaged, *reported.events[1:])))


def test_why_the_tests_ended_is_a_sentence(reported: ReportedRun) -> None:
    assert narrowing.why_it_ended(reported) == "The tests ended after 4.0 s and 3 swings to and fro: all is known."
    assert narrowing.why_it_ended(replace(reported, result=RunResult())) == ""


def test_without_a_live_estimate_the_page_says_so(reported: ReportedRun) -> None:
    with pytest.raises(AbsentError, match="no live estimate"):
        narrowing.narrowing(replace(reported, events=()))
