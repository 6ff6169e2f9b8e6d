"""Experiments on benches that act many ticks late: measured, predicted over, replayed; or refused before any relay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import rig
from evidence import evidence

from rig.run_folder.recording.reader import read_run
from rig.running.replay import replay

ROOT = Path(__file__).resolve().parents[2]


def ran(folder: Path, seed: int = 1, **emulated: float) -> tuple[dict[str, Any], Path]:
    """A run of config/simulated.yaml at given gains, with changes to its emulated bench."""
    config = yaml.safe_load((ROOT / "config/simulated.yaml").read_text(encoding="utf-8"))
    config["seed"] = seed
    config["emulated"] |= {key: value for key, value in emulated.items() if key != "delay_s"}
    config["emulated"]["motor"] |= {key: value for key, value in emulated.items() if key == "delay_s"}
    config["tracking"]["methods"] = ["sampled-data"]
    config["relay"] = {"gains": [{"h1_V": 0.45, "h2_V": 0.9}, {"h1_V": 0.4, "h2_V": 0.75}], "cycles": 8}
    path = folder / "late.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    result = rig("run", path, "--out", folder, "--json")
    outcome = json.loads(result.stdout)
    return outcome, Path(outcome["folder"])


def identified(outcome: dict[str, Any]) -> dict[str, Any]:
    assert outcome["ok"], outcome.get("cause")
    estimate: dict[str, Any] = outcome["estimates"]["sampled-data"]
    assert estimate["verdict"] == "ok", estimate["reasons"]
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert estimate[name] == pytest.approx(outcome["truth"][name], rel=0.03)
    return estimate


@pytest.mark.evidence
def test_a_drive_that_waits_in_the_device_for_many_ticks(tmp_path: Path) -> None:
    prompt, _ = ran(tmp_path, latency_s=0.005)
    late, folder = ran(tmp_path, latency_s=0.035)
    estimate = identified(late)
    low, high = estimate["ci95"]["delay_s"]
    assert low < 0.035 < high
    assert high - low < 0.0001
    # an ideal predictor costs little: the motor hardly strays in 30 ms
    rms = [outcome["tracking"]["sampled-data"]["rms_rad"] for outcome in (prompt, late)]
    assert rms[1] < 1.25 * rms[0]
    assert any("the guard brakes 25 ms earlier" in note for note in late["notes"])
    same = replay(folder)
    assert same.is_same, same.difference
    assert same.compared > 0.95 * same.rows


def test_a_delay_that_no_device_reports(tmp_path: Path) -> None:
    outcome, folder = ran(tmp_path, delay_s=0.025)
    estimate = identified(outcome)
    low, high = estimate["ci95"]["delay_s"]
    assert low < 0.0262 < high  # 1.2 ms until the device's output
    assert high - low < 0.0015
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.006
    assert replay(folder).is_same


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("latency_s", "the device reports that a drive acts 100 ms after its sample"),
        ("delay_s", "the strokes of the breakaway check moved the reading"),
    ],
)
@pytest.mark.parametrize("seed", [1, *evidence(2)])
def test_without_room_for_its_delay_a_bench_is_refused_before_any_relay(
    tmp_path: Path, key: str, words: str, seed: int
) -> None:
    """Seed 2 moves later than the check looks: it would say that nothing moved."""
    outcome, folder = ran(tmp_path, seed=seed, **{key: 0.1})
    (fault,) = outcome["faults"]
    assert fault["code"] == "DELAY"
    assert words in fault["detail"]
    assert "there is room for 38 ms" in fault["detail"]
    assert not any(stage.startswith(("search", "relay", "track")) for stage in read_run(folder).stages())
    assert replay(folder).is_same


@pytest.mark.evidence
def test_a_short_delay_that_no_device_reports_is_fitted_although_the_strokes_do_not_show_it(tmp_path: Path) -> None:
    outcome, folder = ran(tmp_path, delay_s=0.008)
    low, high = identified(outcome)["ci95"]["delay_s"]
    assert low < 0.0092 < high
    assert "the drive acts later than the recording says: its delay is fitted" in outcome["notes"]
    assert replay(folder).is_same
