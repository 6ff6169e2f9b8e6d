"""One step of the motor's physics: its motion under a constant drive, from one event to the next.

    tau dv/dt + v = K (u + b - f(v)),   dy/dt = v,   dz/dt = y      (docs/theory.md 1.2)

Between two events the motion is a formula, which this module calls a segment: an exponential, or under Stribeck
friction a Taylor polynomial of bounded error (``rig.model.stribeck``). An event is a reversal, a motor that comes to
rest, or a speed below which the Stribeck effect begins.

Each part of the model is one function here, in plain Python. ``Motor`` calls these functions directly. numba compiles
the same functions into the loops of ``rig.model.compiled``. The emulated boards have them in C
(firmware/boards/host/bench.c); tests/backends/serial compares the C with the Python.

Velocities are in rad/s, positions in rad, drives and friction in V, times in s.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rig.model.stribeck import (
    Room,
    Series,
    expand,
    far_speed,
    integral_at,
    is_exponential,
    path_at,
    rest_within,
    speed_at,
)

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
    """

    is_series: bool
    sign: float
    duration_s: float
    target_rad_s: float
    end_rad_s: float


def direction(plant: Plant, v: float, drive_V: float) -> float:
    """Direction of motion: the sign of ``v``, rad/s; from rest the sign of the drive; 0 if friction holds the motor."""
    if v != 0.0:
        return 1.0 if v > 0.0 else -1.0
    if drive_V > plant.static_plus_V:
        return 1.0
    return -1.0 if drive_V < -plant.static_minus_V else 0.0


def friction_levels(plant: Plant, sign: float) -> tuple[float, float]:
    """Friction in the direction ``sign`` (+1 or -1), V: the moving level and the static one."""
    if sign > 0.0:
        return plant.plus_V, plant.static_plus_V
    return plant.minus_V, plant.static_minus_V


def target_velocity(plant: Plant, sign: float, drive_V: float) -> float:
    """Final velocity of a motion in the direction ``sign`` under Coulomb friction, rad/s; 0 for a sign of 0."""
    if sign > 0.0:
        return plant.K_rad_s_V * (drive_V - plant.plus_V)
    return plant.K_rad_s_V * (drive_V + plant.minus_V) if sign < 0.0 else 0.0


def reversal_time(v: float, target: float, tau_s: float) -> float:
    """Time until a velocity ``v`` that tends to ``target``, both rad/s, reaches zero, s; inf if it never does."""
    if v == 0.0:
        return 0.0
    if v < 0.0 < target or target < 0.0 < v:  # not by the sign of their product, which can round to 0
        return tau_s * math.log1p(-v / target)
    return math.inf


def decay_after(h_s: float, tau_s: float) -> float:
    """1 - exp(-h / tau): the share of its way to the target that a velocity has gone after ``h_s``."""
    return -math.expm1(-h_s / tau_s)


def glide(state: State, target: float, tau_s: float, h_s: float) -> State:
    """State ``h_s`` seconds later of a motion whose velocity tends to ``target`` (docs/theory.md 1.3)."""
    return glide_by(state, target, tau_s, h_s, decay_after(h_s, tau_s))


def glide_by(state: State, target: float, tau_s: float, h_s: float, decay: float) -> State:
    """``glide`` towards ``target``, rad/s, for a caller that already has ``decay`` = 1 - exp(-h / tau)."""
    v, y, z = state
    excess = v - target
    return State(
        v - excess * decay,
        y + target * h_s + excess * tau_s * decay,
        z + y * h_s + 0.5 * target * h_s * h_s + excess * tau_s * (h_s - tau_s * decay),
    )


def exponential(plant: Plant, v: float, drive_V: float, longest_s: float) -> tuple[float, float, float, bool]:
    """The next segment under Coulomb friction, at most ``longest_s`` (> 0) long.

    v         velocity, rad/s
    drive_V   drive with the bias, V
    Returns its direction, the velocity that it tends to, rad/s, its duration, s, and whether it ends at a reversal.
    """
    sign = direction(plant, v, drive_V)
    target = target_velocity(plant, sign, drive_V)
    if v != 0.0:
        stop_s = reversal_time(v, target, plant.tau_s)
        if stop_s < longest_s:
            return sign, target, stop_s, True
    return sign, target, longest_s, False


def next_segment(plant: Plant, v: float, drive_V: float, longest_s: float, c: Room, w: Room) -> Segment:
    """The next segment under any friction, at most ``longest_s`` (> 0) long.

    v         velocity, rad/s
    drive_V   drive with the bias, V
    c, w      buffers of ``stribeck.ORDER + 1`` numbers each. ``c`` gets the coefficients of a polynomial; without
              Stribeck effect both stay as they are
    """
    unit = plant.stribeck_rad_s
    if unit == 0.0:
        sign, target, duration_s, reverses = exponential(plant, v, drive_V, longest_s)
        return Segment(False, sign, duration_s, target, 0.0 if reverses else math.nan)
    sign = direction(plant, v, drive_V)
    if sign == 0.0:
        return Segment(False, 0.0, longest_s, 0.0, math.nan)
    tau, gain = plant.tau_s, plant.K_rad_s_V
    moving_V, static_V = friction_levels(plant, sign)
    b = gain * (static_V - moving_V) / unit
    x, target = abs(v) / unit, gain * (sign * drive_V - moving_V) / unit
    if is_exponential(x, target, b):
        far = far_speed(b)
        # down to the speed at which the Stribeck effect begins, or to rest if this direction has no Stribeck effect
        leaves_s = tau * math.log1p((x - far) / (far - target)) if target < far < x else math.inf
        if leaves_s <= longest_s:
            return Segment(False, sign, leaves_s, sign * unit * target, sign * unit * far)
        return Segment(False, sign, longest_s, sign * unit * target, math.nan)
    duration_s = min(tau * expand(x, gain * (sign * drive_V - static_V) / unit, b, c, w), longest_s)
    if x > 0.0 and speed_at(c, duration_s / tau) <= 0.0:
        return Segment(True, sign, tau * rest_within(c, duration_s / tau), math.nan, 0.0)
    return Segment(True, sign, duration_s, math.nan, math.nan)


def state_after(plant: Plant, segment: Segment, c: Series, start: State) -> State:
    """State at the end of a segment, its velocity exact where an event ends it.

    c   as ``next_segment`` has left it
    """
    if not segment.is_series:
        return glide_after(plant, segment, start)
    v, y, z = series(start, segment.sign * plant.stribeck_rad_s, plant.tau_s, c, segment.duration_s)
    return State(v if math.isnan(segment.end_rad_s) else segment.end_rad_s, y, z)


def glide_after(plant: Plant, segment: Segment, start: State) -> State:
    """``state_after`` for a segment that is an exponential."""
    v, y, z = glide(start, segment.target_rad_s, plant.tau_s, segment.duration_s)
    return State(v if math.isnan(segment.end_rad_s) else segment.end_rad_s, y, z)


def series(start: State, unit: float, tau_s: float, c: Series, h_s: float) -> State:
    """State ``h_s`` seconds later of a motion under Stribeck friction.

    unit   Stribeck velocity with the sign of the motion, rad/s
    c      coefficients of the speed in ``unit`` over time in ``tau_s``
    """
    h = h_s / tau_s
    return State(
        unit * speed_at(c, h),
        series_position(start, unit, tau_s, c, h_s),
        start.z + start.y * h_s + unit * tau_s * tau_s * integral_at(c, h),
    )


def series_position(start: State, unit: float, tau_s: float, c: Series, h_s: float) -> float:
    """The position alone, rad; ``unit`` and ``c`` as for ``series``."""
    return start.y + unit * tau_s * path_at(c, h_s / tau_s)


def advance(plant: Plant, state: State, u_V: float, dt_s: float, c: Room, w: Room) -> State:
    """State after ``dt_s`` (>= 0) seconds of constant drive ``u_V``, through every event; ``c``, ``w`` are buffers."""
    if plant.stribeck_rad_s == 0.0:
        return advance_exponentially(plant, state, u_V, dt_s)
    drive_V = u_V + plant.bias_V
    left_s = dt_s
    while left_s > 0.0:
        segment = next_segment(plant, state.v, drive_V, left_s, c, w)
        state = state_after(plant, segment, c, state)
        left_s -= segment.duration_s
    return state


def advance_exponentially(plant: Plant, state: State, u_V: float, dt_s: float) -> State:
    """``advance`` for a motor without Stribeck effect."""
    drive_V, tau_s = u_V + plant.bias_V, plant.tau_s
    left_s = dt_s
    while left_s > 0.0:
        _, target, h_s, reverses = exponential(plant, state.v, drive_V, left_s)
        state = glide(state, target, tau_s, h_s)
        if reverses:
            state = State(0.0, state.y, state.z)
        left_s -= h_s
    return state
