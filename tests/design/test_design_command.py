"""`rig design`: tables, JSON and picture for the motor of a run; what it says where there is none."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import matplotlib.image
import pytest
from command_line import rig
from evidence import evidence

from rig.config import load
from rig.model.real_motor import RealMotor
from rig.output.report import design_map as picture
from rig.output.report.style import FORMATS
from rig.run_folder.results import BreakawayResult, RunResult
from rig.run_folder.results.design import DesignResult
from rig.running.preflight.planned_tests import room_of_tests, task_of_run

pytestmark = pytest.mark.drawn

CONFIG = Path(__file__).parents[2] / "config" / "quick.yaml"


def run_folder(parent: Path, **estimate: Any) -> Path:
    """A run folder with no more than a result."""
    numbers = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_V": 0.48, "asym_V": -0.01, "verdict": "ok"} | estimate
    seen = {"seen_plus_V": 0.64, "seen_minus_V": 0.6, "noise_rad": 0.0032, "static_plus_V": 0.54, "static_minus_V": 0.5}
    folder = parent / "run"
    folder.mkdir()
    result = {"schema": 1, "estimates": {"sampled-data": numbers}, "breakaway": seen}
    (folder / "result.json").write_text(json.dumps(result))
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_folder(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def found(run: Path) -> dict[str, Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rig.design.design_map.SIZE", 8)  # gains of each axis: 20 take seconds
        said = rig("design", CONFIG, "--model", run, "--json")
    assert said.exit_code == 0, said.output
    loaded: dict[str, Any] = json.loads(said.stdout)
    return loaded


def test_json_has_the_map_the_best_tests_and_their_seconds(found: dict[str, Any]) -> None:
    assert found["ok"]
    assert [one["interval_percent"] for one in found["until"]] == [10.0, 3.0, 1.0, 0.5]
    for one in found["until"]:
        assert one["strokes_s"] < one["pair_s"] < 1.1 * one["single_s"]
    seconds = [one["strokes_s"] for one in found["until"]]
    assert seconds == sorted(seconds)
    whole = [value for row in found["map"]["seconds"] for value in row if value is not None]
    assert len(whole) == found["map"]["inside"]
    assert min(whole) == pytest.approx(found["until"][2]["single_s"])
    assert found["motor"]["static_V"] == 0.54
    hard, soft = found["gains"]
    assert hard["h1_V"] + hard["h2_V"] > soft["h1_V"] + soft["h2_V"]
    assert len(found["motion"]["t_s"]) == len(found["motion"]["y_rad"]) == len(found["motion"]["u_V"])


def test_the_motion_stays_in_the_room(found: dict[str, Any]) -> None:
    assert found["room"]["low_rad"] < min(found["motion"]["y_rad"])
    assert max(found["motion"]["y_rad"]) < found["room"]["high_rad"]


@pytest.mark.evidence
def test_words_and_picture(run: Path, tmp_path: Path) -> None:
    said = rig("design", CONFIG, "--model", run / "result.json", "--interval", "2", "--to", tmp_path / "d.png")
    assert said.exit_code == 0, said.output
    assert "all of them wrong by 10 % at most; breaks away at 0.54 V" in said.stdout
    assert "strokes, s  two pairs of gains, s  one pair of gains, s" in said.stdout
    lines = [line.split() for line in said.stdout.splitlines() if line[:1].isdigit()]
    assert [float(line[0]) for line in lines] == [10.0, 3.0, 2.0, 1.0, 0.5]
    height, width = matplotlib.image.imread(tmp_path / "d.png").shape[:2]
    assert width > 1200 < height + 400
    again = rig("design", CONFIG, "--model", run, "--to", tmp_path / "d.png")
    assert again.exit_code == 2
    assert "is there already" in again.stderr


@pytest.mark.evidence
@pytest.mark.parametrize("suffix", [".svg", *evidence(*(one for one in FORMATS if one != ".svg"))])
def test_the_same_design_gives_the_same_picture(found: dict[str, Any], suffix: str, tmp_path: Path) -> None:
    result = DesignResult.model_validate({key: value for key, value in found.items() if key not in ("ok", "model")})
    files = tmp_path / f"one{suffix}", tmp_path / f"two{suffix}"
    for file in files:
        picture.save(result, "a title", file)
    one, two = (file.read_bytes() for file in files)
    assert one == two


@pytest.mark.evidence
def test_without_a_test_it_says_so(run: Path, tmp_path: Path) -> None:
    said = rig("design", CONFIG, "--model", run, "--doubt", "90", "--to", tmp_path / "none.svg")
    assert said.exit_code == 1
    assert "strokes: none stay inside the room" in said.stdout
    assert "no test stays inside the room" in said.stderr
    assert (tmp_path / "none.svg").is_file()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (("--model", "nowhere"), "nowhere"),
        (("--model", CONFIG), "is a config, not a recording"),
        (("--to", "x.gif"), "another kind"),
        (("--doubt", "0"), "--doubt"),
        (("--interval", "0"), "--interval"),
    ],
)
def test_bad_input_is_refused_with_a_reason(given: tuple[str, ...], says: str, run: Path) -> None:
    said = rig("design", CONFIG, "--model", run, *given)
    assert said.exit_code == 2
    assert says in said.stderr


def test_a_run_without_a_model_is_refused(tmp_path: Path) -> None:
    refused = run_folder(tmp_path, verdict="refused")
    said = rig("design", CONFIG, "--model", refused)
    assert said.exit_code == 2
    assert "holds no motor that was not refused" in said.stderr


def test_a_model_without_friction_is_refused(tmp_path: Path) -> None:
    said = rig("design", CONFIG, "--model", run_folder(tmp_path, fc_V=0.0))
    assert said.exit_code == 2
    assert "f_c > 0" in said.stderr


def test_a_motor_that_the_bench_cannot_move_is_refused(tmp_path: Path) -> None:
    run = run_folder(tmp_path, fc_V=7.0)
    for command in ("design", "run"):
        said = rig(command, CONFIG, "--model", run)
        assert said.exit_code == 2
        assert "takes 7.01 V to keep moving, and drive.max_V is 3 V" in said.stderr


def test_the_room_is_a_little_inside_the_limits_and_looks_as_far_ahead_as_the_guard() -> None:
    e = load(CONFIG)
    room = room_of_tests(e, 0.5, noise_rad=0.005)
    assert room.high_rad == pytest.approx(0.95 * 1.1)
    # three periods, a reply's time-out, the watchdog and coasting
    assert room.horizon_s == pytest.approx(0.03 + e.daq.timeout_s + 0.1 + 0.2)
    # four standard deviations of a slope through five samples, each 5 mrad off
    scatter_rad_s = 4.0 * 0.005 * math.sqrt(12.0 / 5.0) / 0.04
    assert room.max_speed_rad_s == pytest.approx(4.9 - scatter_rad_s)
    assert room.stop_rad[1] == pytest.approx(1.95 - scatter_rad_s * room.horizon_s)
    coarse = room_of_tests(e, 0.5)
    assert coarse.max_speed_rad_s == pytest.approx(4.9 - scatter_rad_s * e.sensor.curve.lsb_rad / 0.005)


def test_static_friction_is_the_identified_one_else_the_seen_one_else_a_guess() -> None:
    e, motor = load(CONFIG), RealMotor(0.17, 6.5, 0.48)
    seen = BreakawayResult(seen_plus_V=0.64, seen_minus_V=0.6)
    for result, static_V in ((RunResult(breakaway=seen), 0.64), (None, 0.528), (RunResult(), 0.528)):
        assert task_of_run(e, motor, result, 10.0, 1.0).room.static_V == pytest.approx(static_V)
