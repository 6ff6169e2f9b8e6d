"""The friction map: within its error bars it is the motor's own formula, and it says where the shaft stuck."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from evidence import evidence

from rig.control.simulation import Sampling, simulate
from rig.control.sweep_plan import SweepPlan
from rig.control.sweeps import CrudeMotor, SweepLoop, Sweeps
from rig.core.signals import Sample
from rig.identification.friction_map import FrictionMap, friction_map
from rig.identification.motor_law import _slow
from rig.identification.output_error import refit
from rig.model.real_motor import Frame, FramedMotor, RealMotor
from rig.model.sensitivity import Theta
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.recording.stage import Stage

PLAIN = RealMotor(0.17, 6.5, 0.48, 0.02)
FRAME = Frame(0.0, 1.1)
PLAN = SweepPlan(-1.0, 1.0, (0.7, 0.4, 0.25, 0.15, 0.1), 7.0)


class _Kept:
    """The sweeps, with the reference at each sample."""

    finished = False

    def __init__(self) -> None:
        self.law = Sweeps(CrudeMotor(0.16, 6.8, 0.56, 0.52), PLAN, SweepLoop(0.01, 0.0012, 3.0, 0.2, 0.0))
        self.yd_rad: list[float] = []

    def step(self, sample: Sample) -> float:
        u_V = self.law.step(sample)
        self.finished = self.law.finished
        self.yd_rad.append(self.law.yd_rad)
        return u_V


def survey_of(motor: RealMotor, seed: int) -> tuple[TimeSeries, list[float]]:
    """A simulated survey, and the reference at each row."""
    law = _Kept()
    sampling = Sampling(delay_s=0.0012, noise_rad=0.003, resolution_rad=0.0041, start_rad=0.2, seed=seed)
    rows = simulate(motor, law, PLAN.duration_s + 30.0, sampling, FRAME)
    assert rows.t_u_s is not None
    return TimeSeries(
        rows.t_s, rows.y_rad, rows.t_u_s, rows.u_V, name="survey", stage=Stage.parse("survey")
    ), law.yd_rad


def surveyed(motor: RealMotor, seed: int, known: RealMotor | None = None) -> FrictionMap:
    """The map of a simulated survey; ``known``: the motor that the map takes; default: the true one."""
    series, yd_rad = survey_of(motor, seed)
    return friction_map(series, np.array(yd_rad), FramedMotor(known or motor, FRAME))


def test_of_a_long_survey_rows_are_left_out_but_not_the_drive_that_its_loop_gave() -> None:
    """A mean drive explained it worse: cogging and friction over position were found where there are none."""
    series, _ = survey_of(PLAIN, 6)
    fewer = _slow(series, PLAIN.tau_s)
    assert len(series) > 2 * len(fewer) > 4000

    def left_rad(test: TimeSeries) -> float:
        return refit([test], Theta(PLAIN.tau_s, PLAIN.K_rad_s_V, PLAIN.fc_V, PLAIN.bias_V)).rms_rad

    assert left_rad(fewer) < 1.03 * left_rad(series)


def deviations(found: FrictionMap) -> tuple[list[float], list[float]]:
    """Map less formula, in standard errors: of the speeds and of the positions."""
    speeds = [(s.drive_V - found.law_over_speed(s.speed_rad_s)) / s.error_V for s in found.speeds if not s.sticks]
    places = []
    for p in found.positions:
        places.append((p.plus_V - found.law_over_position(p.y_rad, 1.0)) / p.plus_error_V)
        places.append((p.minus_V - found.law_over_position(p.y_rad, -1.0)) / p.minus_error_V)
    return speeds, places


@pytest.mark.parametrize(
    "parts",
    [
        {"stribeck_V": 0.06, "stribeck_rad_s": 0.5, "force_sin_V": 0.08, "cogging_sin_V": 0.02, "cogging_per_rad": 6.0},
        *evidence(
            {},
            {"force_sin_V": 0.1, "force_cos_V": 0.05},
            {"friction_sin_V": 0.05},
            {"stribeck_V": 0.06, "stribeck_rad_s": 0.5},
            {"viscous_by_direction_V_s_rad": 0.02, "drag_V_s2_rad2": 0.01},
        ),
    ],
    ids=lambda parts: "+".join(name for name in parts if name.endswith("_V")) or "plain or viscous",
)
def test_the_map_is_the_formula_within_its_error_bars(parts: dict[str, float]) -> None:
    found = surveyed(PLAIN._replace(**parts), seed=3)
    assert len(found.speeds) == 2 * len(PLAN.speeds_rad_s) and len(found.positions) == 24
    speeds, places = deviations(found)
    assert max(map(abs, speeds)) < 3.5 and math.sqrt(float(np.mean(np.square(speeds)))) < 1.7
    assert max(map(abs, places)) < 6.0 and math.sqrt(float(np.mean(np.square(places)))) < 2.0
    # and the bars are small: a few millivolts of half a volt
    assert np.median([s.error_V for s in found.speeds]) < 0.003
    assert np.median([p.error_V for p in found.positions]) < 0.003


@pytest.mark.evidence
def test_half_sum_is_force_and_half_difference_is_friction() -> None:
    motor = PLAIN._replace(force_sin_V=0.1, friction_sin_V=0.06)
    found = surveyed(motor, seed=4)
    for p in found.positions:
        assert p.force_V == pytest.approx(0.1 * math.sin(p.y_rad) - motor.bias_V, abs=0.006)
        assert p.friction_V == pytest.approx(motor.fc_V + 0.06 * math.sin(p.y_rad), abs=0.006)


def test_a_speed_at_which_the_shaft_sticks_and_slips_is_said() -> None:
    found = surveyed(PLAIN._replace(stribeck_V=0.15, stribeck_rad_s=0.06), seed=1)
    slow = [s for s in found.speeds if abs(s.speed_rad_s) < 0.12]
    fast = [s for s in found.speeds if abs(s.speed_rad_s) > 0.3]
    assert all(s.sticks for s in slow) and not any(s.sticks for s in fast)
    assert all(s.share == 0.0 for s in slow)
    (words,) = found.notes()
    assert "at 0.1, 0.15 rad/s the shaft sticks and slips" in words
    assert [s.sticks for s in found.as_result().speeds] == [s.sticks for s in found.speeds]


@pytest.mark.evidence
def test_the_drive_over_speed_does_not_hang_on_the_motor_that_is_assumed() -> None:
    right, wrong = surveyed(PLAIN, 2), surveyed(PLAIN, 2, PLAIN._replace(tau_s=0.2, K_rad_s_V=7.0))
    for a, b in zip(right.speeds, wrong.speeds, strict=True):
        assert a.drive_V == pytest.approx(b.drive_V, abs=0.002)


def test_without_sweeps_both_ways_there_is_no_map() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    one_way = 0.1 * t
    series = TimeSeries(t, one_way, t, np.full_like(t, 0.5), name="survey")
    with pytest.raises(IdentifyError, match="no steady sweeps to and fro"):
        friction_map(series, one_way, FramedMotor(PLAIN, FRAME))
    found = surveyed(PLAIN, 5)
    assert replace(found, positions=()).as_result().positions == ()
