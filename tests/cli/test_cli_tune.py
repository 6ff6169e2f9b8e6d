"""`rig tune`: the loop for the motor of a run, tried on the emulated bench, recorded and replayed."""

from __future__ import annotations

import json
import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import rig as command
from tuned_run import GOLDEN, few_draws, tuned_run

import rig
from rig import config
from rig.core.motor_numbers import RealMotor
from rig.run_folder.recording.errors import CannotWriteError
from rig.run_folder.results import Answer, IdentificationResult, SamplingResult
from rig.running.run_tuning import LEAST_NOISE_RAD, Asked, of_full_drive, tune_run

CONFIG = rig.ready("simulated")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder of that bench, with the estimate that it gives."""
    return tuned_run(tmp_path_factory.mktemp("tune"))


def test_a_loop_is_tuned_tried_recorded_and_replayed(run: Path, tmp_path: Path) -> None:
    picture = tmp_path / "tune.png"
    done = command("tune", run, "--try", CONFIG, "--draws", 39, "--out", tmp_path / "runs", "--to", picture, "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["ok"] and said["margins"]["worst"]["phase_deg"] >= 45.0
    assert picture.is_file()
    measures = said["prediction"]
    assert measures["overshoot_percent"]["inside"] and measures["overshoot_percent"]["bench"] < 3.0
    assert measures["tracking_rms"]["bench"] < 0.006  # 3 mrad of noise are in it
    folder = Path(said["bench_run"])
    recorded = rig.read(folder)
    assert recorded.stages() == ["rest", "breakaway", "law"]
    assert rig.replay(folder).is_same
    # the config of the run has the law: any bench can drive it again
    assert command("check", folder / "config.yaml").exit_code == 0


@pytest.mark.evidence
def test_a_loop_is_tried_on_an_io_block_that_drives_a_period_late(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over Modbus a drive goes out with the next request: the loop of its run reckons with that."""
    few_draws(monkeypatch)
    folder = tmp_path / "20260101T000000Z-run-modbus"
    shutil.copytree(GOLDEN.parent / "modbus", folder)
    bench = folder / "bench.yaml"  # the run is older than the word for virtual time
    config = (folder / "config.yaml").read_text(encoding="utf-8")
    bench.write_text(config.replace("port: emulated-virtual", "port: emulated"), encoding="utf-8")
    numbers = {"tau_s": 0.168, "K_rad_s_V": 6.42, "fc_V": 0.476, "asym_V": 0.0, "delay_s": 0.01}
    estimate = numbers | {"ci95": {"tau_s": [0.166, 0.17]}, "verdict": "ok"}
    u95 = {"tau_s": 0.003, "K_rad_s_V": 0.08, "fc_V": 0.004}
    result = {"schema": 1, "estimates": {"sampled-data": estimate}, "law": [], "u95": u95}
    (folder / "result.json").write_text(json.dumps(result | {"breakaway": {"noise_rad": 0.0032}}), encoding="utf-8")
    options = ("--draws", 39, "--out", tmp_path / "runs", "--json")
    done = command("tune", folder, "--try", bench, *options)
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert "I/O block" in rig.read(Path(said["bench_run"])).meta.backend
    assert said["law"]["options"]["observer"]["latency_s"] == pytest.approx(0.01, abs=0.002)
    tracking = said["prediction"]["tracking_rms"]
    assert tracking["bench"] < 0.006  # 3 mrad of noise are in it
    assert said["prediction"]["overshoot_percent"]["bench"] < 1.5
    assert rig.replay(said["bench_run"]).is_same


@pytest.mark.evidence
def test_the_words_of_a_velocity_loop(run: Path) -> None:
    done = command("tune", run, "--loop", "velocity", "--bandwidth", "15", "--draws", "39")
    assert done.exit_code == 0, done.output
    assert "velocity loop, 15 rad/s" in done.stdout and "on 39 motors" in done.stdout
    assert "Kp" in done.stdout and "Kd" not in done.stdout and "RMS error of the tracking, rad/s" in done.stdout
    assert "OUTSIDE" not in done.stdout and "bench" not in done.stdout  # none was driven


def test_the_noise_of_the_runs_sensor_is_not_another_sensors(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few_draws(monkeypatch)
    bench = config.load(rig.ready("encoder"))
    found = tune_run(run, Asked("position", 4.0, None, 45.0, 6.0), 39, bench)
    assert found.tuned.sensing.noise_rad == LEAST_NOISE_RAD
    assert found.tuned.sensing.lsb_rad == bench.sensor.curve.lsb_rad


def test_a_trial_that_would_leave_the_soft_limits_does_not_drive_a_bench(run: Path, tmp_path: Path) -> None:
    vague = tmp_path / "vague"
    shutil.copytree(run, vague)
    result = json.loads((vague / "result.json").read_text(encoding="utf-8"))
    result["u95"] = {"tau_s": 0.1, "K_rad_s_V": 3.9, "fc_V": 0.29}
    (vague / "result.json").write_text(json.dumps(result), encoding="utf-8")
    options = ("--loop", "velocity", "--draws", 39, "--out", tmp_path / "runs")
    done = command("tune", vague, *options, "--try", CONFIG)
    assert done.exit_code == 1 and "beyond the soft limits -1.10 to 1.10 rad" in done.stderr
    assert not (tmp_path / "runs").exists()


def test_a_loop_is_tuned_for_the_answer_of_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own period, drives, speeds and travel bound it; a servo's loop asks for the supply."""
    few_draws(monkeypatch)
    found = tmp_path / "found.json"
    numbers = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48, "asym_V": 0.0, "delay_s": 0.004, "verdict": "ok"}
    answer = Answer.model_validate(
        {
            **numbers, "law": [], "u95": {"tau_s": 0.002, "K_rad_s_V": 0.08, "fc_V": 0.004},
            "ci95": {"tau_s": [0.169, 0.171], "K_rad_s_V": [6.48, 6.52]},
            "holds": {"drive_V": [0.1, 2.0], "speed_rad_s": [0.1, 4.0], "travel_rad": [6.0, 8.0]},
        }
    )  # fmt: skip
    sampling = SamplingResult(period_s=0.01, noise_rad=0.003, step_rad=0.001)
    found.write_text(json.dumps(IdentificationResult(answer=answer, sampling=sampling).as_json()), encoding="utf-8")
    tuned = tune_run(found, Asked("position", None, None, 45.0, 6.0), 39)
    assert (tuned.tuned.sensing.period_s, tuned.tuned.sensing.largest_V) == (0.01, 2.0)
    assert tuned.tuned.wish.step == 0.5 and tuned.tuned.wish.top_rad_s == 4.0
    positions = np.concatenate([one.y_rad for one in tuned.prediction.records])
    assert 7.0 - 2.0 * math.pi < positions.max() < 8.0 - 2.0 * math.pi  # a turn away the shaft is where it was
    least = ("--phase-margin", 5, "--gain-margin", 1)
    assert command("tune", found, "--servo", "sts3215", "--supply-V", 7.4, *least).exit_code == 0
    asked = command("tune", found, "--servo", "sts3215")
    assert asked.exit_code == 2 and "add --supply-V" in asked.stderr
    found.write_text(json.dumps(IdentificationResult(answer=answer).as_json()), encoding="utf-8")
    older = command("tune", found)
    assert older.exit_code == 2 and "give --try CONFIG, or identify it anew with --json" in older.stderr
    (tmp_path / "log.csv").write_text("t_s,u_V,y_rad\n", encoding="utf-8")
    log = command("tune", tmp_path / "log.csv")
    assert log.exit_code == 2 and "rig identify" in log.stderr and "--json > found.json" in log.stderr


@pytest.mark.parametrize(
    ("options", "status", "words"),
    [
        (("--bandwidth", "40"), 1, "the largest that is possible is"),
        (("--step", "3"), 1, "give a smaller one: --step"),
        (("--to", "x.gif"), 2, "give a name that ends in .png, .svg, .pdf"),
        (("--to", "nowhere/x.png"), 2, "nowhere is no folder"),
    ],
)
def test_what_cannot_be_is_refused_with_what_can(run: Path, options: tuple[str, ...], status: int, words: str) -> None:
    done = command("tune", run, *options)
    assert done.exit_code == status and words in done.stderr


def test_what_was_found_is_told_whatever_becomes_of_the_picture(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: Path, data: bytes) -> None:
        raise CannotWriteError(file, "No space left on device", "free some")

    few_draws(monkeypatch)
    monkeypatch.setattr("rig.output.report.style.write_whole", full)
    done = command("tune", run, "--draws", 39, "--to", tmp_path / "x.png", "--json")
    assert done.exit_code == 1 and "x.png: No space left on device" in done.stderr
    said = json.loads(done.stdout)
    assert not said["ok"] and said["margins"]["worst"]["phase_deg"] >= 45.0
    monkeypatch.setattr("rig.cli.shared.os.access", lambda path, mode: mode != os.W_OK)
    done = command("tune", run, "--to", tmp_path / "x.png", "--try", tmp_path / "not read")
    assert done.exit_code == 2 and "takes no file of yours" in done.stderr


def test_a_folder_without_a_motor_is_refused(tmp_path: Path) -> None:
    done = command("tune", tmp_path)
    assert done.exit_code == 2 and "is a folder without a run" in done.stderr
    shutil.copy(GOLDEN / "meta.json", tmp_path)
    done = command("tune", tmp_path)
    assert done.exit_code == 2 and "result.json: is missing" in done.stderr


def test_a_loop_for_a_motor_that_runs_free_between_pulses_says_that_it_is_that_of_full_drive() -> None:
    motor = RealMotor(0.1, 5.0, 0.5)
    (words,) = of_full_drive(motor._replace(free_between=0.8, full_drive_V=12.0))
    assert "at a drive of 12 V" in words and "below it K and tau are larger" in words
    assert of_full_drive(motor) == []
