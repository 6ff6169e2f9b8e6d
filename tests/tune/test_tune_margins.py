"""The linear loop is the law that drives, and its margins are python-control's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from control.frdata import FrequencyResponseData
from control.margins import stability_margins
from control.statesp import StateSpace
from evidence import one_of_each

from rig.control.observer import MotorObserver
from rig.control.set_point import PositionStep
from rig.control.state_feedback import DriveLimits, Loop, StateFeedback
from rig.control.trajectory import Reference
from rig.core.signals import Sample
from rig.design.tune.margins import Matrices, controller_matrices, margins, motor_matrices, noise_V
from rig.design.tune.trial import Sensing, driven, shaft_of
from rig.design.tune.tuning import gains_for
from rig.design.tune.uncertain import LinearMotor
from rig.model.real_motor import Frame, FramedMotor, RealMotor

PERIOD_S = 0.01
# tau, K, lag and delay: less than a period, a part beyond one, whole periods, a stage that lags
MOTORS = [
    LinearMotor(0.17, 6.5, 0.0, 0.0012),
    LinearMotor(0.05, 10.0, 0.0, 0.013),
    LinearMotor(0.3, 4.0, 0.0, 0.03),
    LinearMotor(0.17, 6.5, 0.006, 0.005),
]
LOOPS: tuple[Loop, ...] = ("position", "velocity")


class Zero(PositionStep):
    """A reference that stays at 0 and never counts as resting: the integral of the speed's error is not reset."""

    def at(self, t_s: float) -> Reference:
        return Reference(0.0, 5e-324, 0.0)


def known(motor: LinearMotor) -> FramedMotor:
    """The motor without friction."""
    return FramedMotor(RealMotor(motor.tau_s, motor.K_rad_s_V, 0.0, lag_s=motor.lag_s), Frame())


def observer_of(motor: LinearMotor) -> MotorObserver:
    observer = MotorObserver(known(motor), PERIOD_S, 0.003)
    observer.latency_s = motor.delay_s
    return observer


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("motor", MOTORS, ids=str)
def test_the_matrices_are_the_law_without_friction(motor: LinearMotor, loop: Loop) -> None:
    gains = gains_for(loop, 8.0, motor.tau_s)
    law = StateFeedback(known(motor), observer_of(motor), gains, Zero(0.0, 1.0, math.inf), DriveLimits(math.inf, 0.0))
    matrices = controller_matrices(motor, observer_of(motor), gains, PERIOD_S)
    x = np.zeros(len(matrices.B))
    readings = 0.01 * np.random.default_rng(1).standard_normal(60)
    readings[0] = 0.0  # the law begins where it is
    for k, y_rad in enumerate(readings.tolist()):
        u_V = law.step(Sample(k * PERIOD_S, y_rad, 0))
        x, expected_V = matrices.A @ x + matrices.B * y_rad, float(matrices.C @ x) + matrices.D * y_rad
        assert u_V == pytest.approx(expected_V, rel=1e-4, abs=1e-6), k  # a lag is integrated in steps


@pytest.mark.parametrize(("motor", "loop"), one_of_each(*zip(MOTORS, 2 * LOOPS, strict=True)), ids=str)
def test_margins_are_those_of_python_control(motor: LinearMotor, loop: Loop) -> None:
    controller = controller_matrices(motor, observer_of(motor), gains_for(loop, 6.0, motor.tau_s), PERIOD_S)
    off = motor_matrices(LinearMotor(1.1 * motor.tau_s, motor.K_rad_s_V, motor.lag_s, motor.delay_s), PERIOD_S)
    found = margins(controller, off, PERIOD_S)
    L = -_state_space(controller) * _state_space(off)
    response = FrequencyResponseData(L, np.geomspace(1e-2, math.pi / PERIOD_S, 3000)[:-1], smooth=True)
    gains, phases, distance, *_ = stability_margins(response, returnall=True)
    dB = [abs(20.0 * math.log10(one)) for one in gains if one > 0.0]
    assert found.gain_dB == pytest.approx(min(dB), abs=0.05)
    assert found.phase_deg == pytest.approx(min(abs(one) for one in phases), abs=0.2)
    assert found.modulus == pytest.approx(min(distance), abs=0.01)


def test_a_gain_beyond_its_margin_is_unstable() -> None:
    motor = MOTORS[0]
    controller = controller_matrices(motor, observer_of(motor), gains_for("position", 8.0, motor.tau_s), PERIOD_S)
    plant = motor_matrices(motor, PERIOD_S)
    found = margins(controller, plant, PERIOD_S)
    for by_dB, stable in ((found.gain_dB - 0.1, True), (found.gain_dB + 0.1, False)):
        louder = plant._replace(C=plant.C * 10.0 ** (by_dB / 20.0))
        assert (margins(controller, louder, PERIOD_S).gain_dB > 0.0) is stable


def test_the_noise_of_the_drive_is_what_a_simulation_shows() -> None:
    motor = MOTORS[0]
    gains = gains_for("position", 8.0, motor.tau_s)
    controller = controller_matrices(motor, observer_of(motor), gains, PERIOD_S)
    law = StateFeedback(known(motor), observer_of(motor), gains, Zero(0.0, 1.0, math.inf), DriveLimits(math.inf, 0.0))
    record = driven(shaft_of(known(motor)), law, Sensing(PERIOD_S, 0.003, 0.0, math.inf), motor.delay_s, 60.0, 1)
    expected_V = noise_V(controller, motor_matrices(motor, PERIOD_S), 0.003)
    assert np.std(record.u_V[200:]) == pytest.approx(expected_V, rel=0.05)


def _state_space(system: Matrices) -> StateSpace:
    return StateSpace(system.A, system.B[:, np.newaxis], system.C[np.newaxis, :], [[system.D]], PERIOD_S)
