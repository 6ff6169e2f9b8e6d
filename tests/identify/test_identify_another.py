"""Another estimator and another law of motors: each is one class and one entry of a list, and nothing else."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaign_real.kinds import KINDS, case
from rig.cli.terminal import show_motor_law
from rig.config.campaign import Campaign
from rig.core.estimators import ESTIMATORS, EstimatorEntry
from rig.identification import Identification, identification, identify
from rig.identification.departures import DEPARTURES
from rig.identification.estimate import Estimate
from rig.identification.estimator import Estimator
from rig.identification.measurements import Measurements
from rig.notebook import Found
from rig.output.export import export
from rig.output.report import write_report
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.reader import read_run
from rig.run_folder.results import RunResult

pytestmark = pytest.mark.long

GOLDEN = Path(__file__).parents[1] / "golden"


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


@pytest.mark.evidence
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
from rig.core.estimators import ESTIMATORS, EstimatorEntry
ESTIMATORS.append(EstimatorEntry(*{tuple(LINE)!r}))
from rig.cli import main
from rig.identification import identification
identification._add_motor_law = lambda *_: None
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


@pytest.fixture(scope="module")
def found_lopsided() -> Iterator[Identification]:
    """What is identified of a motor with another gain each way, with the law in the place of the list's own."""
    one = case(Campaign(name="another", experiments=1, seed=1), 1, [k for k in KINDS if k.name == "gain_by_sign 3"])
    own = list(DEPARTURES)
    DEPARTURES[:] = [
        replace(law, name="lopsided", title="a lopsided amplifier") if law.name == "gain_by_sign" else law
        for law in own
    ]
    yield identify(one.recordings(), ["sampled-data"])
    DEPARTURES[:] = own


@pytest.mark.evidence
def test_a_law_in_the_list_is_tried_chosen_and_wherever_laws_are_shown(
    found_lopsided: Identification, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = found_lopsided
    assert found.motor_law is not None
    assert [one.law.name for one in found.motor_law.found] == ["lopsided"]
    low, high = found.motor_law.found[0].ci95
    assert low < found.motor_law.found[0].size < high
    assert any(note.startswith("law: a lopsided amplifier") for note in found.notes)
    result = found.as_result()
    show_motor_law(result)
    assert re.search(r"^lopsided +-?0\.01\d* ±0\.00\d+", capsys.readouterr().out, re.M)
    assert "lopsided" in Found.of(found).summary()
    run = tmp_path / "run"
    shutil.copytree(GOLDEN / "simulated", run)
    (run / "result.json").write_text(json.dumps(RunResult(answer=result.answer, estimates=result.estimates).as_json()))
    assert "a lopsided amplifier" in write_report(run).read_text()
    export(run, tmp_path / "run.json")
    (law,) = json.loads((tmp_path / "run.json").read_text())["result"]["answer"]["law"]
    assert law["name"] == "lopsided"
