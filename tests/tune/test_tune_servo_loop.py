"""`rig tune --servo`: the largest P whose margins the worst motor keeps, at the largest meaning of a step of P."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import rig
from tuned_run import tuned_run

from rig.backends.servo.models import MODELS
from rig.design.tune.margins import Margins
from rig.design.tune.servo_loop import servo_loop
from rig.design.tune.tuning import LEAST, TuneError
from rig.design.tune.uncertain import UncertainMotor
from rig.model.real_motor import FramedMotor, MovingMotor
from rig.running.run_tuning import position_mode_of

TAU_S, K, FC_V = 0.0444, 2.354, 0.133  # the XL330 of Rhoban/bam, model M1
CONFIG = Path(__file__).resolve().parents[2] / "config"
XL330, STS3215 = position_mode_of(MODELS["xl330-m288"]), position_mode_of(MODELS["sts3215"])
MANUAL = 4096 / (2.0 * math.pi) / 885 / 128


def motor(half: float = 0.0) -> UncertainMotor:
    framed = FramedMotor.of({"tau_s": TAU_S, "K_rad_s_V": K, "fc_V": FC_V})
    # the bench's own delay is of its bus: it is not in the servo's loop
    return UncertainMotor(framed, 0.02, (half * TAU_S, half * K, 0.0, 0.0, half * 0.02), np.eye(5))


def phase_deg(gain_V_rad: float) -> float:
    """Phase margin of gain K / (s (tau s + 1)) behind 2 ms, and half a millisecond of hold, by its own formula."""
    x = gain_V_rad * K * TAU_S
    w = math.sqrt(0.5 * (math.sqrt(1.0 + 4.0 * x * x) - 1.0)) / TAU_S
    return 90.0 - math.degrees(math.atan(w * TAU_S) + 2.5e-3 * w)


def test_the_margins_are_those_of_the_loop_that_the_servo_runs() -> None:
    rows = {row.whose: row for row in servo_loop(motor(), XL330, 5.0, LEAST).rows}
    assert rows["as shipped"].P == 400
    for row in rows.values():
        assert row.margins.phase_deg == pytest.approx(phase_deg(5.0 * MANUAL * row.P), abs=0.05)
    assert rows["rig"].held_rad == pytest.approx(FC_V / (5.0 * 0.5 * MANUAL * rows["rig"].P))


def test_all_that_holds_a_shaft_at_rest_holds_it_off_its_goal() -> None:
    """The angle was that of f_c alone: with this load the motor of rig's own stands at up to twice of it."""
    numbers = {"static_V": 0.04, "dead_band_V": 0.02, "force_sin_V": 0.1, "force_cos_V": 0.05, "load_friction": 0.1}
    framed = FramedMotor.of(motor().framed.numbers | numbers | {"load_outside": 0.5})
    held_rad = servo_loop(replace(motor(), framed=framed), XL330, 5.0, LEAST).rows[0].held_rad
    gain_V_rad = FC_V / servo_loop(motor(), XL330, 5.0, LEAST).rows[0].held_rad
    stands = []  # the farthest place off the goal at which the drive of the loop moves the shaft no more
    for goal_rad in np.linspace(-math.pi, math.pi, 25).tolist():
        for off_rad in np.linspace(-0.3, 0.3, 121).tolist():
            shaft = MovingMotor(framed.motor, framed.frame, goal_rad - off_rad)
            for k in range(5):
                shaft.advance(gain_V_rad * off_rad, 0.01 * k, 0.01)
            stands += [abs(off_rad)] * (abs(shaft.reading_rad - goal_rad + off_rad) < 1e-9)
    assert 0.9 * held_rad < max(stands) < held_rad + 1e-9


def test_p_is_the_largest_that_the_worst_motor_keeps() -> None:
    sure, unsure = (servo_loop(motor(half), XL330, 5.0, LEAST).rows[0] for half in (0.0, 0.1))
    assert phase_deg(5.0 * MANUAL * sure.P) >= 45.0 > phase_deg(5.0 * MANUAL * (sure.P + 1))
    assert unsure.P < 0.95 * sure.P and unsure.margins.keep(LEAST)


def test_a_scale_that_was_measured_takes_the_factor_of_two_away() -> None:
    measured = servo_loop(motor(), position_mode_of(MODELS["xl330-m288"], 0.5 * MANUAL), 5.0, LEAST)
    assert measured.scale.low == measured.scale.high
    assert pytest.approx(2 * servo_loop(motor(), XL330, 5.0, LEAST).rows[0].P, abs=2) == measured.rows[0].P
    assert XL330.scale[:2] == pytest.approx((0.5 * MANUAL, MANUAL))


def test_each_register_of_the_loop_is_named_by_its_address() -> None:
    of_dynamixel = {one.address: one.value for one in servo_loop(motor(), XL330, 5.0, LEAST).settings}
    assert set(of_dynamixel) == {84, 82, 80, 76, 78, 88, 90} and of_dynamixel[76] is None
    feetech = servo_loop(motor(), STS3215, 7.4, LEAST)
    assert {one.address for one in feetech.settings} == {21, 23, 22}
    assert [row.whose for row in feetech.rows] == ["rig", "LeRobot"]  # nobody says what P it is shipped with


def test_margins_that_no_gain_keeps_are_refused() -> None:
    with pytest.raises(TuneError, match=r"no P keeps 89\.9"):
        servo_loop(motor(), STS3215, 7.4, Margins(6.0, 89.9, 0.0))


def test_the_command_prints_and_writes_nothing(tmp_path: Path) -> None:
    run = tuned_run(tmp_path)
    said = json.loads(rig("tune", run, "--servo", "xl330-m288", "--p-scale", 0.003, "--json").stdout)
    assert said["ok"] and said["p_scale_1_rad"] == {"low": 0.003, "high": 0.003, "source": "stated"}
    assert said["gains"][0]["phase_deg"] >= 45.0 and said["supply_V"] == 12.0
    shown = rig("tune", run, "--servo", "xl330-m288")
    assert shown.exit_code == 0 and "84 position_p_gain" in shown.output and "rig writes none" in shown.output
    for more, words in (
        (("--servo", "ax12"), "rig knows no servo"),
        (("--servo", "sts3215", "--loop", "velocity"), "--loop is for rig's own loop"),
        (("--p-scale", "0.1"), "add --servo"),
        (("--servo", "xl330-m288", "--p-scale", "inf"), "must be a number"),
        (("--servo", "xl330-m288", "--p-scale", "nan"), "must be a number"),
    ):
        refused = rig("tune", run, *more)
        assert refused.exit_code == 2 and words in refused.output


def test_a_run_of_another_servo_is_refused(tmp_path: Path) -> None:
    run = tuned_run(tmp_path)
    (run / "config.yaml").write_bytes((CONFIG / "servo.yaml").read_bytes())
    refused = rig("tune", run, "--servo", "sts3215")
    assert refused.exit_code == 2 and "is a run of a xl330-m288, not of a sts3215" in refused.output
