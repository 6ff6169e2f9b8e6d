"""One step of a real motor: its parts, and its motion from one event to the next (docs/theory.md 12.1, 12.2 and 12.3).

    tau dv/dt + v = K (w + bias - G(y) - F - beta |v| - c v |v|),    dy/dt = v,    reading = S(x)

w is the drive behind its stage, G a force over the position, F the friction, x the position behind the backlash, and S
the sensor's linearity. ``RealMotor`` names all numbers; a part whose numbers are 0 is not there.

Between two events an exponential Runge-Kutta method of fourth order (Cox and Matthews, J. Comput. Phys. 176, 2002)
takes ``v`` and ``p = y + tau v``. It is exact where the right side is constant, as it is for a motor without parts. An
event is an edge of the drive, a reversal, or a shaft that breaks away from rest.

The formulas are in C (firmware/motor/real_motor.c), for emulated boards and exported controllers as well as for rig.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from rig.model.library import LIBRARY, numbers

Numbers = tuple[float, ...]  # of a RealMotor or a Frame, without their names


class RealMotor(NamedTuple):
    """A motor with its parts, as numbers. Their order here is that of every vector and Jacobian of them, and of the C.

    tau_s, K_rad_s_V   time constant, s, and gain, (rad/s)/V, both > 0; viscous friction equal both ways is in both
    fc_V               Coulomb friction: mean over both directions, the run and the travel, V, >= 0
    bias_V             constant added to the drive, V; friction that differs by direction is in it
    delay_s            by which the drive acts later than its edges say, s
    dead_band_V        drive up to which the stage gives nothing, V, >= 0; above it is missing from the drive
    gain_by_sign       g: the stage gives u (1 + g sgn u)
    sag_per_V          s: the stage gives u (1 - s |u|), 1/V
    lag_s              time constant of the stage and the current, s, >= 0
    viscous_by_direction_V_s_rad   beta: half the difference of the viscous friction of both directions, V s/rad
    static_V           by which the level at rest is above the level in motion, V, >= 0
    stribeck_V, stribeck_rad_s   e, v_s: friction e exp(-|v|/v_s) beside fc, V, and its velocity, rad/s
    drag_V_s2_rad2     c: drag c v |v|, V s2/rad2
    bristle_V_rad      sigma_0: stiffness of the bristles, V/rad, > 0; 0: rigid, with stick and release
    force_sin_V, force_cos_V         force over position, one period per turn, V
    friction_sin_V, friction_cos_V   friction over position, one period per turn, V
    cogging_sin_V, cogging_cos_V, cogging_per_rad   force of a period of its own, V, and its order n, 1/rad
    backlash_rad       whole width of the play between motor and sensor, rad, >= 0
    linearity_sin1_rad, linearity_cos1_rad, linearity_sin2_rad, linearity_cos2_rad   the sensor's curvature, rad
    drift              relative change of fc from the frame's start to its end
    """

    tau_s: float
    K_rad_s_V: float
    fc_V: float
    bias_V: float = 0.0
    delay_s: float = 0.0
    dead_band_V: float = 0.0
    gain_by_sign: float = 0.0
    sag_per_V: float = 0.0
    lag_s: float = 0.0
    viscous_by_direction_V_s_rad: float = 0.0
    static_V: float = 0.0
    stribeck_V: float = 0.0
    stribeck_rad_s: float = 0.0
    drag_V_s2_rad2: float = 0.0
    bristle_V_rad: float = 0.0
    force_sin_V: float = 0.0
    force_cos_V: float = 0.0
    friction_sin_V: float = 0.0
    friction_cos_V: float = 0.0
    cogging_sin_V: float = 0.0
    cogging_cos_V: float = 0.0
    cogging_per_rad: float = 0.0
    backlash_rad: float = 0.0
    linearity_sin1_rad: float = 0.0
    linearity_cos1_rad: float = 0.0
    linearity_sin2_rad: float = 0.0
    linearity_cos2_rad: float = 0.0
    drift: float = 0.0


class Frame(NamedTuple):
    """What the parts over position and time refer to: constants of a fit, and no parameters.

    centre_rad, half_travel_rad   middle of the driven travel, rad, and half its width, rad, > 0
    start_s, duration_s           time of the run's start, s, and its duration, s, > 0; only ``drift`` uses them
    """

    centre_rad: float = 0.0
    half_travel_rad: float = math.pi
    start_s: float = 0.0
    duration_s: float = 1.0


class State(NamedTuple):
    """State of a real motor.

    v, y   velocity, rad/s, and position, rad, of the motor's side of the backlash
    f      friction of the bristles, V; 0 without them
    w      drive behind its stage, V
    x      position of the sensor's side of the backlash when the motor last reversed, rad
    """

    v: float
    y: float
    f: float
    w: float
    x: float


NO_STOPS = numbers(-math.inf, math.inf)


def in_c(m: RealMotor, frame: Frame) -> Any:
    """Both as the library takes them."""
    return numbers(*m, *frame)


def staged(m: RealMotor, u_V: float) -> float:
    """Drive behind dead band, gain by sign and sag, in this order, before the lag, V."""
    return float(LIBRARY.real_staged(in_c(m, Frame()), u_V))


def mean_cosine(frame: Frame) -> float:
    """Mean of cos(y - centre) over the travel."""
    return math.sin(frame.half_travel_rad) / frame.half_travel_rad


def force(m: RealMotor, frame: Frame, y: float) -> float:
    """Force over position at ``y``, rad: what it takes from the drive, whichever way the motor moves, V."""
    return float(LIBRARY.real_force(in_c(m, frame), y))


def level(m: RealMotor, frame: Frame, speed: float, y: float) -> float:
    """Level of the friction in motion at ``speed`` = abs(v), rad/s, and ``y``, rad, at the frame's start; in V."""
    return float(LIBRARY.real_level(in_c(m, frame), speed, y))


def level_at_rest(m: RealMotor, frame: Frame, y: float) -> float:
    """Level that the drive must pass to move the motor from rest at ``y``, rad, at the frame's start; in V."""
    return float(LIBRARY.real_level_at_rest(in_c(m, frame), y))


def target(m: RealMotor, frame: Frame, sign: float, at: State, t_s: float) -> float:
    """Velocity that the motor would tend to if all forces stayed as they are, rad/s: tau dv/dt + v.

    sign   direction of the motion, +1 or -1
    """
    return float(LIBRARY.real_target(in_c(m, frame), sign, numbers(*at), t_s))


def reading(m: RealMotor, frame: Frame, x: float) -> float:
    """What the sensor shows at the position ``x`` of its side, rad (docs/theory.md 12.5)."""
    return float(LIBRARY.real_reading(in_c(m, frame), x))


def at_rest(m: RealMotor, frame: Frame, y: float) -> State:
    """State of a motor at rest at ``y``, rad, under 0 V, at the frame's start."""
    return _changed(LIBRARY.real_start, m, frame, State(0.0, 0.0, 0.0, 0.0, 0.0), y)


def put(m: RealMotor, frame: Frame, at: State, v: float, y: float) -> State:
    """``at`` with the motor's side at ``v``, rad/s, and ``y``, rad; the play decides how far the sensor's follows."""
    return _changed(LIBRARY.real_put, m, frame, at, v, y)


def advance(m: RealMotor, frame: Frame, at: Sequence[float], u_V: float, t_s: float, dt_s: float) -> State:
    """State ``dt_s`` seconds after ``t_s`` under the constant drive ``u_V``, through every event.

    Its ``x`` is where the sensor's side is at the end. ``delay_s`` is not applied: a caller knows when a drive acts.
    """
    return _changed(LIBRARY.real_advance, m, frame, at, u_V, numbers(t_s, dt_s), NO_STOPS)


def _changed(function: Any, m: RealMotor, frame: Frame, at: Sequence[float], *arguments: Any) -> State:
    """``at`` after a function of the library that changes it."""
    state = numbers(*at)
    function(in_c(m, frame), state, *arguments)
    return State(*state)
