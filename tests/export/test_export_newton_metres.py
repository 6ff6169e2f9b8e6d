"""`rig export` of a motor whose volt is known in N m: to MuJoCo, and to BAM."""

from __future__ import annotations

import json
from pathlib import Path

import bam_peer
import mujoco
import numpy as np
import pytest
from command_line import rig
from run_with_laws import LAWS, PERIOD_S, PLAIN, drive, motor_of, own_motion, run_with
from test_export_models import module

from rig.output.export import export_model

A, R_OHM = 0.05, 2.0  # N m/V, ohm
TAU_S, K, FC_V = (PLAIN[name] for name in ("tau_s", "K_rad_s_V", "fc_V"))


def servo_run(folder: Path, *laws: str, bench: str = "emulated (id 1, xl330-m288, firmware 52)") -> Path:
    """A run of a servo whose friction is as large both ways: BAM has no bias."""
    run = run_with(folder, *laws)
    result, meta = run / "result.json", run / "meta.json"
    result.write_text(result.read_text(encoding="utf-8").replace('"asym_V": -0.01', '"asym_V": 0.0'), encoding="utf-8")
    seen = json.loads(meta.read_text(encoding="utf-8"))
    meta.write_text(json.dumps(seen | {"backend": bench}), encoding="utf-8")
    return run


def test_mujoco_has_the_motor_in_newton_metres_and_no_more_than_the_supply_gives(tmp_path: Path) -> None:
    export_model(run_with(tmp_path), "mujoco", tmp_path, torque_N_m_V=A)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "motor.xml"))
    data = mujoco.MjData(model)
    assert model.dof_armature[0] == pytest.approx(A * TAU_S / K, rel=1e-5)
    assert model.dof_frictionloss[0] == pytest.approx(A * FC_V)
    assert float(np.ravel(model.dof_damping)[0]) == pytest.approx(A / K)  # b + kt^2/R
    for u_V, torque_N_m in ((2.0, A * (2.0 - 0.01)), (100.0, A * (12.0 + 0.01)), (-100.0, -A * (12.0 + 0.01))):
        data.ctrl[0] = u_V
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[0] == pytest.approx(torque_N_m)


@pytest.mark.parametrize("laws", [("force_over_position", "drag", "stribeck", "viscous_by_direction")], ids="-".join)
def test_mujoco_moves_in_newton_metres_as_it_does_in_volts(tmp_path: Path, laws: tuple[str, ...]) -> None:
    run = run_with(tmp_path, *laws)
    export_model(run, "mujoco", tmp_path, torque_N_m_V=A)
    shaft = module(tmp_path / "motor_mujoco.py")
    model, data = shaft.load()
    theirs = []
    for volts in drive(200).tolist():
        theirs.append(shaft.reading(float(data.qpos[0])))
        shaft.step(model, data, volts, PERIOD_S)
    readings, _ = own_motion(motor_of(run), drive(200))
    assert np.abs(np.array(theirs) - readings).max() < 2e-3


@pytest.mark.parametrize("laws", [(), ("stribeck",), ("load_friction",)], ids=["m1", "m2", "m5"])
def test_bam_loads_the_motor_and_predicts_as_rig_does(tmp_path: Path, laws: tuple[str, ...]) -> None:
    run = servo_run(tmp_path, *laws)
    export_model(run, "bam", tmp_path, torque_N_m_V=A, R_ohm=R_OHM)
    p = bam_peer.load(tmp_path / "motor_bam.json")
    assert p["kt"] / p["R"] == pytest.approx(A) and p["q_offset"] == 0.0
    assert p["friction_viscous"] + p["kt"] ** 2 / p["R"] == pytest.approx(A / K)
    assert p["armature"] == pytest.approx(A * TAU_S / K) and p["friction_base"] == pytest.approx(A * FC_V)
    if laws == ("load_friction",):  # the record shows how much of 1/K is back-EMF: the stated winding does not count
        r = LAWS["load_friction"]["viscous_share"]
        assert p["kt"] == pytest.approx((1.0 - r) / K) and p["load_friction_motor"] == 0.2
        assert p["load_friction_external"] == pytest.approx(0.1)
    if laws == ("stribeck",):
        assert (p["friction_stribeck"], p["dtheta_stribeck"]) == pytest.approx(
            (A * 0.15, LAWS["stribeck"]["stribeck_rad_s"])
        )
    u_V = drive(200)
    readings, _ = own_motion(motor_of(run), u_V)
    assert np.abs(np.array(bam_peer.positions(p, u_V.tolist(), PERIOD_S)) - readings).max() < 1e-3


def test_bam_has_the_place_where_a_load_hangs_and_names_what_it_lacks(tmp_path: Path) -> None:
    run = servo_run(tmp_path, "force_over_position", bench="emulated (id 1, sts3215, firmware 3)")
    written = export_model(run, "bam", tmp_path, torque_N_m_V=A, R_ohm=R_OHM)
    data = json.loads((tmp_path / "motor_bam.json").read_text(encoding="utf-8"))
    motor = motor_of(run)
    hangs_rad = -data["q_offset"]
    pull = motor.motor.force_sin_V, motor.motor.force_cos_V
    at = hangs_rad - motor.frame.centre_rad
    assert pull[0] * np.sin(at) + pull[1] * np.cos(at) == pytest.approx(0.0, abs=1e-12)
    assert data["actuator"] == "sts3215" and "force_over_position" in written.motor.lacks
    assert data["rig"]["run"] == run.name


@pytest.mark.parametrize(
    ("tool", "options", "words"),
    [
        ("bam", (), "BAM's models are in N m and ohm"),
        ("bam", ("--N-m-per-V", A, "--R-ohm", 4.0), "at most 3.08 ohm"),
        ("c", ("--N-m-per-V", A), "C gets a motor in volts"),
        ("a.csv", ("--R-ohm", R_OHM), "are for a tool, and 'a.csv' is none"),
    ],
)
def test_what_has_no_newton_metres_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tool: str, options: tuple[object, ...], words: str
) -> None:
    run = servo_run(tmp_path)
    monkeypatch.chdir(tmp_path)
    said = rig("export", run, "--to", tool, *options)
    assert said.exit_code == 2 and words in said.stderr
    assert [path.name for path in tmp_path.iterdir()] == [run.name]


def test_bam_takes_no_bench_that_it_has_no_control_law_of(tmp_path: Path) -> None:
    run = run_with(tmp_path)
    said = rig("export", run, "--to", "bam", "--N-m-per-V", A, "--R-ohm", R_OHM, "--into", tmp_path)
    assert said.exit_code == 2 and "BAM has no control law for this bench" in said.stderr
