"""Velocity by an observer on the identified model, with prediction over the delay (docs/theory.md 11.3)."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_discrete_are

from rig.control.known_motor import MotorState, known
from rig.model.linear import input_vector, transition
from rig.model.motor import Motor
from rig.model.real_motor import FramedMotor
from rig.signals import Sample


class MotorObserver:
    """Steady-state Kalman filter whose prediction is the exact motor, friction and reversals included.

    motor        the identified model
    period_s     sampling period, s
    noise_rad    standard deviation of the position reading
    disturbance_V  standard deviation of the model's error, as a drive that is constant over a period
    tachometer_noise_rad_s  standard deviation of the tachometer; None without one

    The gain comes from the linear part. Between samples the state follows the motor's own motion under the drive that
    really acted, with each change at its true effect time.
    """

    def __init__(
        self,
        motor: Motor | FramedMotor,
        period_s: float,
        noise_rad: float,
        disturbance_V: float = 0.15,
        tachometer_noise_rad_s: float | None = None,
    ) -> None:
        self.motor = known(motor)
        self.latency_s = 0.0
        self.state: MotorState = self.motor.at_rest(0.0)
        self._last_t_s = math.nan
        self._acting_V = 0.0
        self._asked_V = 0.0
        A = transition(self.motor.tau_s, period_s)[:2, :2]
        B = input_vector(self.motor.tau_s, self.motor.K_rad_s_V, period_s)[:2, np.newaxis]
        if tachometer_noise_rad_s is None:
            C, R = np.array([[0.0, 1.0]]), np.array([[noise_rad**2]])
        else:
            C, R = np.array([[0.0, 1.0], [1.0, 0.0]]), np.diag([noise_rad**2, tachometer_noise_rad_s**2])
        # a little process noise on every state keeps the Riccati equation well posed
        Q = B @ B.T * disturbance_V**2 + np.diag([1e-6, 1e-10])
        P = solve_discrete_are(A.T, C.T, Q, R)
        self._gain: list[list[float]] = (P @ C.T @ np.linalg.inv(C @ P @ C.T + R)).tolist()

    def step(self, sample: Sample) -> MotorState:
        """The state at the instant at which a drive computed now takes effect."""
        if math.isnan(self._last_t_s):
            self.state = self.motor.at_rest(self.motor.position_rad(sample.y_rad))
            self._acting_V = sample.u_V
        else:
            self._advance(sample)
        self._correct(sample)
        self._last_t_s = sample.t_s
        ahead: MotorState = self.motor.advance(self.state, self._acting_V, self.latency_s)
        return ahead

    def drive(self, asked_V: float) -> None:
        """Take the drive that was sent after the last ``step``, V."""
        self._asked_V = asked_V

    def _advance(self, sample: Sample) -> None:
        span = sample.t_s - self._last_t_s
        if math.isnan(sample.t_u_s):
            before, new_V = min(self.latency_s, span), self._asked_V
        else:
            before, new_V = min(max(sample.t_u_s - self._last_t_s, 0.0), span), sample.u_V
            # smoothed: one late exchange must not shake the prediction
            self.latency_s += 0.1 * (before - self.latency_s) if self.latency_s else before
        self.state = self.motor.advance(self.state, self._acting_V, before)
        self.state = self.motor.advance(self.state, new_V, span - before)
        self._acting_V = new_V

    def _correct(self, sample: Sample) -> None:
        v, y = self.state.v, self.state.y
        error = self.motor.position_rad(sample.y_rad) - y
        dv, dy = self._gain[0][0] * error, self._gain[1][0] * error
        if len(self._gain[0]) == 2 and not math.isnan(sample.v_rad_per_s):
            error_v = sample.v_rad_per_s - v
            dv += self._gain[0][1] * error_v
            dy += self._gain[1][1] * error_v
        self.state = self.motor.moved(self.state, v + dv, y + dy)
