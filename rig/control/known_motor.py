"""A motor as a tracking law knows it, plain or with laws of a real one: how it will move, and which drive it needs.

Laws of a real motor: docs/theory.md 11.4.
"""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

from rig.core.motor_numbers import State as RealState
from rig.model.motor import Motor, State
from rig.model.real_inverse import drive_for
from rig.model.real_motor import PARTS, FramedMotor, moved

# Parts that no drive makes up for: friction of tomorrow; bristles, which bend less than a sensor sees; and a play, in
# which the shaft does not feel the drive.
NOT_COMPENSATED = ("drift", "bristle", "backlash")


class MotorState(Protocol):
    """Velocity, rad/s, and position, rad, of a motor; a motor's own state has more."""

    @property
    def v(self) -> float:
        """Velocity, rad/s."""

    @property
    def y(self) -> float:
        """Position, rad."""


S = TypeVar("S")


class KnownMotor(Protocol[S]):
    """A motor that can be predicted and inverted; ``S`` is its state, a ``MotorState``.

    tau_s, K_rad_s_V  its linear part, as the motion shows it
    lag_s             by which the drive stage follows later, s; ``drive_V`` leaves it out
    """

    tau_s: float
    K_rad_s_V: float
    lag_s: float

    def position_rad(self, reading_rad: float) -> float:
        """Where the shaft is when the sensor shows ``reading_rad``, rad."""

    def at_rest(self, y_rad: float) -> S:
        """State of a shaft that stands at ``y_rad`` without drive."""

    def moved(self, state: S, v_rad_s: float, y_rad: float) -> S:
        """The state with another velocity and position."""

    def advance(self, state: S, u_V: float, dt_s: float) -> S:
        """State after ``dt_s`` (>= 0) seconds of constant drive ``u_V``."""

    def drive_V(self, state: S, acceleration_rad_s2: float, direction: float) -> float:
        """Drive that gives the acceleration, with friction of the direction's sign; of direction 0 without any."""


class PlainKnown:
    """A motor of tau, K and friction by direction."""

    lag_s = 0.0

    def __init__(self, motor: Motor) -> None:
        self.motor = motor
        self.tau_s, self.K_rad_s_V = motor.tau_eff_s, motor.K_eff_rad_s_V

    def position_rad(self, reading_rad: float) -> float:
        """The reading."""
        return reading_rad

    def at_rest(self, y_rad: float) -> State:
        """As ``KnownMotor``."""
        return State(0.0, y_rad)

    def moved(self, state: State, v_rad_s: float, y_rad: float) -> State:
        """As ``KnownMotor``."""
        return State(v_rad_s, y_rad, state.z)

    def advance(self, state: State, u_V: float, dt_s: float) -> State:
        """As ``KnownMotor``."""
        return self.motor.advance(state, u_V, dt_s)

    def drive_V(self, state: State, acceleration_rad_s2: float, direction: float) -> float:
        """As ``KnownMotor``: the level of that direction, whatever the speed."""
        friction = self.motor.friction
        compensation = 0.0
        if direction > 0.0:
            compensation = friction.plus_V
        elif direction < 0.0:
            compensation = -friction.minus_V
        return (self.tau_s * acceleration_rad_s2 + state.v) / self.K_rad_s_V + compensation - self.motor.bias_V


class RealKnown:
    """A motor with the laws of a real one; parts that are ``NOT_COMPENSATED`` are taken out."""

    def __init__(self, framed: FramedMotor) -> None:
        numbers = {name: 0.0 for part in NOT_COMPENSATED for name in PARTS[part]}
        self._framed = FramedMotor(framed.motor._replace(delay_s=0.0, **numbers), framed.frame)
        self.motor, self.frame = self._framed.motor, self._framed.frame
        self.tau_s, self.K_rad_s_V, self.lag_s = self.motor.tau_s, self.motor.K_rad_s_V, self.motor.lag_s

    def position_rad(self, reading_rad: float) -> float:
        """As ``KnownMotor``."""
        return self._framed.position(reading_rad)

    def at_rest(self, y_rad: float) -> RealState:
        """As ``KnownMotor``."""
        return RealState(0.0, y_rad, 0.0, 0.0, y_rad)

    def moved(self, state: RealState, v_rad_s: float, y_rad: float) -> RealState:
        """As ``KnownMotor``."""
        return RealState(v_rad_s, y_rad, state.f, state.w, y_rad)

    def advance(self, state: RealState, u_V: float, dt_s: float) -> RealState:
        """As ``KnownMotor``."""
        return moved(self._framed, state, u_V, dt_s)

    def drive_V(self, state: RealState, acceleration_rad_s2: float, direction: float) -> float:
        """As ``KnownMotor``: through the stage, against all forces; of ``direction`` only the sign counts."""
        return drive_for(self.motor, self.frame, (state.v, state.y), acceleration_rad_s2, direction)


def known(motor: Motor | FramedMotor) -> KnownMotor[Any]:
    """The motor, as a tracking law knows it."""
    return PlainKnown(motor) if isinstance(motor, Motor) else RealKnown(motor)
