"""The servos of `make bam`: a simulation apart from rig's motor, and what rig identifies of its records."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import rig

from bam.__main__ import recordings, tried
from bam.records import Case, Record, Truth, records_of
from bam.servo import Friction, Load, Servo
from rig.identification import identify
from rig.model.real_motor import Frame, RealMotor
from rig.run_folder.recording.series import Steps
from shared.pieces import Pieces, response

# Rhoban/bam, bam/params: the XL330 with models M1 and M4
M1 = {
    "kt": 0.3866957639281311, "R": 4.017129222290597, "armature": 0.0018141672784458866,
    "friction_base": 0.01283272036582759, "friction_viscous": 0.003661672282824312, "model": "m1",
}  # fmt: skip
M4 = {
    "kt": 0.3861709980035537, "R": 3.402572641173151, "armature": 0.0018954552619850965,
    "friction_base": 0.008758627618365112, "load_friction_base": 0.06803357334088644,
    "load_friction_stribeck": 0.07381180834784251, "dtheta_stribeck": 2.5577016869227474, "alpha": 0.7601158768377835,
    "friction_viscous": 0.004621034970462603, "model": "m4",
}  # fmt: skip
GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "simulated"
LOADED = Load(0.1, 0.1)
SUPPLY_V, SOURCE_OHM = 5.0, 0.15


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """As data/bam."""
    for published in (M1, M4):
        (tmp_path / f"xl330-{published['model']}.json").write_text(json.dumps(published), encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(("published", "load"), [(M1, Load()), (M4, LOADED)], ids=["M1 free", "M4 loaded"])
@pytest.mark.parametrize("slope_V_s", [math.inf, 277.0], ids=["at once", "ramped"])
def test_the_one_motor_moves_as_the_servo_does(
    published: dict[str, float], load: Load, slope_V_s: float, tmp_path: Path
) -> None:
    """Load friction, a supply with a resistance, gravity, and a duty that is ramped; both written down apart."""
    (tmp_path / "one.json").write_text(json.dumps(published | {"load_friction_stribeck": 0.0}), encoding="utf-8")
    friction = Friction.read(tmp_path / "one.json")
    truth, a = Truth(friction, load), friction.kt / friction.R
    motor = RealMotor(
        truth.tau_s,
        truth.K_rad_s_V,
        truth.fc_V,
        force_sin_V=truth.weight_V,
        load_friction=friction.load_friction_motor,
        load_outside=1.0,
        viscous_share=friction.friction_viscous / a * truth.K_rad_s_V,
        source_per_V2=SOURCE_OHM / friction.R / SUPPLY_V**2,
    )
    t_s = np.asarray(0.01 * np.arange(200), dtype=np.float64)
    u_V = np.asarray(np.repeat(np.random.default_rng(1).uniform(-3.0, 3.0, 20), 10), dtype=np.float64)
    u_V[0] = 0.0
    servo, there = Servo(friction, load, SUPPLY_V, slope_V_s, SOURCE_OHM), []
    for drive_V in u_V.tolist():
        there.append(servo.y)
        servo.advance(drive_V / SUPPLY_V, 0.0, 0.01)
    drive = Steps(t_s, u_V)
    drive = drive if math.isinf(slope_V_s) else drive.ramped(slope_V_s)
    y_rad = response(motor, Frame(0.0, 1.0, 0.0, 2.0), drive, t_s, Pieces.one(0.0, 0.0))
    assert np.ptp(y_rad) > 0.5
    assert y_rad == pytest.approx(there, abs=2e-6 if math.isinf(slope_V_s) else 3e-5)


def test_the_true_friction_is_that_at_the_speeds_that_a_record_holds(folder: Path) -> None:
    """A sharp Stribeck effect at 2 rad/s, half of the friction beyond: a third of the time is slower."""
    plain = Friction.read(folder / "xl330-m1.json")
    falls = replace(plain, friction_stribeck=0.5 * plain.friction_base, dtheta_stribeck=2.0, alpha=60.0)
    truth, flat = Truth(falls, Load()), Truth(plain, Load())
    t_s = np.asarray(0.01 * np.arange(41), dtype=np.float64)
    y_rad = np.cumsum(np.repeat([0.0, 1.0, -3.0, 3.0], [11, 10, 10, 10]) * 0.01)
    record = Record(t_s, t_s, y_rad, y_rad, np.zeros(41), 1.0)
    assert truth.driven_fc_V([record]) == pytest.approx(truth.fc_V * (1.0 + 0.5 / 3.0))
    assert flat.driven_fc_V([record]) == flat.fc_V == truth.fc_V


@pytest.mark.evidence
def test_a_supply_with_a_resistance_is_found_in_strokes(folder: Path) -> None:
    row, _ = tried(Case("XL330", "m1", Load(), "strokes"), folder, 1)
    assert [law.split()[0] for law in row.laws] == ["source"]
    assert row.verdict == "ok"
    assert all(abs(error) < 0.005 for error in row.errors)
    assert row.held_out < 0.003


@pytest.mark.evidence
def test_friction_that_grows_with_the_torque_is_found_and_predicts(folder: Path) -> None:
    row, found = tried(Case("XL330", "m4", Load(), "strokes"), folder, 1)
    assert row.laws[0].startswith("load_friction")
    assert row.held_out < 0.01
    plain = identify(recordings(row.case, records_of(row.case, folder, 1)[0]), choose_law=False)
    assert found.best is not None
    assert plain.best is not None
    assert found.best.rms_rad < 0.3 * plain.best.rms_rad


def test_a_ramp_that_is_told_is_no_friction(folder: Path) -> None:
    """As shipped an XL330 takes 18 ms from 0 to 5 V: near a tick and a half of late drive."""
    case = Case("XL330", "m1", Load(), "strokes", ramped=True)
    told = recordings(case, records_of(case, folder, 1)[0])
    at_once = [replace(one, slew_V_s=None) for one in told]
    truth = Truth(Friction.read(folder / "xl330-m1.json"), Load())
    with_ramp, without = (identify(given, choose_law=False).leading for given in (told, at_once))
    assert with_ramp is not None
    assert without is not None
    assert with_ramp.fc_V == pytest.approx(truth.fc_V, rel=0.04)
    assert with_ramp.tau_s == pytest.approx(truth.tau_s, rel=0.02)
    assert without.rms_rad > 3.0 * with_ramp.rms_rad


def test_a_run_has_its_ramp_already() -> None:
    said = rig("identify", GOLDEN, "--slew", "277")
    assert said.exit_code == 2
    assert said.stderr.splitlines()[0].endswith("has the ramp already: a run says when its drives acted")
