"""`rig list`: one line for each run; the index is never trusted over the folder."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from command_line import rig
from compared_runs import Told, write_run

from rig.run_folder.catalogue import INDEX, catalogue


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Three runs, a killed one, a damaged one, a campaign, and a folder that is none of them."""
    folder = tmp_path / "runs"
    for k, fc in enumerate((0.52, 0.48, 0.50)):
        write_run(folder / f"r{k}", Told(fc_V=fc, verdict="doubtful" if k == 1 else "ok"), hour=k)
    write_run(folder / "r3-killed")
    write_run(folder / "r4-damaged", Told())
    (folder / "r4-damaged" / "result.json").write_text("{")
    write_run(folder / "campaign", Told())
    (folder / "campaign" / "results.csv").write_text("number\n")
    (folder / "notes").mkdir()
    return folder


def listed(folder: Path, *options: object) -> list[dict[str, Any]]:
    done = rig("list", folder, *options, "--json")
    assert done.exit_code == 0, done.output
    found: list[dict[str, Any]] = json.loads(done.stdout)["runs"]
    return found


def names(folder: Path, *options: object) -> list[str]:
    return [run["name"] for run in listed(folder, *options)]


def test_each_run_is_a_line(runs: Path) -> None:
    found = {run["name"]: run for run in listed(runs)}
    assert list(found) == ["r0", "r1", "r2", "r3-killed", "r4-damaged"]
    assert found["r0"]["fc_V"] == 0.52
    assert found["r0"]["fc_percent"] == pytest.approx(100.0 * 1.96 * 0.0005 / 0.52)
    assert (found["r0"]["state"], found["r0"]["command"], found["r0"]["duration_s"]) == ("done", "run", 10.0)
    assert found["r3-killed"]["state"] == "no result"
    assert found["r4-damaged"]["state"] == "damaged"
    shown = rig("list", runs).stdout
    assert shown.startswith("5 runs\n")
    assert "r4-damaged: " in shown.splitlines()[-1]


def test_conditions_choose_and_fields_order(runs: Path) -> None:
    assert names(runs, "--where", "fc_V>=0.5") == ["r0", "r2"]
    assert names(runs, "--where", "verdict = OK", "--where", "name!=r0") == ["r2"]
    assert names(runs, "--where", "name~kill") == ["r3-killed"]
    assert names(runs, "--where", "tau_s=") == ["r3-killed", "r4-damaged"]  # not known
    assert names(runs, "--sort", "fc_V") == ["r1", "r2", "r0", "r3-killed", "r4-damaged"]
    assert names(runs, "--sort", "-fc_V")[:3] == ["r0", "r2", "r1"]
    assert names(runs, "--sort", "verdict", "--sort", "fc_V")[:3] == ["r1", "r2", "r0"]
    assert rig("list", runs, "--where", "fc_V>9").stdout == "0 of 5 runs\n"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--where", "friction>1"), "no field 'friction'"),
        (("--where", "fc_V"), "is no condition"),
        (("--where", "fc_V>much"), "'much' is no number"),
        (("--sort", "size"), "no field 'size'"),
    ],
)
def test_a_bad_question_says_what_there_is(runs: Path, options: tuple[str, str], said: str) -> None:
    done = rig("list", runs, *options)
    assert done.exit_code == 2
    assert said in done.output


def test_the_index_is_used_and_follows_the_folder(runs: Path) -> None:
    assert catalogue(runs).read == 5
    assert catalogue(runs).read == 0
    shutil.rmtree(runs / "r0")
    write_run(runs / "r9", Told())
    (runs / "r1" / "result.json").write_text((runs / "r9" / "result.json").read_text())  # identified anew
    found = catalogue(runs)
    assert found.read == 2
    assert [run.name for run in found.runs] == ["r1", "r2", "r3-killed", "r4-damaged", "r9"]
    assert found.runs[0].verdict == "ok"


@pytest.mark.parametrize(
    "damage", ["", "{", '{"rig_index": 0}\n', "\x00\xff", '{"rig_index": 1, "rig": "0.1.0"}\n{"run": {}}\n', "torn"]
)
def test_a_lost_damaged_or_older_index_is_made_anew(runs: Path, damage: str) -> None:
    before = catalogue(runs).runs
    whole = (runs / INDEX).read_text()
    (runs / INDEX).write_text(whole[: len(whole) // 2] if damage == "torn" else damage, encoding="latin-1")
    found = catalogue(runs)
    assert (found.runs, found.read) == (before, 5)
    assert (runs / INDEX).read_text() == whole


def test_a_folder_that_takes_no_index_is_listed_all_the_same(runs: Path) -> None:
    (runs / INDEX).mkdir()  # nothing can replace it
    done = rig("list", runs)
    assert done.exit_code == 0
    assert "5 runs" in done.stdout
    assert "no index" in done.stderr


def test_what_is_no_folder_of_runs_is_refused(runs: Path) -> None:
    inside = rig("list", runs / "r0")
    assert inside.exit_code == 2
    assert "is a run itself" in inside.output
    assert rig("list", runs / "nowhere").exit_code == 2
    assert rig("list", runs / "r0" / "meta.json").exit_code == 2
