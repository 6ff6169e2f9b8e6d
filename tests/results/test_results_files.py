"""meta.json and result.json as they are written: held to their JSON Schemas, read back equal, documented."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from command_line import rig
from jsonschema import Draft202012Validator

import results_page
from rig import config
from rig.identification import identify
from rig.run_folder.recording.folder import json_text
from rig.run_folder.recording.reader import read_result, read_run
from rig.run_folder.results import Part, RunMeta, RunResult
from rig.run_folder.results.result import schema_text
from rig.run_folder.results.salvage import parsed, unknown_keys
from rig.running.experiment import script as experiment

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = sorted(path.parent for path in (ROOT / "tests/golden").glob("*/meta.json"))
KINDS: dict[str, type[Part]] = {"meta.json": RunMeta, "result.json": RunResult}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A relay test, tracking with its models, and a jog, all simulated, without reports."""
    text = yaml.safe_load((ROOT / "config/quick.yaml").read_text(encoding="utf-8"))
    text["relay"] = {"gains": [{"h1_V": 0.42, "h2_V": 0.85}], "cycles": 8}
    text["tracking"] |= {"duration_s": 2.0, "methods": ["sampled-data"]}
    text["emulated"]["motor"] |= {"viscous_V_s_rad": 0.001}
    parent = tmp_path_factory.mktemp("runs")
    path = parent / "quick.yaml"
    path.write_text(yaml.safe_dump(text), encoding="utf-8")
    e = config.load(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rig.running.session.write_report", lambda *_: None)
        relay = experiment.run_relay(e, parent).folder
        track = experiment.run_tracking(
            e, identify([read_run(relay)], choose_law=False).as_result(), relay, parent
        ).folder
        return [relay, track, experiment.jog(e, 0.5, 0.1, parent).folder]


def test_what_a_run_writes_is_what_the_schemas_say(runs: list[Path]) -> None:
    for folder in runs:
        for name, kind in KINDS.items():
            written = json.loads((folder / name).read_text(encoding="utf-8"))
            validator = Draft202012Validator(json.loads(schema_text(kind)))
            assert [error.message for error in validator.iter_errors(written)] == []
            assert unknown_keys(parsed(kind, written)) == ()


def test_what_is_read_is_written_again_to_the_byte(runs: list[Path]) -> None:
    for folder in runs:
        recording, (result, _) = read_run(folder), read_result(folder)
        assert result is not None
        for name, part in (("meta.json", recording.meta), ("result.json", result)):
            assert json_text(part) == (folder / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("folder", GOLDEN, ids=lambda folder: folder.name)
def test_a_golden_run_is_read_without_a_word_and_written_again_to_the_byte(folder: Path) -> None:
    recording = read_run(folder)
    assert recording.notes == ()
    assert json_text(recording.meta) == (folder / "meta.json").read_text(encoding="utf-8")
    lines = (folder / "events.jsonl").read_text(encoding="utf-8").splitlines()
    assert [event.as_json() for event in recording.events] == [json.loads(line) for line in lines]


@pytest.mark.parametrize(("name", "kind"), results_page.SCHEMAS.items())
def test_the_schemas_in_the_tree_are_those_of_the_models(name: str, kind: type[Part]) -> None:
    """If this fails: `python tools/results_page.py`."""
    text = (results_page.DOCS / name).read_text(encoding="utf-8")
    assert text == schema_text(kind)
    Draft202012Validator.check_schema(json.loads(text))


def test_the_reference_explains_each_key() -> None:
    rows = [line for line in results_page.page_text().splitlines() if line.startswith("| `")]
    assert len(rows) > 90
    assert [row for row in rows if row.endswith("|  |")] == []


def test_the_command_prints_the_schemas() -> None:
    assert rig("schema", "--of", "result").stdout == schema_text(RunResult)
    assert rig("schema", "--of", "meta").stdout == schema_text(RunMeta)
    assert rig("schema", "--of", "campaign").stdout == rig("schema", "--campaign").stdout
