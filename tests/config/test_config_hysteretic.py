"""Runs of hysteretic relays in the config: what is refused, with its numbers, and what `rig check` says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from rig.config import Experiment
from rig.running.preflight import preflight

READY = Path(__file__).parents[2] / "config" / "least-squares.yaml"
PAPER = [{"d_V": 0.8, "eps_rad": 0.5}, {"d_V": 1.0, "eps_rad": 0.3}]


def experiment(relay: dict[str, Any] | None = None, **sections: dict[str, Any]) -> Experiment:
    data = yaml.safe_load(READY.read_text(encoding="utf-8"))
    data["relay"] = {"hysteretic": PAPER} if relay is None else relay
    for name, changes in sections.items():
        data[name] |= changes
    return Experiment.model_validate(data)


def test_the_papers_runs_pass_alone_and_beside_a_relay_test() -> None:
    for more in ({}, {"target": {"amplitude_rad": 0.5, "period_s": 1.0}}, {"gains": [{"h1_V": 0.45, "h2_V": 0.9}]}):
        checked = preflight(experiment({"hysteretic": PAPER, **more}))
        assert checked.problems == ()
        line = next(line for line in checked.lines if line.startswith("stage hysteretic"))
        assert "(+0.8, 0.5), (+1, 0.3) V, rad" in line
        assert "at most to 0.899 rad" in line  # 0.5 + 4.9 (2 * 0.01 + 0.2 (1 - ln 2))
        assert any(line.startswith("stage relay") for line in checked.lines) == ("gains" in more or "target" in more)
        assert any(line.startswith("stage search") for line in checked.lines) == ("target" in more)


@pytest.mark.parametrize(
    ("relay", "words"),
    [
        ({"hysteretic": PAPER[:1]}, "at least 2"),
        ({"hysteretic": [*PAPER, {"d_V": -0.8, "eps_rad": 0.5}]}, "one run alone with d_V of -0.8 V"),
        ({"hysteretic": [PAPER[0], {"d_V": 0.82, "eps_rad": 0.3}]}, "do not differ enough"),
        ({"hysteretic": [PAPER[0], {"d_V": 0.0, "eps_rad": 0.3}]}, "must not be 0"),
        ({"hysteretic": [PAPER[0], {"d_V": 1.0, "eps_rad": 0.0}]}, "greater than 0"),
        ({}, "or `hysteretic`"),
        ({"target": {"amplitude_rad": 0.5, "period_s": 1.0}, "gains": [{"h1_V": 0.4, "h2_V": 0.9}]}, "not both"),
    ],
)
def test_what_one_section_says_wrong_is_refused(relay: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        experiment(relay)


@pytest.mark.parametrize(
    ("run", "key", "words"),
    [
        ({"d_V": 3.2, "eps_rad": 0.3}, ("relay", "hysteretic", 1, "d_V"), "3.2 V is more than drive.max_V 3 V"),
        ({"d_V": 1.0, "eps_rad": 0.05}, ("relay", "hysteretic", 1, "eps_rad"), "less than 20 counts"),
        (
            {"d_V": 1.0, "eps_rad": 0.8},
            ("relay", "hysteretic", 1, "eps_rad"),
            "0.098 (2 periods) + 0.301 (reversing) = 0.399 rad at 4.9 rad/s",
        ),
    ],
)
def test_what_sections_say_together_is_refused_with_the_numbers(run: dict[str, float], key: Any, words: str) -> None:
    (problem,) = preflight(experiment({"hysteretic": [PAPER[0], run]})).problems
    assert problem.path == key
    assert words in problem.message


def test_friction_alone_cannot_be_asked_to_track() -> None:
    data = yaml.safe_load(READY.read_text(encoding="utf-8"))
    data["tracking"] = {"trajectory": [{"amplitude_rad": 0.5, "omega_rad_s": 1.5}], "methods": ["least-squares"]}
    with pytest.raises(ValidationError, match="methods"):
        Experiment.model_validate(data)


def test_the_hint_for_a_band_that_is_too_wide_passes() -> None:
    (problem,) = preflight(experiment({"hysteretic": [PAPER[0], {"d_V": 1.0, "eps_rad": 0.9}]})).problems
    most = float(problem.hint.split()[2])
    assert 0.65 < most < 0.75
    assert preflight(experiment({"hysteretic": [PAPER[0], {"d_V": 1.0, "eps_rad": most}]})).problems == ()
    # slower shafts may have it wider
    slower = experiment({"hysteretic": [PAPER[0], {"d_V": 1.0, "eps_rad": 0.9}]}, limits={"max_speed_rad_s": 2.0})
    assert preflight(slower).problems == ()
