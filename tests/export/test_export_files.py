"""What `rig export` writes, read back by what others would open it with."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import rig
from evidence import evidence
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import loadmat

from rig.identification import identify
from rig.output.export import export, matlab_names
from rig.run_folder.recording.folder import json_text, write_whole
from rig.run_folder.recording.reader import read, read_run
from rig.run_folder.recording.sample_columns import COLUMNS

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
RUN = GOLDEN / "simulated-fault"
RESULT: dict[str, Any] = {
    "schema": 1,
    "estimates": {
        "sampled-data": {
            "tau_s": 0.17,
            "verdict": "ok",
            "reasons": [],
            "rows": [10, 20],
            "fc_plus_V": None,
            "covariance": [[1.0, None], [3.0, 4.0]],
        }
    },
    "tracking": {"end": {"not_run": "no"}},
    "notes": ["a", "µ"],
    "search": [{"outcome": "no oscillation"}, {"outcome": "settled", "h1_V": 11.0}],
}


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "20260101T000000Z-a"
    shutil.copytree(RUN, folder)
    write_whole(folder / "result.json", json_text(RESULT))
    return folder


def test_a_mat_file_has_columns_with_units_and_nested_structs(run_folder: Path, tmp_path: Path) -> None:
    export(run_folder, tmp_path / "a.mat")
    found = loadmat(tmp_path / "a.mat")
    recording = read_run(run_folder)
    samples, units = found["samples"][0, 0], found["units"][0, 0]
    assert samples.dtype.names == COLUMNS
    assert samples["y_rad"].shape == (len(recording), 1)
    for name in COLUMNS:
        if name != "stage":
            assert np.array_equal(samples[name][:, 0], getattr(recording, name).astype(float), equal_nan=True), name
    assert [str(cell[0]) for cell in samples["stage"][:, 0]] == recording.stage.tolist()
    assert (units["y_rad"][0], units["late_us"][0], units["v_rad_per_s"][0]) == ("rad", "us", "rad/s")

    plain = loadmat(tmp_path / "a.mat", simplify_cells=True)
    estimate = plain["result"]["estimates"]["sampled_data"]
    assert (estimate["tau_s"], estimate["verdict"], estimate["rows"].tolist()) == (0.17, "ok", [10.0, 20.0])
    assert estimate["fc_plus_V"].size == 0
    assert [step["outcome"] for step in plain["result"]["search"]] == ["no oscillation", "settled"]
    assert plain["result"]["search"][1]["h1_V"] == 11.0
    assert plain["result"]["search"][0]["h1_V"].size == 0
    assert plain["result"]["notes"].tolist() == ["a", "µ"]
    assert plain["result"]["tracking"]["xend"]["not_run"] == "no"  # `end` is no name in MATLAB
    assert np.array_equal(estimate["covariance"], [[1.0, np.nan], [3.0, 4.0]], equal_nan=True)
    assert plain["config"]["limits"]["soft_rad"].tolist() == [-1.1, 1.1]
    assert [event["kind"] for event in plain["events"]] == [event.kind for event in recording.events]
    assert plain["meta"]["period_s"] == 0.01


def as_written(result: dict[str, Any]) -> dict[str, Any]:
    """Without the answer, which the reader makes of a result that has none."""
    assert result["answer"]["verdict"] == RESULT["estimates"]["sampled-data"]["verdict"]
    return {key: part for key, part in result.items() if key != "answer"}


def test_an_npz_file_opens_without_pickle(run_folder: Path, tmp_path: Path) -> None:
    export(run_folder, tmp_path / "a.npz")
    recording = read_run(run_folder)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as found:
        for name in COLUMNS:
            ours = getattr(recording, name)
            assert found[name].dtype == ours.dtype
            assert np.array_equal(found[name], ours, equal_nan=name != "stage" and ours.dtype.kind == "f")
        assert as_written(json.loads(str(found["result"]))["result"]) == RESULT
        assert json.loads(str(found["units"]))["units"]["u_V"] == "V"
        assert json.loads(str(found["events"]))["events"] == [event.as_json() for event in recording.events]


def test_a_json_file_is_one_strict_object(run_folder: Path, tmp_path: Path) -> None:
    export(run_folder, tmp_path / "a.json")
    found = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    recording = read_run(run_folder)
    assert found["samples"]["t_s"] == recording.t_s.tolist()
    assert found["samples"]["yd_rad"][0] is None
    assert as_written(found["result"]) == RESULT
    assert (found["run"], found["units"]["z_rad_s"]) == (run_folder.name, "rad s")


@pytest.mark.parametrize("name", ["simulated-hysteretic", "modbus-separate", *evidence("simulated")])
def test_a_csv_file_gives_exactly_the_estimates_of_the_folder(name: str, tmp_path: Path) -> None:
    export(GOLDEN / name, tmp_path / "a.csv")
    ours = identify([read(tmp_path / "a.csv")], choose_law=False)
    theirs = identify([read(GOLDEN / name)], choose_law=False)
    assert list(ours.estimates) == list(theirs.estimates)
    assert len(theirs.estimates) > 0
    for method, estimate in theirs.estimates.items():
        assert json.dumps(ours.estimates[method].as_result().as_json()) == json.dumps(estimate.as_result().as_json())


def test_a_csv_file_of_one_stage_is_plain_and_gives_what_its_rows_give(tmp_path: Path) -> None:
    run = export(GOLDEN / "simulated", tmp_path / "a.csv", "relay-1")
    whole = read_run(GOLDEN / "simulated")
    rows = whole.stage_rows("relay-1")
    assert len(run.recording) == rows.stop - rows.start
    with (tmp_path / "a.csv").open(encoding="utf-8") as file:
        assert next(csv.reader(file)) == ["t_s", "u_V", "y_rad", "t_u_s"]
    found = read(tmp_path / "a.csv")
    for name in ("t_s", "u_V", "y_rad", "t_u_s"):
        assert np.array_equal(getattr(found, name), getattr(whole, name)[rows], equal_nan=True)
    ours = identify([found], ("sampled-data",), choose_law=False).estimates["sampled-data"]
    same = identify([whole.select(rows.start, rows.stop - 1)], ("sampled-data",), choose_law=False)
    theirs = same.estimates["sampled-data"]
    assert ours.as_result().as_json() | {"rows": None} == theirs.as_result().as_json() | {"rows": None}


def test_the_command_says_what_it_wrote(run_folder: Path, tmp_path: Path) -> None:
    to = tmp_path / "a.mat"
    assert rig("export", run_folder, "--to", to).stdout == f"{to}: {len(read_run(run_folder))} rows\n"
    again = rig("export", run_folder, "--to", to)
    assert (again.exit_code, again.stderr.splitlines()[0]) == (2, f"rig: {to}: is there already")
    assert "--force" in again.stderr
    forced = rig("export", run_folder, "--to", to, "--force", "--json")
    assert json.loads(forced.stdout) == {"ok": True, "file": str(to), "rows": len(read_run(run_folder)), "notes": []}
    assert [path.name for path in tmp_path.iterdir() if path != run_folder] == ["a.mat"]


@pytest.mark.parametrize("name", ["samples.csv", "result.json", "meta.json"])
def test_a_file_of_the_run_itself_is_never_replaced(run_folder: Path, name: str) -> None:
    before = (run_folder / name).read_bytes()
    for force in ([], ["--force"]):
        result = rig("export", run_folder, "--to", run_folder / name, *force)
        assert result.exit_code == 2
        assert result.stderr.splitlines()[0] == f"rig: {run_folder / name}: is a file of the run itself"
    assert (run_folder / name).read_bytes() == before


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".json"])
def test_what_identify_cannot_read_back_is_said(run_folder: Path, tmp_path: Path, suffix: str) -> None:
    to = tmp_path / f"a{suffix}"
    assert rig("export", run_folder, "--to", to).exit_code == 0
    result = rig("identify", to)
    assert result.exit_code == 2
    cause, cure = result.stderr.splitlines()
    assert cause == f"rig: {to}: is neither a run folder nor a CSV file"
    assert "--to FILE.csv" in cure


def test_a_torn_folder_is_exported_as_far_as_it_is_there(run_folder: Path, tmp_path: Path) -> None:
    """As `kill -9` leaves it: no result, half a line, and no meta.json where it came that early."""
    rows = len(read_run(run_folder))
    for name in ("result.json", "meta.json", "config.yaml"):
        (run_folder / name).unlink()
    with (run_folder / "samples.csv").open("a", encoding="ascii") as file:
        file.write(f"{rows},5")
    with (run_folder / "events.jsonl").open("a", encoding="ascii") as file:
        file.write('{"t_s": 5.16, "kind": "loop_died"}\n')
    for suffix in (".mat", ".npz", ".json", ".csv"):
        result = rig("export", run_folder, "--to", tmp_path / f"a{suffix}")
        assert result.exit_code == 0
        assert result.stdout.splitlines() == [
            f"line {rows + 2}, the last, is torn and was left out (5 bytes)",
            "meta.json is missing",
            "result.json is missing: the run ended before it had a result",
            "the run was killed: its recording is complete to its last tick",
            "config.yaml is missing",
            f"{tmp_path / f'a{suffix}'}: {rows} rows",
        ]
    found = loadmat(tmp_path / "a.mat", simplify_cells=True)
    assert found["samples"]["t_s"].shape == (rows,)
    assert (found["result"], found["meta"], found["config"]) == ({}, {}, {})
    assert found["notes"][1] == "meta.json is missing"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--to", "a.xlsx"], "a.xlsx: ends in none of .mat, .npz, .csv, .json, and is no tool"),
        (["--to", "a"], "a: ends in none of .mat, .npz, .csv, .json"),
        (["--to", "none/a.mat"], "none: is no folder"),
        (["--to", "folder.mat"], "folder.mat: is a folder"),
        (["--to", f"{'a' * 300}.mat"], "a.mat: cannot be written: File name too long"),
        (["--to", "a.csv", "--stage", "relay-9"], "has no stage 'relay-9'"),
    ],
)
def test_what_cannot_be_is_refused_in_two_lines(
    run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder.mat").mkdir()
    result = rig("export", run_folder, *arguments)
    assert result.exit_code == 2
    assert words in result.stderr.splitlines()[0]
    assert len(result.stderr.splitlines()) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == [run_folder.name, "folder.mat"]


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    campaign = tmp_path / "campaign"
    campaign.mkdir()
    (campaign / "results.csv").write_text("number\n", encoding="ascii")
    (campaign / "meta.json").write_text("{}", encoding="ascii")
    for path in (campaign, tmp_path, tmp_path / "none"):
        result = rig("export", path, "--to", tmp_path / "a.mat")
        assert (result.exit_code, len(result.stderr.splitlines())) == (2, 2), result.output
        assert str(path) in result.stderr
    assert not (tmp_path / "a.mat").exists()


@given(st.lists(st.text(max_size=80), max_size=8))
def test_every_name_becomes_one_of_its_own_that_matlab_takes(names: list[str]) -> None:
    made = matlab_names(names)
    assert len(set(made)) == len(names)
    for name in made:
        assert name.isascii()
        assert name.isidentifier()
        assert name[0].isalpha()
        assert len(name) <= 63


def test_names_that_matlab_takes_stay_as_they_are() -> None:
    assert matlab_names(["tau_s", "sampled-data", "sampled_data", "1", "_x", "end"]) == [
        "tau_s", "sampled_data", "sampled_data_2", "x1", "x_x", "xend",
    ]  # fmt: skip
