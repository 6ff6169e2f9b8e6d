"""The survey in virtual time, by the command: its map, its limits, its replay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from command_line import rig
from survey_config import ROOT, written

from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.control.loop.runner import Loop
from rig.control.sweeps import Sweeps
from rig.core.signals import Sample
from rig.run_folder.recording.reader import read_run

pytestmark = [pytest.mark.long, pytest.mark.made]
NARROW = {"soft_rad": [-0.05, 0.05], "hard_rad": [-1.95, 1.95], "max_speed_rad_s": 4.9, "coast_tau_s": 0.2}


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("survey")
    sweeps = {"speeds_rad_s": [0.7, 0.4, 0.3], "longest_s": 60}
    result = rig("survey", written(folder, survey=sweeps), "--out", folder / "runs")
    assert result.exit_code == 0, result.stderr
    (run,) = (folder / "runs").iterdir()
    outcome: dict[str, Any] = json.loads((run / "result.json").read_text(encoding="utf-8"))
    return {**outcome, "folder": str(run), "shown": result.stdout}


def test_the_map_is_the_true_motor_within_its_error_bars(survey: dict[str, Any]) -> None:
    """Against the formula of the emulated motor; its friction at rest is the Stribeck level."""
    found, fc, bias = survey["friction_map"], 0.48, 0.01
    low, high = found["travel_rad"]
    y = np.linspace(low, high, 200)
    # the window over the whole travel rises and falls over a fifth of it
    near_end = np.clip(np.minimum(y - low, high - y) / (0.2 * (high - low)), 0.0, 1.0)
    weight = near_end - np.sin(2.0 * np.pi * near_end) / (2.0 * np.pi)
    force = 0.08 * np.sin(y)
    for one in found["speeds"]:
        v = one["speed_rad_s"]
        level = fc + 0.06 * np.exp(-abs(v) / 0.4)
        true = v / 6.5 + np.sign(v) * level + np.average(force, weights=weight) - bias
        assert one["drive_V"] == pytest.approx(true, abs=4.0 * one["error_V"] + 0.001)
        assert not one["sticks"] and one["error_V"] < 0.01
    for one in found["positions"]:
        true = 0.08 * np.sin(one["y_rad"]) - bias
        assert one["force_V"] == pytest.approx(true, abs=4.0 * one["error_V"] + 0.002)


def test_the_shaft_keeps_within_the_soft_limits_and_rests_at_the_end(survey: dict[str, Any]) -> None:
    recording = read_run(Path(survey["folder"]))
    rows = recording.stage_rows("survey")
    assert recording.y_rad[rows].min() > -1.1 and recording.y_rad[rows].max() < 1.1
    assert np.isfinite(recording.yd_rad[rows]).all() and not recording.flags[rows].any()
    assert recording.u_V[-1] == 0.0


def test_its_replay_drives_the_same(survey: dict[str, Any]) -> None:
    result = rig("replay", survey["folder"], "--json")
    done = json.loads(result.stdout)
    assert result.exit_code == 0 and done["ok"] and done["replayed"] == done["rows"]


def test_its_report_has_the_map_and_its_terminal_lines_name_it(survey: dict[str, Any]) -> None:
    page = (Path(survey["folder"]) / "report.html").read_text(encoding="utf-8")
    assert "Friction map: drive over speed." in page and "Friction map: drive over position" in page
    assert "friction map: " in survey["shown"] and "speed, rad/s" in survey["shown"]


def test_a_survey_can_be_left_out(survey: dict[str, Any]) -> None:
    result = json.loads(rig("identify", survey["folder"], "--without", "survey", "--json").stdout)
    assert "friction_map" not in result


@pytest.mark.parametrize(
    ("sections", "words"),
    [
        ({"survey": {"longest_s": 4.0}}, "longer than 4 s"),
        ({"survey": {}, "limits": NARROW}, "the slowest sweep that the sensor resolves is at"),
    ],
    ids=["too long", "too short a travel"],
)  # fmt: skip
def test_without_room_it_is_refused_before_anything_moves(sections: dict[str, Any], words: str, tmp_path: Path) -> None:
    result = rig("survey", written(tmp_path, **sections), "--out", tmp_path / "runs")
    assert result.exit_code == 1
    assert "NO_SWEEPS" in result.stderr and words in result.stderr
    assert not (tmp_path / "runs").exists()


@pytest.mark.evidence
def test_the_rehearsal_has_the_delay_that_the_strokes_have_shown(tmp_path: Path) -> None:
    """Without it the rehearsal passes, and the shaft is lost in the sweeps."""
    limits = {"soft_rad": [-1.1, 1.1], "hard_rad": [-1.95, 1.95], "max_speed_rad_s": 3.0, "coast_tau_s": 0.2}
    relay = {"gains": [{"h1_V": 0.42, "h2_V": 0.75}], "cycles": 4}
    path = written(tmp_path, limits=limits, relay=relay, survey={"longest_s": 200})
    config = yaml.safe_load(path.read_text(encoding="utf-8"))
    config["emulated"]["motor"]["delay_s"] = 0.07
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    outcome = json.loads(rig("survey", path, "--out", tmp_path / "runs", "--json").stdout)
    (fault,) = outcome["faults"]
    assert fault["code"] == "NO_SWEEPS" and "in simulation on the best model" in fault["detail"]
    assert "survey" not in read_run(Path(outcome["folder"])).stages()


def test_speeds_that_do_not_fit_are_a_problem_of_the_config(tmp_path: Path) -> None:
    result = rig("check", written(tmp_path, survey={"speeds_rad_s": [0.7, 3.0]}))
    assert result.exit_code == 2
    assert "survey.speeds_rad_s" in result.stderr and "3 rad/s is too fast for a travel of 1.98 rad" in result.stderr


def test_the_check_of_a_thorough_config_names_the_sweeps(tmp_path: Path) -> None:
    result = rig("check", written(tmp_path, identify={"thorough": True}))
    assert result.exit_code == 0
    assert "stage survey, if the relay tests leave the motor's law open" in result.stdout
    assert "at about 0.7, 0.4, 0.2 rad/s" in result.stdout


def test_an_e_stop_in_a_sweep_ends_the_run_without_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Measured at the output of an emulated I/O block, which cuts its drive but latches nothing."""
    blocks: list[VirtualIoBlock] = []
    begin, step, sweeping = VirtualIoBlock.__init__, Sweeps.step, 0

    def made(block: VirtualIoBlock, *given: Any, **named: Any) -> None:
        begin(block, *given, **named)
        blocks.append(block)

    def pressed(law: Sweeps, sample: Sample) -> float:
        nonlocal sweeping
        sweeping += 1
        if sweeping == 300:
            assert blocks[-1].outputs[-1][1] != 0.0
            blocks[-1].block.e_stop_open = True
        return step(law, sample)

    config = yaml.safe_load((ROOT / "config/modbus-rtu.yaml").read_text(encoding="utf-8"))
    config.pop("tracking", None)
    config |= {"relay": {"gains": [{"h1_V": 0.42, "h2_V": 0.84}], "cycles": 6}, "survey": {"longest_s": 60}}
    config["daq"]["port"] = "emulated"
    path = tmp_path / "survey.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    monkeypatch.setattr(VirtualIoBlock, "__init__", made)
    original = Loop.run  # only its own sweeps count: the rehearsal before them steps the law, too

    def run(loop: Loop, law: Any, stage: str, *given: Any) -> None:
        with monkeypatch.context() as patch:
            if stage == "survey":
                patch.setattr(Sweeps, "step", pressed)
            original(loop, law, stage, *given)

    monkeypatch.setattr(Loop, "run", run)
    result = rig("survey", path, "--out", tmp_path / "runs", "--json")
    assert [fault["code"] for fault in json.loads(result.stdout)["faults"]] == ["DEVICE_ESTOP"]
    assert blocks[-1].outputs[-1][1] == 0.0
    (folder,) = (tmp_path / "runs").iterdir()
    assert read_run(folder).stages()[-1] in ("survey", "rest")
