"""The least-squares experiment in virtual time, as a user runs it: alone, and beside the relay tests."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import Result
from command_line import rig

from rig.run_folder.recording.reader import read_run

pytestmark = pytest.mark.made

ROOT = Path(__file__).resolve().parents[2]
READY = ROOT / "config/least-squares.yaml"


def written(folder: Path, **sections: Any) -> Path:
    """config/least-squares.yaml with whole sections replaced."""
    data = yaml.safe_load(READY.read_text(encoding="utf-8"))
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(data | sections), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def ready_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, dict[str, Any]]:
    result = rig("run", READY, "--out", tmp_path_factory.mktemp("runs"), "--json")
    return result, json.loads(result.stdout)


def test_the_ready_config_ends_well_and_finds_the_friction(ready_run: tuple[Result, dict[str, Any]]) -> None:
    result, outcome = ready_run
    assert result.exit_code == 0, result.output
    assert list(outcome["estimates"]) == ["sampled-data", "least-squares"]
    estimate, truth = outcome["estimates"]["least-squares"], outcome["truth"]
    assert estimate["verdict"] in ("ok", "doubtful")
    assert estimate["tau_s"] is None
    assert estimate["K_rad_s_V"] is None
    assert estimate["fc_V"] == pytest.approx(truth["fc_V"], rel=0.06)
    for name in ("fc_V", "asym_V"):
        low, high = estimate["ci95"][name]
        assert low < truth[name] < high
    exact = outcome["estimates"]["sampled-data"]
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert exact[name] == pytest.approx(truth[name], rel=0.03)


def test_every_run_starts_from_rest_at_zero_and_is_recorded_past_its_first_switching(
    ready_run: tuple[Result, dict[str, Any]],
) -> None:
    _, outcome = ready_run
    recording = read_run(Path(outcome["folder"]))
    assert [s for s in recording.stages() if s not in ("rest", "homing")] == [
        "breakaway", "hysteretic-1", "hysteretic-2", "hysteretic-3", "hysteretic-4",
    ]  # fmt: skip
    configured = yaml.safe_load(READY.read_text(encoding="utf-8"))["relay"]["hysteretic"]
    for run, wanted in zip(outcome["hysteretic"], configured, strict=True):
        assert run["d_V"] == pytest.approx(wanted["d_V"], abs=0.016)  # a step of the PWM
        assert run["eps_rad"] == wanted["eps_rad"]
        rows = recording.stage_rows(run["stage"])
        u, y = recording.u_V[rows], recording.y_rad[rows]
        resting = int(np.flatnonzero(u)[0])
        assert resting >= 45
        assert abs(run["start_rad"]) < 0.005
        assert abs(y[:resting].mean()) < 0.005
        switched = resting + int(np.flatnonzero(u[resting:] * wanted["d_V"] < 0.0)[0])
        assert abs(y[switched]) > wanted["eps_rad"] >= np.abs(y[:switched]).max()
        assert run["switched_rad"] == y[switched]
        assert np.count_nonzero(np.diff(np.sign(u[resting:]))) >= 5
    assert np.abs(recording.y_rad).max() < 0.899  # what `rig check` promises
    assert not recording.flags.any()


def test_the_report_shows_runs_and_recursion_and_no_number_where_there_is_none(
    ready_run: tuple[Result, dict[str, Any]],
) -> None:
    _, outcome = ready_run
    page = (Path(outcome["folder"]) / "report.html").read_text(encoding="utf-8")
    assert "Hysteretic runs" in page
    assert "Recursive least squares" in page
    assert 'id="transients-2"' in page
    assert ">nan" not in page
    row = page[page.index("least squares<span") :].split("</tr>")[0]
    assert {"τ", "K"} <= set(re.findall(r'data-is="(\w+),[^"]*">–', row))


def test_identify_by_least_squares_alone_from_the_folder(ready_run: tuple[Result, dict[str, Any]]) -> None:
    _, outcome = ready_run
    alone = rig("identify", outcome["folder"], "--method", "least-squares", "--json")
    assert alone.exit_code == 0, alone.output
    (estimate,) = json.loads(alone.stdout)["estimates"].values()
    assert estimate["fc_V"] == outcome["estimates"]["least-squares"]["fc_V"]
    shown = rig("identify", outcome["folder"], "--method", "least-squares", "--verbose")
    row = next(line for line in shown.stdout.splitlines() if line.startswith("least-squares  "))
    assert row.split()[1:3] == ["-", "-"]  # tau and K


def test_identify_from_two_csv_files(ready_run: tuple[Result, dict[str, Any]], tmp_path: Path) -> None:
    _, outcome = ready_run
    recording = read_run(Path(outcome["folder"]))
    for name, stage in (("A", "hysteretic-1"), ("B", "hysteretic-2")):
        rows = recording.stage_rows(stage)
        columns = (recording.t_s[rows], recording.u_V[rows], recording.y_rad[rows])
        lines = [",".join(map(repr, map(float, row))) for row in zip(*columns, strict=True)]
        (tmp_path / f"{name}.csv").write_text("t_s,u_V,y_rad\n" + "\n".join(lines) + "\n", encoding="utf-8")
    pair = (tmp_path / "A.csv", tmp_path / "B.csv")
    result = rig("identify", "--method", "least-squares", *pair, "--json")
    assert result.exit_code == 0, result.output
    estimate = json.loads(result.stdout)["estimates"]["least-squares"]
    upwards = outcome["truth"]["fc_V"] - outcome["truth"]["asym_V"]
    low, high = estimate["ci95"]["fc_V"]
    assert low < upwards < high
    assert estimate["fc_V"] == pytest.approx(upwards, rel=0.08)
    one = rig("identify", "--method", "least-squares", pair[0])
    assert one.exit_code == 2
    assert len(one.stderr.splitlines()) == 2
    twice = rig("identify", "--method", "least-squares", pair[0], pair[0], "--json")
    assert twice.exit_code == 2  # the same rows are no second run
    copy = shutil.copy(pair[0], tmp_path / "copy.csv")
    twice = rig("identify", "--method", "least-squares", pair[0], copy, "--json")
    assert twice.exit_code == 1
    assert "do not differ" in json.loads(twice.stdout)["estimates"]["least-squares"]["reasons"][0]


@pytest.mark.evidence
def test_beside_a_relay_test_all_methods_are_compared(tmp_path: Path) -> None:
    runs = yaml.safe_load(READY.read_text(encoding="utf-8"))["relay"]["hysteretic"][:2]
    whole = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    relay = {"gains": [{"h1_V": 0.42, "h2_V": 0.85}], "cycles": 5, "hysteretic": runs}
    config = written(tmp_path, relay=relay, tracking=whole["tracking"])
    result = rig("run", config, "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 0, result.output
    outcome = json.loads(result.stdout)
    assert {"sampled-data", "triple-relay", "least-squares"} <= set(outcome["estimates"])
    assert [r["stage"] for r in outcome["relays"]] == ["relay-1"]
    assert [r["stage"] for r in outcome["hysteretic"]] == ["hysteretic-1", "hysteretic-2"]
    assert "least-squares" not in outcome["tracking"]
    assert outcome["tracking"]["sampled-data"]["rms_rad"] < 0.03
    assert outcome["estimates"]["least-squares"]["verdict"] == "doubtful"  # one way alone


def test_a_drive_below_the_breakaway_level_is_a_fault_before_anything_moves(tmp_path: Path) -> None:
    relay = {"hysteretic": [{"d_V": 0.4, "eps_rad": 0.5}, {"d_V": 1.0, "eps_rad": 0.3}]}
    result = rig("relay", written(tmp_path, relay=relay), "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1
    outcome = json.loads(result.stdout)
    assert [fault["code"] for fault in outcome["faults"]] == ["DRIVE_TOO_SMALL"]
    assert "run 1: d_V +0.400 V" in outcome["faults"][0]["detail"]
    assert not any(s.startswith(("homing", "hysteretic")) for s in read_run(Path(outcome["folder"])).stages())


def test_a_run_that_dies_in_its_second_part_still_has_a_readable_report(tmp_path: Path) -> None:
    emulated = yaml.safe_load(READY.read_text(encoding="utf-8"))["emulated"]
    emulated["wiring"] = {"drive": "dead", "fault_after_s": 14.0}
    result = rig("run", written(tmp_path, emulated=emulated), "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1
    outcome = json.loads(result.stdout)
    assert outcome["faults"][0]["code"] in ("SENSOR_STUCK", "NOT_HOME", "NO_SWITCHING")
    assert "Traceback" not in result.output
    assert outcome["faults"][0]["code"] in (Path(outcome["folder"]) / "report.html").read_text(encoding="utf-8")
