"""rig on physics that nobody of rig wrote: a shaft of MuJoCo's, searched, tested and identified in virtual time."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import mujoco
import pytest
import yaml
from command_line import rig
from intervals import reaches
from mujoco_bench import STEP_S, Shaft

from rig.backends import plug_in
from rig.model.motor import State

pytestmark = [pytest.mark.long, pytest.mark.laws]

SIMULATED = Path(__file__).parents[2] / "config" / "quick.yaml"
HOLD_S, DRIVE_V = 0.25, 1.2


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a package that offers it."""
    entry = EntryPoint("mujoco", "mujoco_bench:MUJOCO", plug_in.GROUP)
    monkeypatch.setattr(plug_in, "entry_points", lambda group: [entry])


def identified(folder: Path, shaft: Shaft) -> tuple[dict[str, Any], str]:
    """result.json of `rig run` on that shaft, without tracking, and what the command said."""
    data = yaml.safe_load(SIMULATED.read_text(encoding="utf-8"))
    del data["emulated"], data["tracking"]
    data["daq"] = {"driver": "mujoco", "watchdog_s": 0.1, "options": {"mass_kg": shaft.mass_kg}}
    config = folder / "mujoco.yaml"
    config.write_text(yaml.safe_dump(data), encoding="utf-8")
    done = rig("run", config, "--out", folder / "runs")
    assert done.exit_code == 0, done.stderr
    (run,) = (folder / "runs").iterdir()
    result: dict[str, Any] = json.loads((run / "result.json").read_text(encoding="utf-8"))
    return result, done.stdout


def test_its_friction_is_as_near_to_coulomb_as_its_constraint_can_be() -> None:
    shaft = Shaft()
    model = shaft.model()
    data, state, worst = mujoco.MjData(model), State(), 0.0
    for k in range(20):
        data.ctrl[0] = -DRIVE_V if k % 2 else DRIVE_V
        mujoco.mj_step(model, data, round(HOLD_S / STEP_S))
        state = shaft.motor.advance(state, float(data.ctrl[0]), HOLD_S)
        worst = max(worst, abs(float(data.qpos[0]) - state.y))
    assert worst < 0.5e-3
    mujoco.mj_resetData(model, data)
    data.ctrl[0] = 0.9 * shaft.motor.friction.fc_V
    mujoco.mj_step(model, data, round(1.0 / STEP_S))
    assert 0.0 < float(data.qpos[0]) < 1e-6  # it creeps, but nobody sees it


@pytest.mark.evidence
def test_a_shaft_without_load_has_the_numbers_of_its_model_and_no_law(tmp_path: Path) -> None:
    shaft = Shaft()
    result, _ = identified(tmp_path, shaft)
    found = result["estimates"]["sampled-data"]
    assert result["answer"]["law"] == []
    assert found["tau_s"] == pytest.approx(shaft.motor.tau_eff_s, rel=0.01)
    assert found["K_rad_s_V"] == pytest.approx(shaft.motor.K_eff_rad_s_V, rel=0.01)
    assert found["fc_V"] == pytest.approx(shaft.motor.friction.fc_V, rel=0.01)


@pytest.mark.evidence
def test_an_unbalanced_load_is_named_with_its_size_and_the_motor_behind_it_is_found(tmp_path: Path) -> None:
    shaft = Shaft(mass_kg=2e-3)
    result, said = identified(tmp_path, shaft)
    (law,) = result["answer"]["law"]
    assert law["name"] == "force_over_position"
    assert law["value"] == pytest.approx(shaft.load_V, rel=0.05)  # 51 mV
    assert reaches(law["ci95"], shaft.load_V)
    assert "force over position" in said
    plain, found = result["estimates"]["sampled-data"], result["answer"]
    assert found["verdict"] == "ok"
    truth = {"tau_s": shaft.real.tau_s, "K_rad_s_V": shaft.real.K_rad_s_V, "fc_V": shaft.real.fc_V}
    for name, value in truth.items():
        assert abs(found[name] - value) < min(found["u95"][name], 0.01 * value)
    assert abs(plain["tau_s"] / shaft.real.tau_s - 1.0) > 0.02  # what the law is good for
