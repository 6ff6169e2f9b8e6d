"""The plain motor as numbers, and its motion between two events.

    tau dv/dt + v = K (u + b - f(v)),   dy/dt = v,   dz/dt = y      (docs/theory.md 1.2)

The formulas are in C (firmware/motor/plain_motor.c), for the emulated boards as well as for rig.

Velocities are in rad/s, positions in rad, drives and friction in V, times in s.
"""

from __future__ import annotations

from typing import NamedTuple

from rig.model.library import LIBRARY, PlainState

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


def glide(state: State, target: float, tau_s: float, h_s: float) -> State:
    """State ``h_s`` seconds later of a motion whose velocity tends to ``target`` (docs/theory.md 1.3)."""
    later = LIBRARY.plain_glided(PlainState(*state), target, tau_s, h_s)
    return State(later.v, later.y, later.z)
