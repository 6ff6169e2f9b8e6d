"""Another estimator and another friction law: each is one class and one entry of a list, and nothing else."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evidence import evidence
from synthetic import Bench, dcr, record, simulate

from rig.estimators import ESTIMATORS, EstimatorEntry
from rig.export import export
from rig.identify import Identification, identification, identify, laws
from rig.identify.estimate import Estimate
from rig.identify.estimator import Estimator
from rig.identify.laws.law import Array, CandidateLaw, LawNumber, LawParameter, Plain, Range
from rig.identify.measurements import Measurements
from rig.model.friction import coulomb
from rig.model.motor import Motor
from rig.model.sensitivity import Theta, position
from rig.notebook import Found
from rig.recording.errors import IdentifyError
from rig.recording.reader import read_run
from rig.recording.recording import Recording, from_columns
from rig.recording.series import Window
from rig.report import write_report
from rig.results import RunResult
from rig.terminal import show_friction_law

pytestmark = pytest.mark.long

GOLDEN = Path(__file__).parents[1] / "golden"
BEND = 0.06  # 1/rad


class LargestSpeed(Estimator):
    """K from the largest speed alone: no estimator to be proud of."""

    name = "largest-speed"

    def applies(self, data: Measurements) -> IdentifyError | None:
        return None if data.settled else IdentifyError("there is no cycle", "record one")

    def fit(self, data: Measurements) -> Estimate:
        test = data.tests[0]
        speed = float(np.abs(np.gradient(test.y_rad, test.t_s)).max())
        return Estimate(self.name, 0.2, speed / float(np.abs(test.u_V).max()), 0.0)

    def judge(self, estimate: Estimate, data: Measurements, earlier: Mapping[str, Estimate]) -> Estimate:
        return estimate.judged("doubtful", f"beside {len(earlier)} better ones")

    def notes(self, estimate: Estimate, data: Measurements) -> list[str]:
        return ["largest-speed: quick"]


class BentSensor(CandidateLaw):
    """A sensor that reads y + b y^2."""

    name = "bent sensor"
    title = "a bent sensor"
    parameters = (LawParameter("bend_per_rad", 1e-6),)
    reports = (LawNumber("bend_per_rad", "1/rad", "bend of the sensor"),)

    def position(self, theta: Theta, own: Sequence[float], window: Window) -> Array:
        y_rad = position(theta, *window.steps, window.t_s)
        return y_rad + own[0] * y_rad**2

    def ranges(self, plain: Plain) -> list[Range]:
        return [(-1.0, 1.0)]


LINE = EstimatorEntry("largest-speed", "VM", f"{__name__}:LargestSpeed")


@pytest.fixture
def with_largest_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identification, "ESTIMATORS", [*ESTIMATORS, LINE])


@pytest.mark.usefixtures("with_largest_speed")
def test_an_estimator_in_the_list_is_found_and_in_the_result() -> None:
    found = identify([read_run(GOLDEN / "simulated")], choose_law=False)
    assert list(found.estimates)[-1] == "largest-speed"
    written: dict[str, Any] = found.as_result().as_json()
    mine = written["estimates"]["largest-speed"]
    assert mine["verdict"] == "doubtful"
    assert mine["reasons"] == ["beside 3 better ones"]
    assert "largest-speed: quick" in found.notes
    assert found.best is not None
    assert found.best.method == "sampled-data"


@pytest.mark.usefixtures("with_largest_speed")
def test_it_can_be_asked_for_and_says_where_it_does_not_apply() -> None:
    alone = identify([read_run(GOLDEN / "simulated")], ["largest-speed"], choose_law=False)
    assert list(alone.estimates) == ["largest-speed"]
    with pytest.raises(IdentifyError, match="there is no cycle"):
        identify([read_run(GOLDEN / "simulated-hysteretic")], ["largest-speed"])
    others = identify([read_run(GOLDEN / "simulated-hysteretic")], choose_law=False)
    assert "largest-speed" not in others.estimates
    assert not any("largest-speed" in note for note in others.notes)  # a run without a relay test lacks none


def test_its_line_alone_puts_it_on_the_command_line_into_configs_and_into_the_report(tmp_path: Path) -> None:
    """The line is there before rig is loaded, as it is for those in the file."""
    run = tmp_path / "run"
    shutil.copytree(GOLDEN / "simulated", run)
    commands = [
        ["identify", "--help"], ["identify", str(run), "--method", "largest-speed", "--verbose"], ["schema"],
        ["report", str(run)],
    ]  # fmt: skip
    script = f"""
import json
from click.testing import CliRunner
from rig.estimators import ESTIMATORS, EstimatorEntry
ESTIMATORS.append(EstimatorEntry(*{tuple(LINE)!r}))
from rig.cli import main
from rig.identify import identification
identification._add_motor_law = identification._add_friction_law = lambda *_: None
print(json.dumps([CliRunner().invoke(main, words).output for words in {commands!r}]))
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        check=True,
    )
    helped, identified, schema, _ = json.loads(done.stdout)
    assert "|largest-speed]" in "".join(helped.split())
    assert "\nlargest-speed  0.2000" in identified
    assert '"largest-speed"' in schema
    page = (run / "report.html").read_text()
    assert ".VM {" in page
    assert '<span class="swatch VM"></span>largest speed' in page
    assert "largest speed is doubtful" in page


def test_every_line_of_the_list_names_its_estimator() -> None:
    for entry in ESTIMATORS:
        module, name = entry.place.split(":")
        assert getattr(import_module(module), name).name == entry.name


def bent(bend_per_rad: float, h2_V: float, seed: int) -> Recording:
    """A relay test read through a bent sensor."""
    samples = simulate(Motor(0.17, 6.5, coulomb(0.5)), dcr(0.8, h2_V), 1000, Bench(noise_rad=0.003, seed=seed))
    test = record(samples, True, 200)
    y_rad = test.y_rad + bend_per_rad * test.y_rad**2
    return from_columns(Path(f"{h2_V:g} V"), test.t_s, test.u_V, y_rad, test.t_u_s)


@pytest.fixture(scope="module")
def found_bent(bend_per_rad: float) -> Iterator[Identification]:
    """What is identified of two tests through the bent sensor, with its law in the list."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(laws, "LAWS", [*laws.LAWS, BentSensor()])
        yield identify([bent(bend_per_rad, 1.0, 1), bent(bend_per_rad, 1.3, 2)], ["sampled-data"])


@pytest.mark.parametrize("bend_per_rad", [BEND, *evidence(-BEND)], scope="module")
def test_a_law_in_the_list_is_tried_chosen_and_in_the_result(bend_per_rad: float, found_bent: Identification) -> None:
    found = found_bent.friction_law
    assert found is not None
    assert found.chosen.law == "bent sensor"
    value, error = found.chosen.parameters["bend_per_rad"], found.chosen.errors["bend_per_rad"]
    assert abs(value - bend_per_rad) < 4.0 * error
    written: dict[str, Any] = found.as_result().as_json()
    assert written["rungs"][-1]["law"] == "bent sensor"
    assert found.notes()[0].startswith("friction law: a bent sensor")
    (own,) = written["rungs"][-1]["own"]
    assert (own["name"], own["unit"], own["meaning"]) == ("bend_per_rad", "1/rad", "bend of the sensor")
    assert own["value"] == value
    assert own["ci95"] == pytest.approx([value - 1.96 * error, value + 1.96 * error], rel=1e-4)


@pytest.mark.parametrize("bend_per_rad", [BEND], scope="module")
def test_its_number_is_in_terminal_summary_report_and_export(
    found_bent: Identification, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = found_bent
    show_friction_law(found.as_result().friction_law, of_plain=False)
    assert re.search(r"^bend_per_rad +0\.0[56]\d* ±0\.0\d+ +1/rad +bend of the sensor$", capsys.readouterr().out, re.M)
    assert "bend of the sensor" in Found.of(found).summary()
    run = tmp_path / "run"
    shutil.copytree(GOLDEN / "simulated", run)
    result = RunResult(estimates=found.as_result().estimates, friction_law=found.as_result().friction_law)
    (run / "result.json").write_text(json.dumps(result.as_json()))
    page = write_report(run).read_text()
    assert re.search(
        r'<th>a bent sensor</th>.*bend of the sensor <data value="0\.0[56]\d*">0\.0[56]\d*</data> 1/rad', page
    )
    export(run, tmp_path / "run.json")
    exported = json.loads((tmp_path / "run.json").read_text())["result"]["friction_law"]
    assert exported["rungs"][-1]["own"][0]["name"] == "bend_per_rad"
