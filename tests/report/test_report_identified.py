"""`rig identify` of any recording: its lines, its picture and its page."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import rig

import rig as api
from rig.identification import identify
from rig.output.report.simulated import MOST, figure_of, fit_in_words, simulated
from rig.output.report.style import AbsentError
from rig.run_folder.recording.errors import CannotWriteError
from rig.run_folder.recording.reader import read

pytestmark = pytest.mark.drawn


@pytest.fixture(scope="module")
def chirp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A CSV file of a chirp, as somebody records who never heard of relays."""
    t_s = np.arange(1500) * 0.01
    drive = [2.0 * math.sin((1.0 + 0.25 * t) * t) for t in t_s.tolist()]
    run = api.simulate(api.Motor(0.17, 6.5, api.coulomb(0.48)), drive, 15.0, api.Sampling(noise_rad=0.002))
    path = tmp_path_factory.mktemp("chirp") / "chirp.csv"
    rows = zip(run.t_s.tolist(), run.u_V.tolist(), run.y_rad.tolist(), strict=True)
    path.write_text("t_s,u_V,y_rad\n" + "".join(f"{t:.9g},{u:.9g},{y:.9g}\n" for t, u, y in rows), encoding="utf-8")
    return path


def test_the_summary_of_a_recording_is_under_ten_lines_and_the_rest_is_there_if_asked_for(
    chirp: Path, tmp_path: Path
) -> None:
    picture, report = tmp_path / "fit.png", tmp_path / "fit.html"
    done = rig("identify", chirp, "--picture", picture, "--report", report)
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert len(lines) < 10 and [line.split()[0] for line in lines[:3]] == ["tau", "K", "f_c"]
    assert f"picture: {picture}" in lines and f"report: {report}" in lines
    assert picture.read_bytes().startswith(b"\x89PNG")
    page = report.read_text(encoding="utf-8")
    assert "The motor is identified" in page and "Measured against simulated" in page and "http" not in page
    again = rig("identify", chirp, "--picture", picture)
    assert again.exit_code == 2 and "is there already" in again.stderr and "--force" in again.stderr
    details = rig("identify", chirp, "--verbose", "--report", report, "--force")
    assert details.stdout.splitlines()[:3] == lines[:3]
    assert "the plain motor by each method" in details.stdout and "uncertainty at 95 % (u95)" in details.stdout
    assert "relay" not in done.stdout
    assert not any(words in details.stdout for words in ("triple-relay", "describing", "no cycle", "dual-channel"))
    found = json.loads(rig("identify", chirp, "--json").stdout)
    assert found["ok"] and found["answer"]["verdict"] in ("ok", "doubtful")
    assert {"with_law", "law", "law_frame", "u95", "u95_absolute"}.isdisjoint(found)
    assert found["sampling"]["period_s"] == pytest.approx(0.01) and found["sampling"]["step_rad"] == 0.0
    assert found["sampling"]["noise_rad"] == pytest.approx(0.002, rel=0.1)


def test_what_was_found_is_told_though_the_disk_takes_no_picture(
    chirp: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: Path, data: bytes) -> None:
        raise CannotWriteError(file, "No space left on device", "free some")

    monkeypatch.setattr("rig.output.report.simulated.write_whole", full)
    done = rig("identify", chirp, "--rows", ":400", "--picture", tmp_path / "fit.png")
    assert done.exit_code == 1 and "fit.png: No space left on device" in done.stderr
    assert done.stdout.startswith("tau") and "picture" not in done.stdout


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("--picture", "fit.gif", "give a name that ends in .png"),
        ("--report", "fit.png", "give a name that ends in .html"),
        ("--report", "nowhere/fit.html", "is no folder"),
        ("--picture", "samples.csv", "give a name that ends in .png"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused_before_the_work(
    option: str, name: str, words: str, tmp_path: Path
) -> None:
    done = rig("identify", tmp_path / "not there.csv", option, tmp_path / name)
    assert done.exit_code == 2 and words in done.stderr


@pytest.mark.evidence
def test_the_fit_is_that_of_a_simulation_of_the_whole_test_and_a_wrong_motor_fits_worse(chirp: Path) -> None:
    found = identify([read(chirp)])
    (test,) = simulated(found)
    assert test.fit_percent > 98.0 and float(np.std(test.residual_rad)) == pytest.approx(0.002, rel=0.15)
    assert test.t_s.size == len(found.tests[0]) and fit_in_words([test]) == f"chirp.csv {test.fit_percent:.1f} %"
    found.tests = [test_ for test_ in found.tests for _ in range(MOST + 1)]
    assert len(figure_of(found, simulated(found)).axes) == 2 * MOST
    plain = found.estimates["sampled-data"]
    object.__setattr__(plain, "K_rad_s_V", 0.5 * plain.K_rad_s_V)  # the motor of another bench
    found.motor_law = None
    (wrong, *_) = simulated(found)
    assert wrong.fit_percent < 80.0


@pytest.mark.evidence
@pytest.mark.usefixtures("plain_motor")
def test_a_refused_answer_has_no_picture_and_says_why(tmp_path: Path) -> None:
    drive = [1.8 * math.sin(4.0 * t) for t in (0.01 * np.arange(600)).tolist()]
    run = api.simulate(api.Motor(0.17, 6.5, api.coulomb(0.48)), drive, 6.0)
    unsigned = replace(run, u_V=np.abs(run.u_V))
    found = identify([unsigned])
    assert found.answer is not None and found.answer.is_refused and found.best is None
    with pytest.raises(AbsentError, match="no motor to simulate"):
        simulated(found)
    path, picture, report = tmp_path / "unsigned.csv", tmp_path / "a.png", tmp_path / "a.html"
    rows = zip(unsigned.t_s.tolist(), unsigned.u_V.tolist(), unsigned.y_rad.tolist(), strict=True)
    path.write_text("t_s,u_V,y_rad\n" + "".join(f"{t:.9g},{u:.9g},{y:.9g}\n" for t, u, y in rows), encoding="utf-8")
    done = rig("identify", path, "--picture", picture, "--report", report)
    assert done.exit_code == 1 and "picture: none: The answer is refused" in done.stdout
    assert not picture.exists() and "there is no motor to simulate" in report.read_text(encoding="utf-8")
    assert done.stdout.startswith("refused: ")
