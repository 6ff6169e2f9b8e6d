"""One step of a real motor: its parts, and its motion from one event to the next (docs/theory.md 12.1, 12.2 and 12.3).

The formulas are in C (firmware/motor/real_motor.h says them), for emulated boards and exported controllers as well as
for rig. ``rig.core.motor_numbers`` names all numbers; a part whose numbers are 0 is not there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from rig.core.motor_numbers import Frame, RealMotor, State
from rig.model.library import LIBRARY, numbers

NO_STOPS = numbers(-math.inf, math.inf)


@lru_cache(maxsize=128)
def in_c(m: RealMotor, frame: Frame) -> Any:
    """Both as the library takes them, and never changes them."""
    return numbers(*m, *frame)


def mean_cosine(frame: Frame) -> float:
    """Mean of cos(y - centre) over the travel."""
    return math.sin(frame.half_travel_rad) / frame.half_travel_rad


def force(m: RealMotor, frame: Frame, y: float) -> float:
    """Force over position at ``y``, rad: what it takes from the drive, whichever way the motor moves, V."""
    return float(LIBRARY.real_force(in_c(m, frame), y))


def level(m: RealMotor, frame: Frame, speed: float, y: float) -> float:
    """Level of the friction in motion at ``speed`` = abs(v), rad/s, and ``y``, rad, at the frame's start; in V."""
    return float(LIBRARY.real_level(in_c(m, frame), speed, y))


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
