"""`rig predict-run`: an answer, from a file or a run folder, on any record."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import rig as command

import rig
from rig.run_folder.results import Answer, FoundLawResult, HoldsResult, IdentificationResult, LawFrameResult

MOTOR = rig.RealMotor(0.17, 6.5, 0.48, sag_per_V=0.05)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log in ms, as a percentage of 3 V, and degrees."""
    run = rig.simulate(MOTOR, lambda t_s: 1.5 * np.sin(3.0 * t_s), 6.0, rig.Sampling(delay_s=0.004))
    columns = np.stack([1e3 * run.t_s, 100.0 * run.u_V / 3.0, np.degrees(run.y_rad)], axis=1)
    np.savetxt(tmp_path / "log.csv", columns, delimiter=",", header="ms,percent,deg", comments="")
    return tmp_path / "log.csv"


def found_in(folder: Path, **changes: object) -> Path:
    sag = FoundLawResult(name="sag", numbers={"sag_per_V": 0.05}, value=0.05, unit="1/V")
    answer = Answer(
        tau_s=0.17, K_rad_s_V=6.5, fc_V=0.48, delay_s=0.004, verdict="ok", method="sampled-data", law=(sag,),
        law_frame=LawFrameResult(centre_rad=0.0, half_travel_rad=3.0, start_s=0.0, duration_s=6.0),
        holds=HoldsResult(drive_V=(0.2, 1.0)),
    ).model_copy(update=changes)  # fmt: skip
    path = folder / "found.json"
    path.write_text(json.dumps(IdentificationResult(answer=answer).as_json()))
    return path


OPTIONS = ("--time", "ms", "--drive", "percent", "--supply-V", "3", "--position", "deg")


def test_a_log_is_predicted_with_laws_and_delay_and_drawn(tmp_path: Path, log: Path) -> None:
    picture = tmp_path / "picture.png"
    done = command("predict-run", log, "--model", found_in(tmp_path), *OPTIONS, "--picture", picture)
    assert done.exit_code == 0, done.output
    assert "log.csv: fit 100 %," in done.output
    assert "a drive of 1.5 V, and the answer holds up to 1 V" in done.output
    assert picture.is_file()
    again = command("predict-run", log, "--model", found_in(tmp_path), *OPTIONS, "--picture", picture)
    assert again.exit_code == 2 and "is there already" in again.output
    plain = command("predict-run", log, "--model", found_in(tmp_path, law=()), *OPTIONS, "--json")
    (one,) = json.loads(plain.output)["predictions"]
    assert one["fit_percent"] < 99.0 and one["beyond"]


def test_a_log_with_a_gap_is_predicted_from_a_start_after_it(tmp_path: Path, log: Path) -> None:
    lines = log.read_text().splitlines()
    log.write_text("\n".join([*lines[:200], *lines[300:]]) + "\n")
    done = command("predict-run", log, "--model", found_in(tmp_path), *OPTIONS, "--picture", tmp_path / "parts.png")
    assert done.exit_code == 0, done.output
    assert "log.csv: fit 100 %," in done.output and "in 2 parts between its gaps" in done.output


def test_what_holds_no_motor_is_refused_in_words(tmp_path: Path, log: Path) -> None:
    refused = command("predict-run", log, "--model", found_in(tmp_path, verdict="refused"), *OPTIONS)
    assert refused.exit_code == 2 and "there is no motor to predict with" in refused.output
    fast = FoundLawResult(name="sag", numbers={"sag_per_V": -5e9}, value=-5e9, unit="1/V")
    wrong = command("predict-run", log, "--model", found_in(tmp_path, law=(fast,)), *OPTIONS)
    assert wrong.exit_code == 2 and "runs away, or is too stiff to be followed" in wrong.output
    (tmp_path / "other.json").write_text("{}")
    nothing = command("predict-run", log, "--model", tmp_path / "other.json", *OPTIONS)
    assert nothing.exit_code == 2 and "holds no answer" in nothing.output


def test_a_model_of_another_motor_is_asked_about(tmp_path: Path, log: Path) -> None:
    """Only a fit of some percent said it."""
    words = "this model does not tell that record"
    other = command("predict-run", log, "--model", found_in(tmp_path, K_rad_s_V=30.0), *OPTIONS)
    assert other.exit_code == 0 and words in other.output
    own = command("predict-run", log, "--model", found_in(tmp_path), *OPTIONS)
    assert own.exit_code == 0 and words not in own.output


def test_an_answer_given_as_a_recording_is_called_one(tmp_path: Path) -> None:
    for done in (command("identify", found_in(tmp_path)), command("export", found_in(tmp_path), "--to", "mujoco")):
        assert done.exit_code == 2 and "is an answer of `rig identify --json`, not a recording" in done.output
