"""One step of the motor's physics: its motion under a constant drive, from one event to the next.

    tau dv/dt + v = K (u + b - f(v)),   dy/dt = v,   dz/dt = y      (docs/theory.md 1.2)

Between two events the motion is a formula, which this module calls a segment: an exponential, or under Stribeck
friction a Taylor polynomial of bounded error (``rig.model.stribeck``). An event is a reversal, a motor that comes to
rest, or a speed below which the Stribeck effect begins.

The formulas are in C (firmware/motor/plain_motor.c), for the emulated boards as well as for rig.

Velocities are in rad/s, positions in rad, drives and friction in V, times in s.
"""

from __future__ import annotations

from ctypes import byref
from typing import NamedTuple

from rig.model.library import LIBRARY, PlainSegment, PlainState, numbers
from rig.model.stribeck import ORDER

Numbers = tuple[float, ...]  # of a Plant or a State, without their names


class State(NamedTuple):
    """State of the measured shaft: velocity rad/s, position rad, integral of position rad s."""

    v: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Plant(NamedTuple):
    """A motor as plain numbers. Its tau and K are the effective ones: they include viscous friction.

    tau_s, K_rad_s_V               time constant, s, and gain, (rad/s)/V, > 0
    plus_V, minus_V                friction while moving towards +y and -y, V, >= 0
    static_plus_V, static_minus_V  level to break away, V, at least the moving one
    stribeck_rad_s                 velocity over which the static level falls to the moving one, rad/s; 0: at rest only
    bias_V                         constant added to the drive, V
    """

    tau_s: float
    K_rad_s_V: float
    plus_V: float
    minus_V: float
    static_plus_V: float
    static_minus_V: float
    stribeck_rad_s: float
    bias_V: float


class Segment(NamedTuple):
    """Motion in one direction, or rest, up to its first event or to the end of the time asked for.

    is_series      whether it is a Taylor polynomial; else the velocity tends exponentially to ``target_rad_s``
    sign           direction of the motion: +1, -1; 0 where friction holds the motor
    duration_s     how long it lasts, s; may be inf
    target_rad_s   velocity that it would tend to without a further event, rad/s; nan for a polynomial
    end_rad_s      velocity at the event that ends it, rad/s, exact; nan where time ends it
    end            state at its end
    coefficients   of a polynomial: of the speed, in units of the Stribeck velocity, over time, in tau; else none
    """

    is_series: bool
    sign: float
    duration_s: float
    target_rad_s: float
    end_rad_s: float
    end: State
    coefficients: tuple[float, ...]


def glide(state: State, target: float, tau_s: float, h_s: float) -> State:
    """State ``h_s`` seconds later of a motion whose velocity tends to ``target`` (docs/theory.md 1.3)."""
    return _named(LIBRARY.plain_glided(PlainState(*state), target, tau_s, h_s))


def next_segment(plant: Plant, start: State, drive_V: float, longest_s: float) -> Segment:
    """The next segment under any friction, at most ``longest_s`` (> 0) long; ``drive_V`` with the bias, V."""
    motor, coefficients = numbers(*plant), numbers(*[0.0] * (ORDER + 1))
    found = LIBRARY.plain_next_segment(motor, start.v, drive_V, longest_s, coefficients)
    end = LIBRARY.plain_after(motor, byref(found), coefficients, PlainState(*start))
    return Segment(*_numbers_of(found), _named(end), tuple(coefficients) if found.is_series else ())


def series(start: State, unit: float, tau_s: float, coefficients: tuple[float, ...], h_s: float) -> State:
    """State ``h_s`` seconds later of a motion under Stribeck friction.

    unit           Stribeck velocity with the sign of the motion, rad/s
    coefficients   of the speed in ``unit`` over time in ``tau_s``
    """
    return _named(LIBRARY.series_state(PlainState(*start), unit, tau_s, numbers(*coefficients), h_s))


def _named(state: PlainState) -> State:
    return State(state.v, state.y, state.z)


def _numbers_of(found: PlainSegment) -> tuple[bool, float, float, float, float]:
    return found.is_series, found.sign, found.duration_s, found.target_rad_s, found.end_rad_s
