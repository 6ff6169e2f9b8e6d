"""A position or velocity loop on an identified motor: feed-forward by its law, feedback of the observed state, and an
integral (docs/theory.md 15.1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from rig.control.known_motor import KnownMotor
from rig.control.law import BareLaw
from rig.control.observer import MotorObserver
from rig.control.set_point import Program
from rig.core.signals import Sample
from rig.model.real_motor import FramedMotor

Loop = Literal["position", "velocity"]


@dataclass(frozen=True)
class Gains:
    """Gains of the wanted acceleration r, rad/s^2.

    Of a position loop r = a_ref + speed (v_ref - v) + place (y_ref - y) + integral * int (y_ref - y) dt; of a velocity
    loop r = a_ref + speed (v_ref - v) + integral * int (v_ref - v) dt, and place is 0.

    speed_1_s        1/s
    place_1_s2       1/s^2
    integral         1/s^3; of a velocity loop 1/s^2
    """

    loop: Loop
    speed_1_s: float
    place_1_s2: float
    integral: float


@dataclass(frozen=True)
class DriveLimits:
    """What bounds a loop.

    largest_V   largest drive, V
    shown_rad   a resting shaft is where it should be if the sensor shows it within so much, rad
    """

    largest_V: float
    shown_rad: float


class StateFeedback(BareLaw):
    """Follow a program with the gains; velocity and position by the observer, where the drive will act.

    The program begins at the position of the first sample. The integral is held while the drive is at its limit, and
    while the reference rests and the sensor shows the shaft within ``shown_rad`` of it: friction would make it hunt. If
    the reference rests and the shaft is farther off, friction is made up for in the direction of the reference.
    """

    def __init__(
        self, motor: FramedMotor, observer: MotorObserver, gains: Gains, program: Program, limits: DriveLimits
    ) -> None:
        self.motor = KnownMotor(motor)
        self.observer = observer
        self.gains = gains
        self.program = program
        self.limits = limits
        self.integral = 0.0
        self._start_s = self._last_s = self._last_error_rad = math.nan
        self._last_u_V = 0.0
        self._at_limit = False

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V; ``yd_rad`` is the reference at the sample's own time."""
        y_rad = self.motor.position_rad(sample.y_rad)
        if math.isnan(self._start_s):
            self._start_s = self._last_s = sample.t_s
            self.program.start_rad = y_rad
            self._last_error_rad = 0.0
        elapsed = sample.t_s - self._start_s
        self.finished = elapsed >= self.program.duration_s
        state = self.observer.step(sample)
        ahead_s = self.observer.delay_s
        if self.motor.lag_s > 0.0:  # a stage that lags acts as if so much later
            ahead_s += self.motor.lag_s
            state = self.motor.advance(state, self._last_u_V, self.motor.lag_s)
        now, then = self.program.at(elapsed), self.program.at(elapsed + ahead_s)
        self.yd_rad = now.y_rad
        error_rad = now.y_rad - y_rad
        rests = now.v_rad_s == 0.0 and then.v_rad_s == 0.0
        self._integrate(error_rad, sample.t_s - self._last_s, rests)
        self._last_s, self._last_error_rad = sample.t_s, error_rad
        k = self.gains
        r = then.a_rad_s2 + k.speed_1_s * (then.v_rad_s - state.v) + k.integral * self.integral
        direction = then.v_rad_s
        if k.loop == "position":
            r += k.place_1_s2 * (then.y_rad - state.y)
            if rests and abs(error_rad) > self.limits.shown_rad:
                direction = error_rad
        asked_V = self.motor.drive_V(state, r, direction)
        u_V = min(max(asked_V, -self.limits.largest_V), self.limits.largest_V)
        self._at_limit = u_V != asked_V
        self._last_u_V = u_V
        self.observer.drive(u_V)
        return u_V

    def _integrate(self, error_rad: float, dt_s: float, rests: bool) -> None:
        """Take the error of this sample into the integral, unless it is held."""
        if self.gains.loop == "velocity":
            # the integral of the speed's error is what the position's error has grown by: no velocity is needed
            self.integral = (
                0.0 if rests else self.integral + (0.0 if self._at_limit else error_rad - self._last_error_rad)
            )
        elif not self._at_limit and not (rests and abs(error_rad) <= self.limits.shown_rad):
            self.integral += dt_s * error_rad
