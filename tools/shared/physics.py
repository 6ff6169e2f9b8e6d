"""Single steps of the motor's physics in C, which rig asks for as a whole only: for the paper's tool, and for tests.

    tau dv/dt + v = K (u + b - f(v)),   dy/dt = v,   dz/dt = y      (docs/theory.md 1.2)

Between two events a motion under constant drive is a formula: an exponential, or under Stribeck friction a Taylor
polynomial. An event is a reversal, a motor that comes to rest, or a speed below which the Stribeck effect begins. There
speeds are in units of the Stribeck velocity, times in units of tau. Step and bound: firmware/motor/plain_motor.c.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from ctypes import POINTER, Structure, byref, c_bool, c_double, c_void_p
from typing import Any, NamedTuple

from rig.core.motor_numbers import Frame, RealMotor
from rig.core.motor_numbers import State as RealState
from rig.model.library import LIBRARY, PlainState, numbers
from rig.model.motor import Motor
from rig.model.real_step import in_c
from rig.model.step import Plant, State, glide

ORDER = 22
RATIO = 4.0  # of the radius to which a series surely converges, over its step
TRUNCATION = RATIO**-ORDER / (RATIO - 1.0)  # bound of a step's truncation, over R


class PlainSegment(Structure):
    """``plain_segment``."""

    _fields_ = (
        *((name, c_double) for name in ("sign", "duration_s", "target_rad_s", "end_rad_s")),
        ("is_series", c_bool),
    )


_P, _D = c_void_p, c_double
_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "plain_next_segment": (PlainSegment, [_P, _D, _D, _D, _P]),
    "plain_after": (PlainState, [_P, POINTER(PlainSegment), _P, PlainState]),
    "plain_terminal_velocity": (_D, [_P, _D, _D]),
    "series_state": (PlainState, [PlainState, _D, _D, _P, _D]),
    "series_expand": (_D, [_D, _D, _D, _P]),
    "series_speed": (_D, [_P, _D]),
    "real_level_at_rest": (_D, [_P, _D]),
    "real_staged": (_D, [_P, _D]),
    "real_target": (_D, [_P, _D, _P, _D]),
}
for _name, (_result, _arguments) in _SIGNATURES.items():
    _function = getattr(LIBRARY, _name)
    _function.restype, _function.argtypes = _result, _arguments


class Segment(NamedTuple):
    """Motion in one direction, or rest, up to its first event or to the end of the time asked for.

    sign           direction of the motion: +1, -1; 0 where friction holds the motor
    duration_s     how long it lasts, s; may be inf
    target_rad_s   velocity that it would tend to without a further event, rad/s; nan for a polynomial
    end_rad_s      velocity at the event that ends it, rad/s, exact; nan where time ends it
    is_series      whether it is a Taylor polynomial; else the velocity tends exponentially to ``target_rad_s``
    end            state at its end
    coefficients   of a polynomial: of the speed, in units of the Stribeck velocity, over time, in tau; else none
    """

    sign: float
    duration_s: float
    target_rad_s: float
    end_rad_s: float
    is_series: bool
    end: State
    coefficients: tuple[float, ...]


class Glide(NamedTuple):
    """Motion whose velocity tends exponentially to ``target`` (docs/theory.md 1.3); at rest both are 0.

    start, duration_s   its first state, and how long it lasts, s (may be inf)
    target, tau_s       final velocity, rad/s; time constant, s
    """

    start: State
    duration_s: float
    target: float
    tau_s: float

    def at(self, h_s: float) -> State:
        """State ``h_s`` after the start."""
        return glide(self.start, self.target, self.tau_s, h_s)


class Arc(NamedTuple):
    """Motion under Stribeck friction, as a polynomial in time.

    start, duration_s   its first state, and how long it lasts, s
    coefficients        of the speed, in units of v_unit, as a power series of time, in units of tau_s
    v_unit, tau_s       Stribeck velocity with the sign of the motion, rad/s; effective time constant, s
    rests               whether it ends with the velocity at zero
    """

    start: State
    duration_s: float
    coefficients: tuple[float, ...]
    v_unit: float
    tau_s: float
    rests: bool

    def at(self, h_s: float) -> State:
        """State ``h_s`` after the start."""
        of = numbers(*self.coefficients)
        found = LIBRARY.series_state(PlainState(*self.start), self.v_unit, self.tau_s, of, h_s)
        return State(0.0 if self.rests and h_s >= self.duration_s else found.v, found.y, found.z)


Piece = Glide | Arc


def next_segment(plant: Plant, start: State, drive_V: float, longest_s: float) -> Segment:
    """The next segment under any friction, at most ``longest_s`` (> 0) long; ``drive_V`` with the bias, V."""
    motor, coefficients = numbers(*plant), numbers(*[0.0] * (ORDER + 1))
    found = LIBRARY.plain_next_segment(motor, start.v, drive_V, longest_s, coefficients)
    end = LIBRARY.plain_after(motor, byref(found), coefficients, PlainState(*start))
    ends = found.sign, found.duration_s, found.target_rad_s, found.end_rad_s
    return Segment(*ends, found.is_series, State(end.v, end.y, end.z), tuple(coefficients) if found.is_series else ())


def pieces(motor: Motor, state: State, u_V: float, dt_s: float) -> Iterator[Piece]:
    """The motion over ``dt_s`` seconds of constant drive ``u_V``, piece by piece.

    Within a piece the velocity keeps its sign. At a reversal, where two pieces meet, it is exactly 0.
    A motor that friction holds is a Glide from 0 to 0.
    """
    plant, drive_V = motor.plant, u_V + motor.bias_V
    while dt_s > 0.0:
        segment = next_segment(plant, state, drive_V, dt_s)
        if segment.is_series:
            unit, rests = segment.sign * plant.stribeck_rad_s, segment.end_rad_s == 0.0
            yield Arc(state, segment.duration_s, segment.coefficients, unit, plant.tau_s, rests)
        else:
            yield Glide(state, segment.duration_s, segment.target_rad_s, plant.tau_s)
        state, dt_s = segment.end, dt_s - segment.duration_s


def terminal_velocity(motor: Motor, v: float, u_V: float) -> float:
    """Final velocity of the motion from ``v`` under constant ``u_V``, rad/s; 0 if friction stops it."""
    return float(LIBRARY.plain_terminal_velocity(numbers(*motor.plant), v, u_V))


def stopping_distance(motor: Motor, v: float) -> float:
    """Distance to standstill at 0 V from velocity ``v``, rad/s; in rad, with the sign of ``v``."""
    return motor.advance(State(v=v), 0.0, 40.0 * motor.tau_s).y


def expand(x: float, e: float, b: float) -> tuple[float, tuple[float, ...]]:
    """The step for which the series of x(t) about ``x`` holds, and its ORDER + 1 coefficients (docs/theory.md 8.2).

    x' = e - x - b expm1(-x),    e = K (D - fs) / vs,    b = K (fs - fc) / vs;    D: drive along the motion, V
    """
    coefficients = numbers(*[0.0] * (ORDER + 1))
    step: float = LIBRARY.series_expand(x, e, b, coefficients)
    return step, tuple(coefficients)


def speed_at(coefficients: Sequence[float], h: float) -> float:
    """Speed ``h`` after the point of expansion."""
    return float(LIBRARY.series_speed(numbers(*coefficients), h))


def staged(m: RealMotor, u_V: float) -> float:
    """Effective drive, V: what passes the dead band, scaled by direction and sag (docs/theory.md 12.1)."""
    return float(LIBRARY.real_staged(in_c(m, Frame()), u_V))


def level_at_rest(m: RealMotor, frame: Frame, y: float) -> float:
    """Drive behind the stage, V, that friction holds at rest."""
    return float(LIBRARY.real_level_at_rest(in_c(m, frame), y))


def target(m: RealMotor, frame: Frame, sign: float, at: RealState, t_s: float) -> float:
    """Velocity, rad/s, that the motion in direction ``sign`` tends to from this state."""
    return float(LIBRARY.real_target(in_c(m, frame), sign, numbers(*at), t_s))
