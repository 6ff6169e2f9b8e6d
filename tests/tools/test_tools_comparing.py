"""`make compare`: the runs of one motor, what is said of them, and the page."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from comparing import __main__ as command
from comparing.rows import DRIFTED, LAWS, RUNS, SAME, Row, judged, row
from rig.config.campaign import Campaign

CAMPAIGN = Campaign(name="compare", experiments=4, seed=17)


def test_a_motor_is_recorded_and_judged_and_stands_on_the_page() -> None:
    one = row(CAMPAIGN, SAME, 1)
    assert len(one.values) == RUNS[SAME]
    again = Row(**json.loads(json.dumps(asdict(one))))  # as rows.jsonl keeps it
    told = judged(again)
    assert told == judged(one)
    assert len(told.chances) == 2
    assert len(told.held) == 3
    drifted = Row(DRIFTED, 1, ([0.0, 0.0, 0.5], [0.0, 0.0, 0.51]), one.covariance[:2])
    text = command.page({SAME: [one], DRIFTED: [drifted], LAWS: [Row(LAWS, 0, lost="no cycle")]}, "0123abc", 17)
    assert "| pairs of runs of one motor called different: false alarms |" in text
    assert "`make compare SEED=17`" in text
    assert "* laws: 1 motors, 1 without an estimate." in text


def test_a_drift_moves_the_friction_by_as_much_and_is_in_few_standard_errors() -> None:
    variance = [[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-6]]
    told = judged(Row(DRIFTED, 0, ([0.0, 0.0, 0.5], [0.0, 0.0, 0.51]), (variance, variance)))
    assert told.fc_shows
    assert told.off[0][2] == pytest.approx(0.01 / (2e-3 * 2**0.5), rel=1e-3)
    assert told.chances[0] < 0.01
