"""Real motors: what their sensor reads under a recorded drive, and its derivatives by a chosen part of their numbers.

``RealMotor`` names the numbers and ``PARTS`` the parts that they make up (docs/theory.md 12.1 and 12.6).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.core.motor_numbers import FRAME, NUMBERS, Number, Numbers, State
from rig.core.motor_numbers import PARTS as PARTS
from rig.core.motor_numbers import Frame as Frame
from rig.core.motor_numbers import RealMotor as RealMotor
from rig.model import real_step
from rig.model.compiled import real_motion
from rig.model.compiled.real_motion import Record, Windows
from rig.model.friction import coulomb
from rig.model.motor import Motor

CORE = ("tau_s", "K_rad_s_V", "fc_V", "bias_V")  # numbers of every motor
# A part that is free and at 0 gets this size, in its own unit: so it is integrated as finely as it needs.
TRACE = 1e-12
_ROUNDS = 40  # of the search for a position, which needs about ten
_CLOSE_RAD = 1e-9
_PLACE = {name: place for place, name in enumerate(RealMotor._fields)}
_TRACED = {_PLACE[name] for name, number in NUMBERS.items() if number.steers}
_PLAIN = frozenset(real_motion.PLAIN)
_PARTS_AT = np.array([place for place in _PLACE.values() if place not in _PLAIN])
_LEAST, _ABOVE, _BELOW = (
    np.array([getattr(NUMBERS[name], bound) for name in RealMotor._fields]) for bound in ("least", "above", "below")
)


@dataclass(frozen=True)
class FramedMotor:
    """A real motor, and the frame that its parts refer to. Raises ValueError on numbers out of range."""

    motor: RealMotor
    frame: Frame

    def __post_init__(self) -> None:
        _checked_motor(self.motor)
        _checked_frame(self.frame)

    @classmethod
    def of(cls, numbers: Mapping[str, float]) -> FramedMotor:
        """The motor and the frame with these numbers, by name; others are left out. Raises ValueError as the class."""
        motor = {name: value for name, value in numbers.items() if name in RealMotor._fields}
        frame = {name: value for name, value in numbers.items() if name in Frame._fields}
        if not {"tau_s", "K_rad_s_V", "fc_V"} <= motor.keys():
            raise ValueError("a motor needs tau_s, K_rad_s_V and fc_V")
        return cls(RealMotor(**motor), Frame(**frame))

    @property
    def numbers(self) -> dict[str, float]:
        """Numbers of motor and frame by name, without the parts that the motor has not; without any, without frame."""
        own = {name: value for name, value in self.motor._asdict().items() if value != 0.0 or name in CORE}
        own |= self.frame._asdict() if self.parts else {}
        return {name: float(value) for name, value in own.items()}

    def positions(self, readings_rad: Array) -> Array:
        """Where the shaft was when the sensor showed these readings, rad: without the sensor's curvature."""
        return np.array([self.position(one) for one in readings_rad.tolist()])

    def position(self, reading_rad: float) -> float:
        """Position at which the sensor shows ``reading_rad``, rad. Beyond the travel its error stays as at the end."""
        centre_rad, half_rad = self.frame.centre_rad, self.frame.half_travel_rad
        x = reading_rad
        for _ in range(_ROUNDS):
            inside = min(max(x, centre_rad - half_rad), centre_rad + half_rad)
            new = reading_rad - (real_step.reading(self.motor, self.frame, inside) - inside)
            if abs(new - x) <= _CLOSE_RAD:
                return new
            x = new
        return x

    @property
    def plain(self) -> Motor:
        """The motor without its parts."""
        return Motor(self.motor.tau_s, self.motor.K_rad_s_V, coulomb(self.motor.fc_V), self.motor.bias_V)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts that the motor has."""
        return tuple(
            name
            for name, numbers in PARTS.items()
            if any(getattr(self.motor, n) for n in numbers if not NUMBERS[n].is_shape)
        )


class Readings(NamedTuple):
    """Readings of the sensor, rad, and their derivatives in bordered form.

    y_rad      (n,)
    by_number  (n, m), by the m free numbers, in the order in which they were asked for; behind them the waves
    by_start   (n, 2), by v0, rad/s, and y0, rad, of the piece that the row is in; 0 by those of other pieces
    """

    y_rad: Array
    by_number: Array
    by_start: Array


def index(name: str) -> int:
    """Place of a number in the vector, and in a Jacobian of all numbers. Raises ValueError on an unknown name."""
    place = _PLACE.get(name)
    if place is None:
        raise ValueError(f"a motor has no number {name!r}")
    return place


def plain(motor: Motor) -> RealMotor:
    """A motor without parts, apart from a static level and the Stribeck effect, as a real one.

    Raises ValueError where the Stribeck effect or the static level differ by direction.
    """
    f = motor.friction
    step = f.static_plus_V - f.plus_V
    if abs(step - (f.static_minus_V - f.minus_V)) > 1e-12:
        raise ValueError("static friction must be above Coulomb friction by the same voltage in both directions")
    real = RealMotor(motor.tau_eff_s, motor.K_eff_rad_s_V, f.fc_V, motor.asym_V)
    if f.falls_with_speed:
        return real._replace(stribeck_V=step, stribeck_rad_s=f.stribeck_rad_s)
    return real._replace(static_V=step)


class MovingMotor:
    """A real motor in motion, for simulators: it starts at rest under 0 V, and each ``advance`` takes it on.

    ``delay_s`` of the motor is left out: who drives it knows when a drive acts.
    """

    def __init__(self, motor: RealMotor, frame: Frame, y0_rad: float) -> None:
        _checked_motor(motor)
        _checked_frame(frame)
        self.motor, self.frame = motor, frame
        self.state = real_step.at_rest(motor, frame, y0_rad)

    def put(self, v_rad_per_s: float, y_rad: float) -> None:
        """Set velocity and position of the motor's side; the sensor's side follows as far as the play makes it."""
        self.state = real_step.put(self.motor, self.frame, self.state, v_rad_per_s, y_rad)

    def stop_at(self, y_rad: float) -> None:
        """End a motion that has gone beyond the stop at ``y_rad``: there it is at rest, and has pushed no farther."""
        half = math.copysign(0.5 * self.motor.backlash_rad, self.state.y - y_rad)
        pushed = self.state.x == self.state.y - half
        x = y_rad - half if pushed else self.state.x
        self.state = self.state._replace(v=0.0, y=y_rad, x=x)

    def advance(self, u_V: float, t_s: float, dt_s: float) -> None:
        """Let ``dt_s`` (>= 0) pass from ``t_s``, s, on, under the constant drive ``u_V``."""
        self.state = real_step.advance(self.motor, self.frame, self.state, u_V, t_s, dt_s)

    @property
    def reading_rad(self) -> float:
        """What the sensor shows, rad."""
        return real_step.reading(self.motor, self.frame, self.state.x)


def moved(framed: FramedMotor, state: tuple[float, ...], u_V: float, dt_s: float) -> State:
    """State ``dt_s`` (>= 0) seconds of constant drive ``u_V`` after the frame's start.

    state   as ``rig.core.motor_numbers.State``
    """
    return real_step.advance(framed.motor, framed.frame, state, u_V, framed.frame.start_s, dt_s)


def windows_of(records: Sequence[tuple[Frame, tuple[Array, Array], Array, NDArray[np.int64]]]) -> Windows:
    """Records for ``readings_of``: frame, edges and drives, times of the rows, first rows of the pieces.

    Edges and times in s, drives in V. Raises ValueError on a frame out of range, and on arrays that do not fit.
    """
    return Windows([Record(*drive, t_s, first, _checked_frame(frame)) for frame, drive, t_s, first in records])


def readings_of(
    motor: RealMotor,
    windows: Windows,
    starts: Array,
    free: Sequence[int] | None = None,
    waves_per_rad: Sequence[float] = (),
) -> Readings:
    """Readings of all windows, one after the other, with derivatives by some numbers, and by each piece's start.

    starts   (p, 4), a row for each piece: velocity, rad/s, and position, rad, behind the backlash and before the
             sensor's linearity; where the play stands, -1 to 1: 1 after a motion towards +y; how far the bristles are
             bent, -1 to 1: 0 balances the drive, as in a motor at rest. The drive before a piece decides how its lag
             starts
    free            places of the numbers (see ``index``); None: no derivatives
    waves_per_rad   orders, > 0, of forces over position: derivatives by the sine and the cosine of each, V, follow
                    those by ``free``. All orders cost about as much as one. Of a motor without cogging only
    Derivatives are exact, except where a number decides *whether* the motor sticks. A part may be at 0 and free, except
    the bristles; the Stribeck effect and cogging then need their velocity and order. Readings are nan in the windows of
    a motor that runs away, to more than 1e5 rad/s. A motor without parts, none of which is free, is followed by its
    closed form, which is ten times faster.
    Raises ValueError on numbers out of range, on waves beside cogging, and on starts of another number of pieces.
    """
    vector = _checked_vector(motor)
    plain = not waves_per_rad and not vector[_PARTS_AT].any() and (free is None or _PLAIN.issuperset(free))
    if free is not None and not plain:
        for place in _TRACED.intersection(free):
            vector[place] = vector[place] or TRACE
        if waves_per_rad:
            if motor.cogging_sin_V != 0.0 or motor.cogging_cos_V != 0.0:
                raise ValueError("waves of the force are of a motor without cogging")
            vector[index("cogging_sin_V")], vector[index("cogging_per_rad")] = TRACE, 0.25 * max(waves_per_rad)
    y_rad, jacobian = windows.read(vector, starts, free, np.array(waves_per_rad, dtype=float), plain=plain)
    last = max(jacobian.shape[1] - 2, 0)
    return Readings(y_rad, jacobian[:, :last], jacobian[:, last:])


def is_plain(motor: RealMotor) -> bool:
    """Whether the motor has no law beyond Coulomb friction and a bias."""
    return not any(value for k, value in enumerate(motor) if k not in real_motion.PLAIN)


def _checked_vector(motor: RealMotor) -> Array:
    """Its numbers in a row. Raises ValueError on numbers out of range."""
    vector = np.array(motor, dtype=np.float64)
    if not ((vector >= _LEAST) & (vector > _ABOVE) & (vector < _BELOW)).all():
        _checked_motor(motor)  # says what is wrong
    return vector


def _checked_frame(frame: Frame) -> Numbers:
    """As plain numbers. Raises ValueError on numbers out of range."""
    return _checked(frame, FRAME)


def _checked_motor(motor: RealMotor) -> Numbers:
    """As plain numbers. Raises ValueError on numbers out of range."""
    return _checked(motor, NUMBERS)


def _checked(of: RealMotor | Frame, rows: Mapping[str, Number]) -> Numbers:
    numbers = tuple(map(float, of))
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"all numbers of a motor and its frame must be finite, not {of}")
    for value, (name, number) in zip(numbers, rows.items(), strict=True):
        if not (number.least <= value < number.below and value > number.above):
            bounds = f"at least {number.least:g}", f"above {number.above:g}", f"below {number.below:g}"
            said = " and ".join(bound for bound in bounds if "inf" not in bound)
            raise ValueError(f"{name} must be {said}, not {value:g}")
    return numbers
