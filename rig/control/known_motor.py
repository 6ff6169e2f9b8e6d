"""A motor as a law knows it: how it will move, and which drive it needs (docs/theory.md 11.4)."""

from __future__ import annotations

from rig.core.motor_numbers import State
from rig.model.real_inverse import drive_for
from rig.model.real_motor import PARTS, FramedMotor, moved

# Parts that no drive makes up for: friction of tomorrow; bristles, which bend less than a sensor sees; and a play, in
# which the shaft does not feel the drive.
NOT_COMPENSATED = ("drift", "bristle", "backlash")


class KnownMotor:
    """A motor that can be predicted and inverted; its parts that are ``NOT_COMPENSATED`` are taken out.

    tau_s, K_rad_s_V  its linear part, as the motion shows it
    lag_s             by which the drive stage follows later, s; ``drive_V`` leaves it out
    """

    def __init__(self, framed: FramedMotor) -> None:
        numbers = {name: 0.0 for part in NOT_COMPENSATED for name in PARTS[part]}
        self._framed = FramedMotor(framed.motor._replace(delay_s=0.0, **numbers), framed.frame)
        self.motor, self.frame = self._framed.motor, self._framed.frame
        self.tau_s, self.K_rad_s_V, self.lag_s = self.motor.tau_s, self.motor.K_rad_s_V, self.motor.lag_s

    def position_rad(self, reading_rad: float) -> float:
        """Where the shaft is when the sensor shows ``reading_rad``, rad."""
        return self._framed.position(reading_rad)

    def at_rest(self, y_rad: float) -> State:
        """State of a shaft that stands at ``y_rad`` without drive."""
        return State(0.0, y_rad, 0.0, 0.0, y_rad)

    def moved(self, state: State, v_rad_s: float, y_rad: float) -> State:
        """The state with another velocity and position."""
        return State(v_rad_s, y_rad, state.f, state.w, y_rad)

    def advance(self, state: State, u_V: float, dt_s: float) -> State:
        """State after ``dt_s`` (>= 0) seconds of constant drive ``u_V``."""
        return moved(self._framed, state, u_V, dt_s)

    def drive_V(self, state: State, acceleration_rad_s2: float, direction: float) -> float:
        """Drive that gives the acceleration, through the stage, against all forces.

        direction  in which friction acts against it: only its sign counts; 0: none
        """
        return drive_for(self.motor, self.frame, (state.v, state.y), acceleration_rad_s2, direction)
