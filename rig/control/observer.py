"""Velocity by an observer on the identified model, with prediction over the delay (docs/theory.md 11.3)."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from rig.control.known_motor import KnownMotor
from rig.core.motor_numbers import State
from rig.core.signals import Sample
from rig.model.linear import input_vector, settled, transition
from rig.model.real_motor import FramedMotor

_GAP_PERIODS = 2.5  # a longer time between two samples is a gap
_DISTURBANCE_V = 0.15  # standard deviation of the model's error, as a drive that is constant over a period


class MotorObserver:
    """Steady-state Kalman filter whose prediction is the exact motor, friction and reversals included.

    motor        the identified model
    period_s     sampling period, s
    noise_rad    standard deviation of the position reading
    tachometer_noise_rad_s  standard deviation of the tachometer; None without one

    The gain comes from the linear part. Between samples the state follows the motor's own motion under the drive that
    really acted, with each change at its true effect time. The prediction goes on through the drives that are still on
    their way, over any number of periods.

    latency_s   from a sample to the effect of its drive, as the device reports it, s; smoothed
    further_s   from there to the motion of the reading, s: the device does not report it
    """

    def __init__(
        self,
        motor: FramedMotor,
        period_s: float,
        noise_rad: float,
        tachometer_noise_rad_s: float | None = None,
    ) -> None:
        self.motor = KnownMotor(motor)
        self.latency_s = 0.0
        self.further_s = 0.0
        self.state = self.motor.at_rest(0.0)
        self._period_s = period_s
        self._last_t_s = math.nan
        self._acting_V = 0.0
        self._known_s = -math.inf  # effect of the last drive that the device has reported
        self._reported: deque[tuple[float, float]] = deque()  # effects on the reading, s and V, still to come
        self._asked: deque[tuple[float, float]] = deque()  # samples and their drives that are not reported yet, s and V
        A = transition(self.motor.tau_s, period_s)[:2, :2]
        B = input_vector(self.motor.tau_s, self.motor.K_rad_s_V, period_s)[:2, np.newaxis]
        if tachometer_noise_rad_s is None:
            C, R = np.array([[0.0, 1.0]]), np.array([[noise_rad**2]])
        else:
            C, R = np.array([[0.0, 1.0], [1.0, 0.0]]), np.diag([noise_rad**2, tachometer_noise_rad_s**2])
        # a little process noise on every state keeps the Riccati equation well posed
        Q = B @ B.T * _DISTURBANCE_V**2 + np.diag([1e-6, 1e-10])
        P = settled(A, C.T @ np.linalg.inv(R) @ C, Q)
        self._gain: list[list[float]] = (P @ C.T @ np.linalg.inv(C @ P @ C.T + R)).tolist()

    def step(self, sample: Sample) -> State:
        """The state at the instant at which a drive computed now takes effect."""
        if math.isnan(self._last_t_s):
            self.state = self.motor.at_rest(self.motor.position_rad(sample.y_rad))
            self._acting_V = sample.u_V
        else:
            self._advance(sample)
        self._correct(sample)
        self._last_t_s = sample.t_s
        return self._predicted(sample.t_s)

    @property
    def gain(self) -> list[list[float]]:
        """Of velocity, then of position, by each error: of the position, then of the tachometer if there is one."""
        return self._gain

    @property
    def delay_s(self) -> float:
        """From a sample to the motion that its drive makes, s."""
        return self.latency_s + self.further_s

    def drive(self, asked_V: float) -> None:
        """Take the drive that was sent after the last ``step``, V."""
        self._asked.append((self._last_t_s, asked_V))

    def _advance(self, sample: Sample) -> None:
        """Move the state to the sample's time, under the drives that have come to the motor since the last one."""
        since_s = self._last_t_s
        self._take_report(sample)
        while self._reported and self._reported[0][0] <= sample.t_s:
            effect_s, new_V = self._reported.popleft()
            if effect_s > since_s:
                self.state = self.motor.advance(self.state, self._acting_V, effect_s - since_s)
                since_s = effect_s
            self._acting_V = new_V
        self.state = self.motor.advance(self.state, self._acting_V, sample.t_s - since_s)

    def _take_report(self, sample: Sample) -> None:
        """Take what the device reports, with its time of effect; keep what still waits in the device."""
        span = sample.t_s - self._last_t_s
        if math.isnan(sample.t_u_s):
            # no report: each drive acts when it should
            while self._asked and self._asked[0][0] + self.latency_s <= sample.t_s:
                asked_s, new_V = self._asked.popleft()
                self._reported.append((asked_s + self.delay_s, new_V))
            return
        latency_s = min(max(sample.t_u_s - self._last_t_s, 0.0), span)
        waiting = max(round((self.latency_s - latency_s) / self._period_s), 0)
        latency_s += waiting * self._period_s
        # smoothed: one late exchange must not shake the prediction; across a gap it says nothing of the next drives
        if span <= _GAP_PERIODS * self._period_s or not self.latency_s:
            self.latency_s += 0.1 * (latency_s - self.latency_s) if self.latency_s else latency_s
        come = [self._asked.popleft() for _ in range(len(self._asked) - waiting)]
        if waiting:
            # a report is of the last drive that acted: those before it have acted, too
            self._reported.extend((asked_s + self.delay_s, volts) for asked_s, volts in come[:-1])
        # a time after the sample is wrong: kept, it would hold back all drives until then
        effect_s = min(sample.t_u_s, sample.t_s)
        if effect_s > self._known_s:
            self._known_s = effect_s
            self._reported.append((effect_s + self.further_s, sample.u_V))

    def _predicted(self, t_s: float) -> State:
        """The state when a drive decided at ``t_s`` comes to the motor."""
        state, volts, end_s = self.state, self._acting_V, t_s + self.delay_s
        for effect_s, next_V in (*self._reported, *((asked_s + self.delay_s, V) for asked_s, V in self._asked)):
            if t_s < effect_s < end_s:
                state, t_s = self.motor.advance(state, volts, effect_s - t_s), effect_s
            volts = next_V
        return self.motor.advance(state, volts, end_s - t_s)

    def _correct(self, sample: Sample) -> None:
        v, y = self.state.v, self.state.y
        error = self.motor.position_rad(sample.y_rad) - y
        dv, dy = self._gain[0][0] * error, self._gain[1][0] * error
        if len(self._gain[0]) == 2 and not math.isnan(sample.v_rad_per_s):
            error_v = sample.v_rad_per_s - v
            dv += self._gain[0][1] * error_v
            dy += self._gain[1][1] * error_v
        self.state = self.motor.moved(self.state, v + dv, y + dy)
