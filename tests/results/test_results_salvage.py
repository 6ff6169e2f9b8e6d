"""Files of older and newer versions, and damaged ones: read on where that is possible, else refused in words."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from command_line import rig
from hypothesis import given
from hypothesis import strategies as st

from rig import read as read_by_api
from rig.output.report.source import load
from rig.run_folder.recording.errors import RecordingError
from rig.run_folder.recording.reader import read_result, read_run
from rig.run_folder.results import RunEvent, RunMeta, RunResult
from rig.run_folder.results.salvage import DamagedError, parsed, salvaged

GOLDEN = Path(__file__).resolve().parents[1] / "golden/simulated-jog"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run of now."""
    return Path(shutil.copytree(GOLDEN, tmp_path / "run"))


def change(path: Path, **keys: Any) -> None:
    old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    path.write_text(json.dumps(old | keys), encoding="utf-8")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"period_s": "0.01"}, "period_s must be a number, not the text '0.01'"),
        ({"period_s": True}, "period_s must be a number, not true"),
        ({"order": "at_random"}, "order must be one of 'sample_first' or 'write_first', not the text 'at_random'"),
        ({"drive_units": -3}, "drive_units must be greater than 0, not -3"),
        ({"drive_units": 7.5}, "drive_units must be a whole number, not 7.5"),
        ({"firmware": {"clock_ratio": 0}}, "firmware.clock_ratio must be greater than 0, not 0"),
        ({"firmware": 3}, "firmware must be an object with keys: 3 is no firmware"),
        ({"truth": {"tau_s": 0.1}}, "truth.K_rad_s_V is missing"),
        ({"script": {"breakaway": "x"}}, "script.name is missing"),
        ({"real_time": {"granted": ["a", 1]}}, "real_time.granted[1] must be text, not 1"),
        ({"schema": None}, "schema must be a whole number, not null"),
    ],
)
def test_a_wrong_value_in_meta_is_left_out_and_named_but_a_replay_refuses_it(
    folder: Path, keys: dict[str, Any], words: str
) -> None:
    change(folder / "meta.json", **keys)
    said = f"meta.json: {words}; rig leaves it out"
    recording = read_run(folder)
    assert recording.notes[0] == said
    assert recording.meta == salvaged(RunMeta, json.loads((folder / "meta.json").read_text(encoding="utf-8")))[0]
    with pytest.raises(RecordingError) as caught:
        read_run(folder, strict=True)
    assert (caught.value.path, caught.value.cause) == (folder / "meta.json", words)
    assert "take that key out" in caught.value.cure
    refused = rig("replay", folder)
    assert refused.exit_code == 2 and f"{folder / 'meta.json'}: {words}" in refused.stderr
    to = folder.parent / "run.json"
    assert said in rig("export", folder, "--to", to).stdout
    assert said in json.loads(to.read_text(encoding="utf-8"))["notes"]


@pytest.mark.evidence
def test_identify_reads_a_run_with_a_wrong_value_and_says_so(tmp_path: Path) -> None:
    """The value that is wrong is one that no estimator reads: the numbers are those of the whole folder."""
    run = Path(shutil.copytree(GOLDEN.parent / "simulated", tmp_path / "run"))
    change(run / "meta.json", host=3)
    events = (run / "events.jsonl").read_text(encoding="utf-8")
    (run / "events.jsonl").write_text('{"t_s": "soon", "kind": 7}\n' + events, encoding="utf-8")
    method = ("--method", "triple-relay")
    sound = json.loads(rig("identify", GOLDEN.parent / "simulated", *method, "--json").stdout)
    found = json.loads(rig("identify", run, *method, "--json").stdout)
    assert found["estimates"] == sound["estimates"]
    assert found["notes"][:2] == [
        "run: meta.json: host must be an object with keys, not 3; rig leaves it out",
        "run: events.jsonl: line 1: t_s must be a number, not the text 'soon'; rig leaves it out, and 1 more",
    ]
    assert found["notes"][1] in rig("identify", run, *method).stdout
    refused = rig("replay", run)
    assert refused.exit_code == 2 and "meta.json: host must be an object with keys" in refused.stderr
    assert "meta.json: host must be" in read_by_api(run).notes[0]


def test_a_wrong_value_in_result_is_left_out_and_named(folder: Path) -> None:
    estimates = {"sampled-data": {"tau_s": 0.17, "fc_V": "0.48", "rows": [1]}, "own": 7}
    change(
        folder / "result.json", backend="here", estimates=estimates, relays=[{"stage": "relay-1"}, 2], notes=["a", 1]
    )
    result, notes = read_result(folder)
    assert result is not None and result.estimates["sampled-data"].tau_s == 0.17
    said = "result.json: relays[0].h1_V is missing; rig leaves it out"
    assert said in notes
    to = folder.parent / "a.json"
    assert said in rig("export", folder, "--to", to).stdout
    assert json.loads(to.read_text(encoding="utf-8"))["result"]["estimates"] == {"sampled-data": {"tau_s": 0.17}}
    assert set(notes) <= set(read_by_api(folder).notes)

    run = load(folder)
    assert run.result.estimates["sampled-data"].tau_s == 0.17
    assert run.result.estimates["sampled-data"].fc_V is None and run.result.estimates["sampled-data"].rows is None
    assert (list(run.result.estimates), run.result.relays, run.result.notes) == (["sampled-data"], (), ("a",))
    said = " ".join(run.missing + run.notes)
    for key in ("relays[0].h1_V is missing", "estimates.sampled-data.fc_V must", "estimates.own must", "notes[1] must"):
        assert f"result.json: {key}" in said


def test_what_a_newer_version_wrote_is_read_and_named(folder: Path) -> None:
    change(folder / "meta.json", schema=2, colour="red", firmware={"clock_ratio": 1.0, "temperature_C": 31.0})
    change(folder / "result.json", schema=2, backend="here", estimates={"sampled-data": {"tau_s": 0.2, "mood": 1}})
    notes = read_run(folder).notes
    assert notes == (
        "meta.json: a newer version of rig wrote it (schema 2; this one knows 1)",
        "meta.json: not known to this version of rig, and not used: colour, firmware.temperature_C",
    )
    assert read_result(folder)[1][1].endswith("not used: estimates.sampled-data.mood")
    to = folder.parent / "a.json"
    assert [line.split(":")[0] for line in rig("export", folder, "--to", to).stdout.splitlines()[:-1]] == [
        *("meta.json", "meta.json", "result.json", "result.json")
    ]
    exported = json.loads(to.read_text(encoding="utf-8"))
    assert (exported["meta"]["colour"], exported["result"]["estimates"]["sampled-data"]["mood"]) == ("red", 1)
    assert any("temperature_C" in note for note in load(folder).notes)


def test_a_number_that_is_not_finite_is_not_known() -> None:
    meta = RunMeta(period_s=float("nan"), times_error_s=float("inf"))
    assert meta.as_json() == {"period_s": None, "times_error_s": None}


def test_keys_that_were_not_there_are_not_written() -> None:
    assert RunMeta().as_json() == RunResult().as_json() == {}
    assert parsed(RunMeta, {"drive_units": None}).says("drive_units") and not RunMeta().says("drive_units")
    assert RunResult(jog=None, backend="here").as_json() == {"backend": "here"}
    event = {"t_s": 1.0, "kind": "own", "value": [1, {"a": None}]}
    assert parsed(RunEvent, event).as_json() == event
    assert parsed(RunEvent, event).detail == {"value": [1, {"a": None}]}


ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
KEYS = st.sampled_from(
    [
        "schema",
        "estimates",
        "relays",
        "rows",
        "ci95",
        "tau_s",
        "loop",
        "late_us",
        "truth",
        "notes",
        "firmware",
        "script",
    ]
)
STRANGE = st.recursive(
    ANY_JSON, lambda inner: st.dictionaries(KEYS, inner, max_size=4) | st.lists(inner, max_size=3), max_leaves=12
)


@given(st.dictionaries(KEYS, STRANGE, max_size=6))
def test_whatever_stands_in_a_file_is_a_part_or_damaged_and_can_be_salvaged(data: dict[str, Any]) -> None:
    for kind in (RunMeta, RunResult):
        part, left_out = salvaged(kind, data)
        try:
            strict = parsed(kind, data)
        except DamagedError as error:
            assert error.cause and left_out
        else:
            assert left_out == [] and strict.as_json() == part.as_json()
        json.dumps(part.as_json(), allow_nan=False)
