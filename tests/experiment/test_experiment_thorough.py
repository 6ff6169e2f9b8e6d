"""What a thorough run adds: relay tests and a survey where the tests leave the law of the motor open."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import rig
from intervals import reaches
from survey_config import written

from rig.run_folder.recording.reader import read_run
from rig.running.experiment.survey import starts_from_rest

pytestmark = [pytest.mark.long, pytest.mark.laws]


@pytest.fixture(scope="module")
def thorough(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("thorough")
    survey = {"speeds_rad_s": [0.7, 0.5], "longest_s": 60}  # enough for a supply, which sags at any speed
    path = written(folder, {"sag_per_V": 0.03, "half_travel_rad": 1.0}, identify={"thorough": True}, survey=survey)
    outcome: dict[str, Any] = json.loads(rig("run", path, "--out", folder / "runs", "--json").stdout)
    return outcome


@pytest.mark.evidence
def test_a_thorough_run_tells_what_the_plain_run_leaves_open(thorough: dict[str, Any]) -> None:
    """One amplitude does not tell a supply that sags from a slower motor; three and a survey do.

    They do not tell by which curve: a bend with the square of the drive explains them as well, with K 2.8 % smaller.
    """
    assert any(note.startswith("thorough: the tests left") for note in thorough["notes"])
    (law,) = thorough["answer"]["law"]
    assert law["name"] == "sag" and reaches(law["ci95"], 0.03)
    truth, answer = thorough["truth"], thorough["answer"]
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert answer[name] == pytest.approx(truth[name], rel=0.01)
        assert answer["u95"][name] < (0.025 if name == "tau_s" else 0.05) * truth[name]
    (reason,) = answer["reasons"]
    assert "sag of the drive or another bend of the drive" in reason
    stages = read_run(Path(thorough["folder"])).stages()
    assert [stage for stage in stages if stage != "rest"] == ["breakaway", "relay-1", "relay-2", "survey"]
    assert {record["name"] for record in thorough["law_records"]} >= {"relay-1", "relay-2", "survey"}


def test_gains_that_would_leave_the_shaft_at_rest_are_no_third_test() -> None:
    """Its NO_CYCLE would end the run before survey and tracking."""
    assert not starts_from_rest((0.1, 0.55), 0.7)
    assert starts_from_rest((0.2, 0.55), 0.7)


@pytest.mark.evidence
def test_what_the_plain_run_would_have_said_is_doubtful_and_the_thorough_one_is_replayed(
    thorough: dict[str, Any],
) -> None:
    plain = rig("identify", thorough["folder"], "--without", "survey", "--without", "relay-2", "--json")
    left = json.loads(plain.stdout)
    assert not left["answer"]["law"]
    estimate = left["estimates"]["sampled-data"]
    assert estimate["verdict"] == "doubtful" and estimate["K_rad_s_V"] < 0.97 * thorough["truth"]["K_rad_s_V"]
    done = json.loads(rig("replay", thorough["folder"], "--json").stdout)
    assert done["ok"] and done["replayed"] == done["rows"]
