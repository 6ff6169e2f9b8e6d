"""`rig rehearse`: nobody who reads of such a run, wherever that is, takes it for a measurement."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import rig
from tuned_run import few_draws

from rig.output.report.source import load
from rig.output.report.words import headline
from rig.panel.past_runs import Runs
from rig.run_folder.results.meta import REHEARSAL

ROOT = Path(__file__).resolve().parents[2]


def bench(folder: Path) -> Path:
    """The Uno's ready config, for a real port, with a short experiment."""
    data: dict[str, Any] = yaml.safe_load((ROOT / "config/uno.yaml").read_text(encoding="utf-8"))
    data["relay"] = {"gains": [{"h1_V": 0.04, "h2_V": 0.62}], "cycles": 4}
    data["tracking"] |= {"duration_s": 2.0, "methods": ["sampled-data"]}
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def rehearsal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a rehearsal, and beside it what the command said."""
    folder = tmp_path_factory.mktemp("rehearsal")
    sheet = ("--no-load-rpm", "8000", "--rated-V", "12", "--gear", "14", "--friction-V", "0.4", "--tau-s", "0.05")
    told = rig("rehearse", bench(folder), *sheet, "--out", folder / "runs")
    assert told.exit_code == 0, told.output
    (folder / "told.txt").write_text(told.stdout, encoding="utf-8")
    (run,) = (folder / "runs").glob("*-rehearsal-uno")
    return run


def test_its_files_its_report_and_its_last_words_say_so_and_it_finds_the_motor(rehearsal: Path) -> None:
    meta, result = (json.loads((rehearsal / name).read_text()) for name in ("meta.json", "result.json"))
    assert (meta["rehearsal"], result["rehearsal"]) == (True, True)
    assert meta["backend"].startswith("rehearsal, nothing real: emulated")
    assert result["answer"]["tau_s"] == pytest.approx(result["truth"]["tau_s"], rel=0.02)
    assert result["truth"]["tau_s"] == 0.05
    told = (rehearsal.parents[1] / "told.txt").read_text()
    assert REHEARSAL in told and "off the emulated motor" in told
    page = (rehearsal / "report.html").read_text(encoding="utf-8")
    assert "<title>Rehearsal: " in page
    assert f'<p class="rehearsal">R{REHEARSAL[1:]}.</p>' in page


def test_a_rehearsal_that_went_well_leads_to_the_bench_and_to_no_controller(rehearsal: Path) -> None:
    run = load(rehearsal)
    assert run.result.answer is not None
    well = run.result.model_copy(update={"answer": run.result.answer.model_copy(update={"verdict": "ok"})})
    found = headline(replace(run, result=well))
    assert found.title == "The made-up motor is identified"
    assert [step.command for step in found.next_steps] == [""] and "Wire the bench" in found.next_steps[0].text


def test_each_command_that_reads_it_says_so(rehearsal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few_draws(monkeypatch)
    page = tmp_path / "page.html"
    assert rig("identify", rehearsal, "--report", page).stdout.startswith(REHEARSAL)
    assert "<title>Rehearsal: " in page.read_text(encoding="utf-8")
    assert json.loads(rig("identify", rehearsal, "--json").stdout)["rehearsal"] is True
    assert rig("tune", rehearsal, "--draws", 39).stdout.startswith(f"{rehearsal.name}: {REHEARSAL}")
    listed = json.loads(rig("list", rehearsal.parent, "--json").stdout)
    assert [run["rehearsal"] for run in listed["runs"]] == [True]
    assert "rehearsal: done" in rig("list", rehearsal.parent).stdout
    assert [run["rehearsal"] for run in Runs(rehearsal.parent).rows()] == [True]
    copy = tmp_path / "copy"
    copy.mkdir()
    for name in ("meta.json", "result.json"):
        (copy / name).write_text((rehearsal / name).read_text())
    assert f"note: copy: {REHEARSAL}" in rig("compare", rehearsal, copy).stdout
    exported = rig("export", rehearsal, "--to", "wpilib", "--into", tmp_path)
    assert exported.exit_code == 0, exported.output
    assert "rehearsal, nothing real" in next(tmp_path.glob("*wpilib*")).read_text(encoding="utf-8")


def test_who_is_driven_by_its_models_hears_it(rehearsal: Path, tmp_path: Path) -> None:
    done = rig("track", ROOT / "config/simulated.yaml", "--model", rehearsal, "--out", tmp_path)
    assert f"the models come from {rehearsal}, {REHEARSAL}" in done.stdout
    (run,) = tmp_path.iterdir()
    result = json.loads((run / "result.json").read_text())
    assert "rehearsal" not in result
    assert any(note.endswith(REHEARSAL) for note in result["notes"])


def test_a_config_that_does_not_fit_is_refused_before_anything_runs(tmp_path: Path) -> None:
    path = bench(tmp_path)
    refused = rig("rehearse", path, "--tau-s", 0.9, "--out", tmp_path / "runs")
    assert (refused.exit_code, (tmp_path / "runs").exists()) == (2, False)
    assert "bench.yaml:" in refused.output and "limits.coast_tau_s" in refused.output
    refused = rig("rehearse", path, "--gear", 0, "--json", "--out", tmp_path / "runs")
    assert (refused.exit_code, json.loads(refused.stdout)["cause"]) == (2, "--gear 0 is no motor's")
    path.write_text(path.read_text().replace("supply_V: 12.0", "supply_V: 0"))
    refused = rig("rehearse", path)
    assert refused.exit_code == 2 and "drive.supply_V" in refused.output


def test_a_fault_of_a_rehearsal_speaks_of_the_config_before_it_speaks_of_wires(tmp_path: Path) -> None:
    told = rig("rehearse", bench(tmp_path), "--friction-V", 1.3, "--out", tmp_path / "runs")
    assert told.exit_code == 1 and "rig: NO_MOTION: " in told.stderr
    assert "     nothing is wired in a rehearsal: the config's numbers do not suit" in told.stderr
    (run,) = (tmp_path / "runs").iterdir()
    (fault,) = json.loads((run / "result.json").read_text())["faults"]
    assert fault["cure"].startswith("nothing is wired in a rehearsal")


def test_emulate_of_a_config_without_a_motor_names_it(tmp_path: Path) -> None:
    path = bench(tmp_path)
    refused = rig("emulate", path)
    assert refused.exit_code == 2 and f"`rig rehearse {path}`" in refused.output
