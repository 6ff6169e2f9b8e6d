"""Tracking by feedback linearisation on an identified model (docs/theory.md 11.1 and 11.3)."""

from __future__ import annotations

import math
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from rig.control.known_motor import KnownMotor
from rig.control.law import BareLaw
from rig.control.observer import MotorObserver
from rig.control.trajectory import Reference
from rig.core.motor_numbers import State
from rig.core.signals import Sample
from rig.model.error_decay import ErrorDecay
from rig.model.real_motor import FramedMotor


class Trajectory(Protocol):
    """A reference with two derivatives that begins at a position."""

    start_rad: float

    def at(self, t_s: float) -> Reference:
        """Reference ``t_s`` seconds after the start."""


def linearising_drive(
    motor: KnownMotor, state: State, reference: Reference, gains: tuple[float, float], direction: float
) -> float:
    """Drive of (33), (34), V: u = (tau/K) r + v/K + f_c sgn(.) - a, r = yd'' + k1 (yd' - v) + k2 (yd - y).

    gains      k1, 1/s, and k2, 1/s^2
    direction  velocity, rad/s, whose sign the friction compensation takes, and the friction level of that direction; at
               exactly 0 there is no compensation
    The constant a is the asymmetry. A motor with laws gets the drive that its laws ask for (docs/theory.md 11.4).
    """
    k1_1_s, k2_1_s2 = gains
    r = reference.a_rad_s2 + k1_1_s * (reference.v_rad_s - state.v) + k2_1_s2 * (reference.y_rad - state.y)
    return motor.drive_V(state, r, direction)


class Tracking(BareLaw):
    """Follow a trajectory for ``duration_s`` with the model's linearising drive, velocity by its observer.

    offset_rad     the trajectory begins so far from the position of the first sample; the error then dies away by (35)
    friction_sign  which velocity's sign the friction compensation takes. "reference": the reference velocity's;
                   "estimate": the observed velocity's, as in the paper, or the reference's if that is exactly zero.
                   At 10 ms "estimate" chatters around reversals (docs/theory.md 11.2)
    """

    def __init__(
        self,
        motor: FramedMotor,
        observer: MotorObserver,
        trajectory: Trajectory,
        k1_1_s: float,
        k2_1_s2: float,
        duration_s: float,
        friction_sign: Literal["reference", "estimate"] = "reference",
        offset_rad: float = 0.0,
    ) -> None:
        self.motor = KnownMotor(motor)
        self.observer = observer
        self.trajectory = trajectory
        self.k1_1_s = k1_1_s
        self.k2_1_s2 = k2_1_s2
        self.duration_s = duration_s
        self.friction_sign = friction_sign
        self.decay = ErrorDecay(offset_rad, k1_1_s, k2_1_s2)
        self.largest_u_V = 0.0
        self._start_s = math.nan
        self._last_u_V = 0.0
        self.taken: list[tuple[float, float, float]] = []  # of each sample: time, s; reading and reference, rad

    def step(self, sample: Sample) -> float:
        """Drive for this sample, V; ``yd_rad`` is the reference at the sample's own time."""
        if math.isnan(self._start_s):
            self._start_s = sample.t_s
            self.trajectory.start_rad = self.motor.position_rad(sample.y_rad) + self.decay.offset_rad
        elapsed = sample.t_s - self._start_s
        self.finished = elapsed >= self.duration_s
        self.yd_rad = self.trajectory.at(elapsed).y_rad
        self.taken.append((sample.t_s, sample.y_rad, self.yd_rad))
        state = self.observer.step(sample)
        # the drive acts after the delay: take the reference at that time, too
        ahead_s = self.observer.delay_s
        if self.motor.lag_s > 0.0:  # a stage that lags acts as if so much later
            ahead_s += self.motor.lag_s
            state = self.motor.advance(state, self._last_u_V, self.motor.lag_s)
        reference = self.trajectory.at(elapsed + ahead_s)
        # at rest the estimate has no sign: without compensation the shaft would stay there
        use_reference = self.friction_sign == "reference" or state.v == 0.0
        # while the offset dies away the shaft should move as the reference less the error of (35)
        velocity = reference.v_rad_s - self.decay.at(elapsed + ahead_s)[1] if use_reference else state.v
        u_V = self._last_u_V = linearising_drive(self.motor, state, reference, (self.k1_1_s, self.k2_1_s2), velocity)
        self.largest_u_V = max(self.largest_u_V, abs(u_V))
        self.observer.drive(u_V)
        return u_V


def tracking_error(
    t_s: NDArray[np.float64], y_rad: NDArray[np.float64], yd_rad: NDArray[np.float64], after_s: float
) -> tuple[float, float]:
    """RMS and largest |yd - y|, rad, over the samples later than ``after_s`` from the first one.

    All arrays have the same length. Raises ValueError if no sample is left.
    """
    error = (yd_rad - y_rad)[t_s - t_s[0] > after_s]
    if error.size == 0:
        raise ValueError(f"no sample later than {after_s} s")
    return float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error)))
