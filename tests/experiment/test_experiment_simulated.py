"""The whole experiment in virtual time, through the command line, as a user runs it."""

from __future__ import annotations

import json
import math
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import Result
from command_line import rig
from evidence import evidence

from rig.run_folder.recording.reader import read_run
from rig.run_folder.results import MotorLawResult

pytestmark = [pytest.mark.long, pytest.mark.laws]

ROOT = Path(__file__).resolve().parents[2]


def written(folder: Path, **changes: object) -> Path:
    """config/simulated.yaml with changes: dotted keys."""
    config = yaml.safe_load((ROOT / "config/simulated.yaml").read_text(encoding="utf-8"))
    for key, value in changes.items():
        *sections, last = key.split("__")
        section = config
        for name in sections:
            section = section.setdefault(name, {})
        section[last] = value
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def demo_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, dict[str, Any]]:
    result = rig("run", ROOT / "config/simulated.yaml", "--out", tmp_path_factory.mktemp("runs"), "--json")
    return result, json.loads(result.stdout)


def test_the_run_keeps_what_its_bench_may_be_wrong_by_and_counts_it(demo_run: tuple[Result, dict[str, Any]]) -> None:
    """The defaults of the config, the calibration of config/simulated.yaml."""
    _, outcome = demo_run
    meta = json.loads((Path(outcome["folder"]) / "meta.json").read_text(encoding="utf-8"))
    span = 2.0 * 2.0015625
    assert meta["sensor"].pop("full_range_rad") == pytest.approx(1023.0 / 976.0 * span)
    assert meta["sensor"] == {
        "linearity_percent": 1.0, "calibration_error_rad": 0.01, "calibration_rad": [-2.0015625, 2.0015625],
    }  # fmt: skip
    assert meta["drive"]["supply_error_percent"] == 1.0
    gain = outcome["answer"]["K_rad_s_V"]
    lines = {line["source"]: line["K_rad_s_V"] / gain for line in outcome["budget"] if line["absolute"]}
    assert lines["supply"] == pytest.approx(2.0 * 0.01 / 3.0**0.5, rel=1e-3)
    assert lines["calibration"] == pytest.approx(2.0 * 0.01 * (2.0 / 3.0) ** 0.5 / span, rel=1e-3)


def test_it_ends_well_and_finds_the_truth(demo_run: tuple[Result, dict[str, Any]]) -> None:
    result, outcome = demo_run
    assert result.exit_code == 0, result.output
    estimate, truth = outcome["estimates"]["sampled-data"], outcome["truth"]
    assert estimate["verdict"] == "ok", estimate["reasons"]
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert estimate[name] == pytest.approx(truth[name], rel=0.03)
        low, high = estimate["ci95"][name]
        assert low < estimate[name] < high
        assert high - low < 0.08 * truth[name]
    assert outcome["backend"] == "simulated in virtual time"


def test_the_models_that_are_ok_track_alike_and_the_describing_function_worse(
    demo_run: tuple[Result, dict[str, Any]],
) -> None:
    _, outcome = demo_run
    tracking = outcome["tracking"]
    ran = {method: entry["rms_rad"] for method, entry in tracking.items() if "rms_rad" in entry}
    assert set(tracking) == {"sampled-data", "triple-relay", "describing-function"}
    assert ran["sampled-data"] < 0.005 and ran["triple-relay"] < 0.005 < 0.01 < ran["describing-function"]
    verdicts = {method: estimate["verdict"] for method, estimate in outcome["estimates"].items()}
    assert verdicts == {"sampled-data": "ok", "triple-relay": "ok", "describing-function": "doubtful"}
    for entry in tracking.values():
        assert "rms_rad" in entry or entry["not_run"]


def test_breakaway_finds_static_friction_both_ways(demo_run: tuple[Result, dict[str, Any]]) -> None:
    _, outcome = demo_run
    breakaway, truth = outcome["breakaway"], outcome["truth"]
    assert breakaway["static_plus_V"] == pytest.approx(truth["static_plus_V"], abs=0.03)
    assert breakaway["static_minus_V"] == pytest.approx(truth["static_minus_V"], abs=0.03)


def test_the_run_folder_reads_back_whole_and_stays_inside_the_soft_limits(
    demo_run: tuple[Result, dict[str, Any]],
) -> None:
    _, outcome = demo_run
    folder = Path(outcome["folder"])
    names = {path.name for path in folder.iterdir()}
    assert {"config.yaml", "meta.json", "samples.csv", "events.jsonl", "result.json", "report.html"} <= names
    recording = read_run(folder)
    assert len(recording) == outcome["loop"]["ticks"]
    assert math.isclose(float(recording.t_u_s[0] - recording.t_s[0]), 0.0012, abs_tol=0.0004)
    assert abs(recording.y_rad).max() < 1.1
    assert not recording.flags.any()  # the guard never had to step in
    stages = recording.stages()
    assert [s for s in stages if s != "rest"] == [
        "breakaway", "search", "relay-1", "relay-2",
        *(f"track:{m}" for m, entry in outcome["tracking"].items() if "rms_rad" in entry),
    ]  # fmt: skip
    assert json.loads((folder / "result.json").read_text())["schema"] == 1


@pytest.mark.evidence
def test_identify_from_the_folder_and_from_the_bare_csv(
    demo_run: tuple[Result, dict[str, Any]], tmp_path: Path
) -> None:
    _, outcome = demo_run
    folder = Path(outcome["folder"])
    again = rig("identify", folder, "--json")
    assert again.exit_code == 0
    identified = json.loads(again.stdout)
    assert identified.pop("records") == [str(folder)]
    assert identified.pop("picture") is identified.pop("report") is None
    shared = ("ok", "answer", "estimates", "relays", *MotorLawResult.model_fields)
    for key in [key for key in shared if key in outcome]:  # one shape: what both have is the same
        assert identified.pop(key) == outcome[key]
    assert outcome["breakaway"].items() >= identified.pop("breakaway").items()
    assert set(identified.pop("notes")) <= set(outcome["notes"])
    assert identified.pop("sampling")["period_s"] == pytest.approx(0.01)  # `rig tune` reads it
    assert not identified
    recording = read_run(folder)
    rows = recording.stage_rows("relay-1")
    bare = tmp_path / "bare.csv"
    lines = [
        f"{t},{u},{y}" for t, u, y in zip(recording.t_s[rows], recording.u_V[rows], recording.y_rad[rows], strict=True)
    ]
    bare.write_text("t_s,u_V,y_rad\n" + "\n".join(lines) + "\n", encoding="utf-8")
    from_csv = rig("identify", bare, "--method", "sampled-data", "--json")
    assert from_csv.exit_code == 0, from_csv.output
    estimate = json.loads(from_csv.stdout)["estimates"]["sampled-data"]
    for name in ("tau_s", "K_rad_s_V", "fc_V"):
        assert estimate[name] == pytest.approx(outcome["truth"][name], rel=0.03)


@pytest.mark.evidence
@pytest.mark.usefixtures("plain_motor")
def test_the_same_seed_gives_the_same_samples_byte_for_byte(tmp_path: Path) -> None:
    quick = {"relay__gains": [{"h1_V": 0.45, "h2_V": 0.9}], "relay__cycles": 3, "tracking": None}

    def samples() -> bytes:
        config = yaml.safe_load(written(tmp_path, **quick, seed=7).read_text())
        del config["relay"]["target"], config["tracking"]
        path = tmp_path / "quick.yaml"
        path.write_text(yaml.safe_dump(config), encoding="utf-8")
        result = rig("relay", path, "--out", tmp_path, "--json")
        assert json.loads(result.stdout)["loop"]["ticks"] > 500
        return (Path(json.loads(result.stdout)["folder"]) / "samples.csv").read_bytes()

    assert samples() == samples()


@pytest.mark.usefixtures("plain_motor")
@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"emulated__wiring": {"drive": "reversed"}}, "POLARITY"),
        ({"emulated__wiring": {"sensor": "stuck", "fault_after_s": 25.0}}, "SENSOR_STUCK"),
        ({"emulated__motor__start_rad": 1.3}, "START_OUTSIDE"),
        ({"relay__search": {"h_max_V": 0.5}}, "NO_CYCLE"),
        *evidence(
            ({"emulated__wiring": {"drive": "dead"}}, "NO_MOTION"),
            ({"emulated__wiring": {"sensor": "broken_low"}}, "DEVICE_SENSOR"),
            ({"emulated__wiring": {"sensor": "reversed"}}, "POLARITY"),
            ({"emulated__wiring": {"sensor": "stuck"}}, "NO_MOTION"),
            ({"emulated__wiring": {"sensor": "broken_high"}}, "DEVICE_SENSOR"),
            ({"emulated__wiring": {"sensor": "broken_low", "fault_after_s": 25.0}}, "DEVICE_SENSOR"),
            ({"emulated__wiring": {"drive": "dead", "fault_after_s": 25.0}}, "SENSOR_STUCK"),
        ),
    ],
)
def test_each_bad_bench_ends_in_its_fault_with_a_cure_and_a_readable_folder(
    tmp_path: Path, changes: dict[str, object], code: str
) -> None:
    result = rig("run", written(tmp_path, **changes), "--out", tmp_path / "runs", "--json")
    assert result.exit_code == 1, result.output
    outcome = json.loads(result.stdout)
    assert [fault["code"] for fault in outcome["faults"]] == [code]
    assert outcome["faults"][0]["cure"]
    folder = Path(outcome["folder"])
    if outcome["loop"]["ticks"]:
        assert len(read_run(folder)) == outcome["loop"]["ticks"]
    assert code in (folder / "report.html").read_text(encoding="utf-8")
    assert any(json.loads(line)["kind"] == "stop" for line in (folder / "events.jsonl").read_text().splitlines())


def test_a_second_gain_search_that_finds_no_cycle_leaves_the_first_test(tmp_path: Path) -> None:
    search = {"h1_start_V": 0.17, "h2_start_V": 0.74, "timeout_s": 10.0}
    config = written(tmp_path, relay__search=search, relay__second_ratio=0.31)
    outcome = json.loads(rig("relay", config, "--out", tmp_path / "runs", "--json").stdout)
    assert outcome["faults"] == []
    assert [note for note in outcome["notes"] if note.startswith("no second relay test: ")]
    stages = [stage for stage in read_run(Path(outcome["folder"])).stages() if stage not in ("rest", "breakaway")]
    assert stages == ["search", "relay-1"]
    done = json.loads(rig("replay", outcome["folder"], "--json").stdout)
    assert done["ok"] and done["replayed"] == done["rows"]


def test_jog_recovers_a_shaft_from_beyond_the_soft_limit_and_goes_no_farther_out(tmp_path: Path) -> None:
    config = written(tmp_path, emulated__motor__start_rad=1.5)
    inward = rig("jog", config, "--u-V", "-1.0", "--seconds", "0.5", "--out", tmp_path, "--json")
    assert inward.exit_code == 0, inward.output
    recording = read_run(Path(json.loads(inward.stdout)["folder"]))
    assert recording.y_rad[-1] < recording.y_rad[0] - 0.3
    outward = rig("jog", config, "--u-V", "1.0", "--out", tmp_path, "--json")
    recording = read_run(Path(json.loads(outward.stdout)["folder"]))
    assert abs(recording.u_V).max() == 0.0
    too_much = rig("jog", config, "--u-V", "9", "--out", tmp_path)
    assert too_much.exit_code == 2
    assert "drive.max_V" in too_much.stderr


def test_track_alone_uses_the_models_that_an_earlier_run_kept(
    demo_run: tuple[Result, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is identified anew; a number that no motor has is refused before anything drives."""
    _, outcome = demo_run
    monkeypatch.setattr(import_module("rig.identification"), "identify", lambda *_: pytest.fail("identified anew"))
    result = rig("track", ROOT / "config/simulated.yaml", "--model", outcome["folder"], "--out", tmp_path, "--json")
    assert result.exit_code == 0, result.output
    tracked = json.loads(result.stdout)
    assert tracked["tracking"]["sampled-data"]["rms_rad"] < 0.03
    kept = json.loads((Path(outcome["folder"]) / "result.json").read_text(encoding="utf-8"))
    assert tracked["answer"] == kept["answer"] | {"rows": None}
    broken = tmp_path / "broken"
    broken.mkdir()
    kept["answer"]["tau_s"] = -1.0
    (broken / "result.json").write_text(json.dumps(kept), encoding="utf-8")
    refused = rig("track", ROOT / "config/simulated.yaml", "--model", broken, "--out", tmp_path / "none")
    assert refused.exit_code == 2 and "holds a model that no motor has" in refused.output
    assert not (tmp_path / "none").exists()


@pytest.mark.evidence
@pytest.mark.usefixtures("plain_motor")
def test_repeated_runs_differ_and_show_their_scatter(tmp_path: Path) -> None:
    config = yaml.safe_load((ROOT / "config/simulated.yaml").read_text(encoding="utf-8"))
    del config["tracking"]
    config["relay"] = {"gains": [{"h1_V": 0.45, "h2_V": 0.9}], "cycles": 5}
    path = tmp_path / "quick.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    shown = rig("run", path, "--repeat", 2, "--out", tmp_path / "runs")
    assert shown.exit_code == 0, shown.output
    assert "scatter between runs" in shown.stdout
    results = [json.loads(path.read_text(encoding="utf-8")) for path in (tmp_path / "runs").glob("*/result.json")]
    assert len({result["estimates"]["sampled-data"]["tau_s"] for result in results}) == len(results) == 2
