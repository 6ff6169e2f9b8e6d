"""`rig campaign` as a person and a script see it, and the configs that come with it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest
from command_line import rig
from small_campaign import small

from rig.campaign import report, results, trial
from rig.campaign.trial import Row, run_trial
from rig.config import Campaign, ConfigError, dump, load_campaign

ROOT = Path(__file__).resolve().parents[2]
READY = sorted((ROOT / "config").glob("campaign*.yaml"))


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(dump(small(3)), encoding="utf-8")
    return path


def test_json_is_one_object_and_pipes_see_no_progress(tmp_path: Path, config: Path) -> None:
    result = rig("campaign", config, "--out", tmp_path, "--jobs", 1, "--json")
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    found = json.loads(result.stdout)
    assert found["number"] == found["session"]["experiments"] == 3
    assert found["session"]["experiments_per_s"] > 0.0
    assert set(found["ok"]["parameters"]) == {"tau_s", "K_rad_s_V", "fc_V", "asym_V", "delay_s"}
    assert (Path(found["folder"]) / "report.html").is_file()


@pytest.mark.usefixtures("no_report")
def test_the_table_goes_to_stdout_and_nothing_to_stderr(tmp_path: Path, config: Path) -> None:
    result = rig("campaign", config, "--out", tmp_path, "--jobs", 1, "--number", 2)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    for words in ("RMS/bound", "coverage", "2 experiments: 2 ok", "results.csv", "report.html", "a second"):
        assert words in result.stdout
    again = rig("campaign", config, "--out", tmp_path, "--jobs", 1, "--number", 2)
    assert "done now" not in again.stdout


@pytest.mark.usefixtures("no_report")
def test_resuming_with_another_config_is_refused_in_two_lines(tmp_path: Path, config: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    assert rig("campaign", config, "--resume", folder, "--jobs", 1, "--number", 1).exit_code == 0
    config.write_text(dump(small(3, seed=2)), encoding="utf-8")
    result = rig("campaign", config, "--resume", folder)
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 2
    assert "seed is 1 there and 2 here" in result.stderr


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_the_ready_configs_are_campaigns(path: Path) -> None:
    campaign = load_campaign(path)
    assert campaign.experiments >= 2000
    result = rig("check", path)
    assert result.exit_code == 0, result.output
    assert f"{campaign.experiments} random experiments" in result.stdout


def test_the_main_config_is_the_grid_of_theory_section_8() -> None:
    campaign = load_campaign(ROOT / "config/campaign.yaml")
    assert campaign.experiments == 10_000
    assert campaign.sensor.lsb_rad == 4.2 / 1024
    defaults = load_campaign(ROOT / "config/campaign-coarse.yaml")
    assert (campaign.motor, campaign.relay, campaign.sampling) == (defaults.motor, defaults.relay, defaults.sampling)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("tau_s: [0.08, 0.5]", "tau_s: [0.5, 0.08]", ["motor.tau_s", "low <= high"]),
        ("tau_s: [0.08, 0.5]", "tau_ms: [80, 500]", ["motor.tau_ms", "did you mean 'tau_s'"]),
        ("fc_V: [0.1, 0.5]", "fc_V: [-0.1, 0.5]", ["motor.fc_V", "at least 0"]),
        ("experiments: 10000", "experiments: 1e4", ["experiments", "whole number"]),
        ("cycles: 10", "cycles: 0", ["relay.cycles", "at least 1"]),
        ("noise_rad: 0.003", "noise_rad: 3 mrad", ["sensor.noise_rad", "must be a number"]),
        ("delay_s: [0.0005, 0.0095]", "delay_s: [0.0005, 0.03]", ["sampling", "at most 2 * `period_s`"]),
        ("delay_s: [0.0005, 0.0095]", "delay_jitter_s: 0.001", ["sampling", "no drive acts before its sample"]),
        ("period_s: 0.010", "jitter_s: 0.006", ["sampling", "samples must stay in order"]),
        ("name: grid", "nmae: grid", ["nmae", "did you mean 'name'"]),
    ],
)
def test_bad_keys_are_said_with_file_line_and_key(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    text = (ROOT / "config/campaign.yaml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "bad.yaml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    result = rig("campaign", path, "--out", tmp_path)
    assert result.exit_code == 2
    lines = result.stderr.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith(f"{path}:")
    assert all(word in lines[0] for word in words), lines
    assert sorted(tmp_path.iterdir()) == [path]


def test_experiments_and_campaigns_are_told_apart(tmp_path: Path, config: Path) -> None:
    run = rig("run", config)
    assert run.exit_code == 2
    assert "run it with `rig campaign`" in run.stderr
    campaign = rig("campaign", ROOT / "config/demo.yaml")
    assert campaign.exit_code == 2
    assert "run it with `rig run`" in campaign.stderr


def test_a_scheduler_needs_dask(config: Path) -> None:
    result = rig("campaign", config, "--scheduler", "tcp://127.0.0.1:8786")
    assert result.exit_code == 2
    assert "--backend dask" in result.stderr


def test_without_its_packages_it_says_what_to_install(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "joblib", None)
    for name in ("runner", "session"):
        monkeypatch.delitem(sys.modules, f"rig.campaign.{name}", raising=False)
        monkeypatch.delattr(f"rig.campaign.{name}", raising=False)
    result = rig("campaign", config, "--out", tmp_path)
    assert result.exit_code == 2
    assert "the package joblib, which is not installed" in result.stderr
    assert "pip install 'motor-rig[campaign]'" in result.stderr
    assert not list(tmp_path.glob("campaign-*"))
    assert rig("campaign", config, "--experiment", 0).exit_code == 0  # one experiment needs none


def test_impossible_ranges_end_in_two_lines(tmp_path: Path) -> None:
    path = tmp_path / "small.yaml"
    path.write_text(dump(small(3, relay={"least_samples": 5000.0})), encoding="utf-8")
    result = rig("campaign", path, "--out", tmp_path, "--jobs", 1)
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 2
    assert "5000 samples" in result.stderr


def test_a_dumped_campaign_loads_back_equal(tmp_path: Path, config: Path) -> None:
    campaign = small(
        7, sensor={"correlated": {"coefficient": 0.5, "std_rad": 0.001}}, drive_noise={"coefficient": 0.0, "std_V": 0.1}
    )
    config.write_text(dump(campaign), encoding="utf-8")
    assert load_campaign(config) == campaign
    with pytest.raises(ConfigError, match="no such file"):
        load_campaign(tmp_path / "none.yaml")


def failing(campaign: Campaign, number: int) -> Row:
    if number == 1:
        raise ZeroDivisionError("no way")
    return run_trial(campaign, number)


@pytest.mark.usefixtures("no_report")
def test_a_failed_experiment_is_said_ends_in_status_1_and_can_be_repeated(
    tmp_path: Path, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "run_trial", failing)
    result = rig("campaign", config, "--out", tmp_path, "--jobs", 1)
    assert result.exit_code == 1, result.output
    assert "3 experiments: 2 ok, 0 doubtful, 0 refused, 1 failed" in result.stdout
    said = next(line for line in result.stdout.splitlines() if "failed, by a defect" in line)
    words = said.split("repeat the first: rig ")[1].split()
    assert words[-2:] == ["--experiment", "1"]
    again = rig(*words)
    assert isinstance(again.exception, ZeroDivisionError)
    monkeypatch.undo()
    row = json.loads(rig(*words).stdout)
    assert (row["number"], row["verdict"]) == (1, "ok")
    assert row["tau_s"] == run_trial(small(3), 1)["tau_s"]


def test_an_experiment_that_the_campaign_does_not_have_is_refused(config: Path) -> None:
    result = rig("campaign", config, "--experiment", 3)
    assert result.exit_code == 2
    assert "there is no experiment 3" in result.stderr and "0 to 2" in result.stderr


def test_where_all_fail_status_and_words_say_so(tmp_path: Path, config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "run_trial", lambda *_: 1 / 0)
    result = rig("campaign", config, "--out", tmp_path, "--jobs", 1)
    assert result.exit_code == 1
    assert len(result.stderr.splitlines()) == 2
    assert "the first 3 experiments all failed" in result.stderr


def test_a_full_disk_leaves_the_old_report_whole(
    tmp_path: Path,
    config: Path,
    monkeypatch: pytest.MonkeyPatch,
    largest_file: Callable[[int], AbstractContextManager[None]],
) -> None:
    """What the page needs does not fit any more; rows still do."""
    monkeypatch.setattr(report, "drawn", lambda *_: bytes(30_000))
    folder = results.folder_for(tmp_path, small(3))
    assert rig("campaign", config, "--out", tmp_path, "--jobs", 1, "--number", 2).exit_code == 0
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with largest_file(20_000):
        result = rig("campaign", config, "--out", tmp_path, "--jobs", 1)
    assert result.exit_code == 1, result.output
    cause, cure = result.stderr.splitlines()
    assert cause == f"rig: {folder / 'campaign.png'}: cannot be written: File too large"
    assert "free space" in cure
    after = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert set(after) == set(before)
    for name in ("report.html", "campaign.png"):
        assert after[name] == before[name]
    assert rig("campaign", config, "--out", tmp_path, "--jobs", 1).exit_code == 0
