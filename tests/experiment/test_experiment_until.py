"""Tests that end when the motor is known, in virtual time, as a user runs them; and each run replayed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from command_line import rig

from rig.run_folder.recording.reader import read_run
from rig.run_folder.results import RunResult
from rig.running.experiment.advisers import InTheLoop
from rig.running.replay import replay

pytestmark = [pytest.mark.long, pytest.mark.laws]

ROOT = Path(__file__).resolve().parents[2]
SOFT_RAD = 1.1


def written(folder: Path, relay: dict[str, Any] | None = None, **changes: Any) -> Path:
    """config/quick.yaml with other bounds, and other keys of the emulated bench; without tracking."""
    data = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    data["relay"]["until"] |= relay or {}
    del data["tracking"]
    for name, value in changes.items():
        data["emulated"][name] = data["emulated"].get(name, {}) | value
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def run(config: Path, folder: Path, *more: object, status: int = 0) -> tuple[Path, RunResult]:
    done = rig("run", config, "--out", folder / "runs", "--json", *more)
    assert done.exit_code == status, done.output
    outcome = json.loads(done.stdout)
    return Path(outcome["folder"]), RunResult.model_validate(
        {name: value for name, value in outcome.items() if name not in ("ok", "folder", "cause", "cure")}
    )


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunResult]:
    """A run from nothing, whole: with its tracking."""
    return run(ROOT / "config/quick.yaml", tmp_path_factory.mktemp("known"))


def test_from_nothing_the_tests_end_when_the_motor_is_known_and_the_run_says_why(known: tuple[Path, RunResult]) -> None:
    folder, result = known
    stopped = result.stopped
    assert stopped is not None and stopped.known and "0.4 % were asked for" in stopped.why
    assert stopped.interval_percent is not None and stopped.interval_percent <= 0.4 == stopped.wanted_percent
    assert stopped.tests_s is not None and stopped.tests_s < 20.0  # 60 s are allowed
    rows = [live.row for live in stopped.live]
    assert len(rows) >= 3 and rows == sorted(set(rows)) and rows[-1] < len(read_run(folder))
    estimate, truth = result.estimates["sampled-data"], result.truth
    assert estimate.verdict == "ok" and truth is not None
    for name, largest in (("tau_s", 0.01), ("K_rad_s_V", 0.01), ("fc_V", 0.01)):
        assert estimate.value(name) == pytest.approx(truth.value(name), rel=largest)
    assert result.tracking["sampled-data"].rms_rad is not None


def test_all_of_it_is_replayed_tick_for_tick_the_decisions_from_the_events(known: tuple[Path, RunResult]) -> None:
    folder, _ = known
    done = replay(folder)
    assert done.is_same and done.ending == "its end", done.difference
    stages = read_run(folder).stages()
    assert stages[:3] == ["rest", "breakaway", "search"]
    assert any(stage.startswith(("relay-", "strokes-")) for stage in stages)


def test_no_test_leaves_the_soft_limits(known: tuple[Path, RunResult]) -> None:
    recording = read_run(known[0])
    assert float(np.abs(recording.y_rad).max()) < SOFT_RAD
    assert not recording.flags.any()  # the guard had nothing to do


IN_A_PROCESS_OF_ITS_OWN = """
import sys
import rig.running.session
from rig.cli import main

rig.running.session.write_report = lambda *_: None  # to draw it takes as long as the run
main(sys.argv[1:])
"""


def test_a_seed_gives_the_same_run(known: tuple[Path, RunResult], tmp_path: Path) -> None:
    command = ["run", str(ROOT / "config/quick.yaml"), "--out", str(tmp_path), "--json"]
    said = subprocess.run(
        [sys.executable, "-c", IN_A_PROCESS_OF_ITS_OWN, *command], capture_output=True, text=True, check=True
    ).stdout
    again = Path(json.loads(said)["folder"])
    for name in ("samples.csv", "events.jsonl"):
        assert (again / name).read_text() == (known[0] / name).read_text()


@pytest.mark.evidence
def test_an_unbalanced_load_is_found_while_the_tests_run_and_they_end_when_it_is_known(tmp_path: Path) -> None:
    """tau, K and friction alone never explain it: the tests would go on to the bound."""
    motor = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))["emulated"]["motor"]
    folder, result = run(written(tmp_path, motor=motor | {"parts": {"force_sin_V": 0.1}}), tmp_path)
    stopped = result.stopped
    assert stopped is not None and stopped.known and stopped.why.endswith("; with force over position")
    assert stopped.tests_s is not None and stopped.tests_s < 30.0  # 60 s are allowed
    assert stopped.live[-1].laws == "force_over_position"
    estimate = result.answer
    assert estimate is not None and estimate.verdict == "ok"
    assert [law.name for law in estimate.law or ()] == ["force_over_position"]
    for name, true in (("tau_s", 0.17), ("K_rad_s_V", 6.5), ("fc_V", 0.48)):
        assert estimate.value(name) == pytest.approx(true, rel=0.01)
    assert float(np.abs(read_run(folder).y_rad).max()) < SOFT_RAD
    assert replay(folder).is_same


def test_a_lag_that_may_be_of_the_readings_ends_the_tests_with_what_the_answer_will_not_know(tmp_path: Path) -> None:
    """The line said f_c is known to 0.1 %, and the answer that it is not known: 9 of 9 such motors."""
    motor = {"tau_s": 0.1463, "K_rad_s_V": 4.65, "parts": {"lag_s": 0.02}}
    motor |= dict.fromkeys(("fc_plus_V", "fc_minus_V", "fs_plus_V", "fs_minus_V"), 0.268)
    stopped = run(written(tmp_path, {"interval_percent": 1.0}, motor=motor), tmp_path)[1].stopped
    assert stopped is not None and stopped.known and stopped.live[-1].laws == "lag"
    assert stopped.why.endswith("; with lag; so long a lag may be of the readings, and then f_c is not known")


@pytest.mark.evidence
@pytest.mark.usefixtures("plain_motor")
def test_a_known_motor_gets_its_first_test_at_once(known: tuple[Path, RunResult], tmp_path: Path) -> None:
    folder, result = run(written(tmp_path), tmp_path, "--model", known[0])
    assert "search" not in read_run(folder).stages() and result.search is None
    assert result.stopped is not None and result.stopped.known
    assert replay(folder).is_same


@pytest.mark.evidence
@pytest.mark.usefixtures("plain_motor")
def test_a_model_of_another_motor_breaks_a_test_off_and_never_the_run(
    known: tuple[Path, RunResult], tmp_path: Path
) -> None:
    """Three times the gain that is believed: strokes as designed would end beyond the limits."""
    wrong = json.loads((known[0] / "result.json").read_text(encoding="utf-8"))
    wrong["estimates"]["sampled-data"]["K_rad_s_V"] /= 3.0
    wrong.pop("law", None)
    (tmp_path / "result.json").write_text(json.dumps(wrong), encoding="utf-8")
    folder, result = run(written(tmp_path), tmp_path, "--model", tmp_path / "result.json")
    recording = read_run(folder)
    assert "search" not in recording.stages() and result.search is None
    assert float(np.abs(recording.y_rad).max()) < SOFT_RAD
    assert result.stopped is not None and result.stopped.known and not result.faults
    assert replay(folder).is_same


@pytest.mark.evidence
@pytest.mark.usefixtures("plain_motor")
@pytest.mark.parametrize(
    ("bounds", "words"),
    [({"longest_s": 5.0}, "relay.until.longest_s, 5 s, is over"), ({"most_cycles": 3}, "most_cycles, 3, are driven")],
)
def test_what_is_not_known_in_time_ends_at_its_bound_and_is_identified(
    bounds: dict[str, Any], words: str, tmp_path: Path
) -> None:
    folder, result = run(written(tmp_path, {"interval_percent": 0.1, **bounds}), tmp_path)
    stopped = result.stopped
    assert stopped is not None and not stopped.known and words in stopped.why
    assert "sampled-data" in result.estimates and not result.faults
    assert replay(folder).is_same


@pytest.mark.usefixtures("plain_motor")
def test_a_sensor_that_sticks_in_a_test_ends_the_run_and_what_was_recorded_is_identified(tmp_path: Path) -> None:
    # the check takes 5.4 s
    config = written(tmp_path, {"interval_percent": 0.1}, wiring={"sensor": "stuck", "fault_after_s": 8.5})
    folder, result = run(config, tmp_path, status=1)
    assert [fault.code for fault in result.faults] == ["SENSOR_STUCK"]
    assert result.stopped is None and "sampled-data" in result.estimates
    assert replay(folder).is_same


@pytest.mark.usefixtures("plain_motor")
def test_advice_that_never_comes_ends_at_the_bound_with_two_sizes_of_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    monkeypatch.setattr(InTheLoop, "advice", lambda self, row, t_s: None)
    monkeypatch.setattr(InTheLoop, "trouble", "its process was killed by signal 9")
    folder, result = run(written(tmp_path, {"longest_s": 25.0}), tmp_path)
    stopped = result.stopped
    assert stopped is not None and "there was no live estimate: its process was killed" in stopped.why
    assert result.search is not None and {"now a small cycle"} <= {step.outcome for step in result.search}
    assert result.estimates["sampled-data"].verdict in ("ok", "doubtful")
    assert replay(folder).is_same


def test_without_relay_until_a_model_is_refused(known: tuple[Path, RunResult]) -> None:
    done = rig("run", ROOT / "config/simulated.yaml", "--model", known[0])
    assert done.exit_code == 2 and "--model needs relay.until" in done.output


def test_a_run_without_a_usable_estimate_is_no_model(known: tuple[Path, RunResult], tmp_path: Path) -> None:
    text = (known[0] / "result.json").read_text(encoding="utf-8")
    (tmp_path / "result.json").write_text(text.replace('"verdict": "ok"', '"verdict": "refused"'), encoding="utf-8")
    done = rig("run", ROOT / "config/quick.yaml", "--model", tmp_path / "result.json", "--out", tmp_path)
    assert done.exit_code == 2 and "holds no motor that was not refused" in done.output
    done = rig("run", ROOT / "config/quick.yaml", "--model", tmp_path / "nothing", "--out", tmp_path)
    assert done.exit_code == 2 and "is not there" in done.output
