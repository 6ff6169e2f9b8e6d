"""A load that hangs on a gear, driven through sines: its force and the friction of its gear are found together."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig.identification.departures.choice import Choice
from rig.identification.departures.fit import solve, start
from rig.identification.estimate import Estimate
from rig.identification.hanging_load import TOGETHER, behind_a_gear
from rig.identification.measurements import measurements
from rig.identification.motor_law import Beginning
from rig.model.real_motor import Frame, RealMotor
from rig.run_folder.recording.recording import from_columns
from shared.pieces import Pieces, response

pytestmark = pytest.mark.laws

LOADED = RealMotor(0.15, 3.0, 0.1, force_sin_V=3.0, load_friction=0.35, load_outside=0.3, viscous_share=0.1)


def _begun(motor: RealMotor) -> Beginning:
    t_s = np.arange(0.0, 6.0, 0.008)
    u_V = 3.6 * np.sin(2.0 * math.pi * 0.4 * t_s) + 1.2 * np.sin(2.0 * math.pi * 1.1 * t_s)
    clean = response(motor, Frame(0.0, 1.0), (t_s, u_V), t_s, Pieces.one())
    y_rad = clean + np.random.default_rng(3).normal(0.0, 5e-4, t_s.size)
    recordings = [from_columns(Path("a.csv"), t_s, u_V, y_rad, t_s)]
    data = measurements(recordings, with_cycles=False, plain_is_hysteretic=False)
    plain = Estimate("sampled-data", motor.tau_s, motor.K_rad_s_V, motor.fc_V)
    return Beginning.of(data.tests, plain, [None])


def _plain(begun: Beginning) -> Choice:
    """Where the usual search ended on a servo's record: no law, and a motor with no damping."""
    chooser, whole = replace(begun.chooser, candidates=[]), begun.whole
    problem = chooser.problem(whole.every(begun.cycle_s), (), math.inf)
    return Choice((), solve(start(problem, RealMotor(3.0, 8.0, 0.0))), ())


def test_a_choice_that_predicts_badly_gives_way_to_the_load_and_the_friction_of_its_gear() -> None:
    begun = _begun(LOADED)
    found = behind_a_gear(_plain(begun), begun.chooser, begun.whole, begun.cycle_s)
    assert {law.name for law in found.laws} >= set(TOGETHER)
    motor = found.fit.motor
    assert motor.tau_s == pytest.approx(LOADED.tau_s, rel=0.05)
    assert motor.K_rad_s_V == pytest.approx(LOADED.K_rad_s_V, rel=0.05)
    assert motor.load_friction == pytest.approx(LOADED.load_friction, abs=0.05)


def test_a_choice_that_predicts_stays_as_it_is() -> None:
    begun = _begun(RealMotor(0.15, 3.0, 0.5))
    good = replace(begun.chooser, candidates=[]).choose(begun.whole, begun.motor, begun.cycle_s)
    assert behind_a_gear(good, begun.chooser, begun.whole, begun.cycle_s) is good
