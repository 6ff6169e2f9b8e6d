"""Reports draw the curves that are kept with a run; without these they identify it anew, and say so."""

from __future__ import annotations

import importlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import rig
from synthetic_run import write_run

from rig.core.arrays import Array
from rig.identification import Identification, identify
from rig.output.report import fitted, model_curves, write_report
from rig.output.report.source import load
from rig.output.report.style import AbsentError
from rig.run_folder.recording.curves import read_curves, write_curves
from rig.run_folder.recording.folder import json_text
from rig.run_folder.recording.reader import read_run

pytestmark = pytest.mark.usefixtures("plain_motor", "undrawn")

ANEW = "the recording was identified anew"


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Identification]:
    """A run folder whose result is the answer of its rows, without curves."""
    folder = write_run(tmp_path_factory.mktemp("run") / "20260509T120000Z-synthetic", tracking=False)
    module = importlib.import_module("rig.identification.identification")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_add_motor_law", lambda *_: None)
        found = identify([read_run(folder)])
    result = json.loads((folder / "result.json").read_text())
    del result["estimates"]
    (folder / "result.json").write_text(json_text(result | {"answer": found.as_result().as_json()["answer"]}))
    return folder, found


@pytest.fixture
def run(identified: tuple[Path, Identification], tmp_path: Path) -> Path:
    return Path(shutil.copytree(identified[0], tmp_path / identified[0].name))


@pytest.fixture
def fits(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The runs that a report identifies anew."""
    asked: list[Path] = []

    def counted(recordings: Sequence[Any], *arguments: Any, **options: Any) -> Identification:
        asked.extend(recording.source for recording in recordings)
        return identify(recordings, *arguments, **options)

    monkeypatch.setattr(model_curves, "identify", counted)
    return asked


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[Array]:
    """The residuals that are drawn, with their times."""
    drawn: list[Array] = []

    def look(method: str, t_s: Array, residual_rad: Array) -> Any:
        drawn.append(np.array([t_s, residual_rad]))
        return figure(method, t_s, residual_rad)

    figure = fitted.residual_figure
    monkeypatch.setattr(fitted, "residual_figure", look)
    return drawn


def test_the_kept_residual_is_drawn_and_nothing_is_fitted(
    run: Path, identified: tuple[Path, Identification], fits: list[Path], shown: list[Array]
) -> None:
    found = identified[1]
    assert found.leading is not None
    write_report(run, found)  # as a run does at its end
    at_its_end = (run / "report.html").read_bytes()
    write_report(run)
    assert fits == []
    assert (run / "report.html").read_bytes() == at_its_end
    (run / "curves.json").unlink()
    page = write_report(run).read_text()
    assert fits == [run]
    assert page.count(f"curves.json is missing: {ANEW}") == 1
    for drawn in shown:
        np.testing.assert_allclose(
            drawn, [found.leading.residual_t_s, found.leading.residual_rad], rtol=1e-9, atol=1e-12
        )


@pytest.mark.usefixtures("figureless")
@pytest.mark.parametrize("spoilt", ["rows", "answer", "file"])
def test_curves_that_are_not_of_this_run_are_never_drawn(
    run: Path, identified: tuple[Path, Identification], fits: list[Path], spoilt: str
) -> None:
    write_report(run, identified[1])
    if spoilt == "rows":
        lines = (run / "samples.csv").read_text().splitlines(keepends=True)
        (run / "samples.csv").write_text("".join(lines[:-1]))
    elif spoilt == "answer":
        result = json.loads((run / "result.json").read_text())
        result["answer"]["tau_s"] *= 1.001
        (run / "result.json").write_text(json.dumps(result))
    else:
        (run / "curves.json").write_bytes((run / "curves.json").read_bytes()[:-10])
    assert write_report(run).read_text().count(ANEW) == 1
    assert fits == [run]


@pytest.mark.usefixtures("figureless")
def test_the_models_of_another_run_leave_no_curves(run: Path, identified: tuple[Path, Identification]) -> None:
    result = json.loads((run / "result.json").read_text())
    (run / "result.json").write_text(json.dumps(result | {"models_from": "another"}))
    write_report(run, identified[1])
    assert not (run / "curves.json").exists()


def test_compare_draws_kept_curves_and_says_which_runs_it_identified_anew(
    run: Path, identified: tuple[Path, Identification], fits: list[Path], tmp_path: Path
) -> None:
    kept = identified[1].curves
    assert kept is not None
    write_curves(run, read_run(run), kept)
    second = Path(shutil.copytree(run, tmp_path / "second"))
    assert rig("compare", run, second, "--to", tmp_path / "kept.html").exit_code == 0
    assert fits == []
    assert "dentified anew" not in (tmp_path / "kept.html").read_text()
    (second / "curves.json").unlink()
    assert rig("compare", run, second, "--to", tmp_path / "anew.html").exit_code == 0
    assert fits == [second]
    assert "Identified anew for this picture: second (curves.json is missing)." in (tmp_path / "anew.html").read_text()


@pytest.mark.usefixtures("figureless")
def test_identify_keeps_the_curves_of_a_run_whose_answer_it_finds_again(
    run: Path, identified: tuple[Path, Identification]
) -> None:
    for options in (("--method", "sampled-data"), ("--without", "breakaway"), ("--rows", "0:3000")):
        rig("identify", run, *options)
    rig("identify", run, run / "samples.csv")
    assert not (run / "curves.json").exists(), "that is another question"
    assert rig("identify", run).exit_code == 0
    kept = read_curves(run, read_run(run), identified[1].answer)
    assert identified[1].leading is not None
    np.testing.assert_allclose(kept.residual_rad, identified[1].leading.residual_rad, rtol=1e-9, atol=1e-12)
    written = (run / "curves.json").stat().st_mtime_ns
    assert rig("identify", run).exit_code == 0
    assert (run / "curves.json").stat().st_mtime_ns == written


@pytest.mark.usefixtures("figureless")
def test_identify_leaves_a_folder_with_another_answer_as_it_is(run: Path) -> None:
    result = json.loads((run / "result.json").read_text())
    result["answer"]["tau_s"] *= 1.001
    (run / "result.json").write_text(json.dumps(result))
    assert rig("identify", run).exit_code == 0
    (run / "result.json").unlink()
    assert rig("identify", run).exit_code == 0
    assert not (run / "curves.json").exists()


@pytest.mark.usefixtures("figureless")
def test_identify_answers_where_the_folder_takes_no_file(run: Path) -> None:
    (run / "curves.json").mkdir()
    done = rig("identify", run, "--json")
    assert done.exit_code == 0
    assert json.loads(done.stdout)["ok"]
    assert len([line for line in done.stderr.splitlines() if "curves.json" in line]) == 1


def test_a_run_without_rows_or_motor_has_no_curves(run: Path) -> None:
    (run / "samples.csv").unlink()
    with pytest.raises(AbsentError):
        model_curves.kept_or_fitted(load(run))
    assert Identification().curves is None
