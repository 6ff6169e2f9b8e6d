"""The exact event-driven motor: tau dv/dt + v = K (u + b - f(v)), dy/dt = v, dz/dt = y (docs/theory.md 1.2).

An event is a change of the drive, or a velocity that crosses zero. Between two events the motion is a formula: an
exponential, or under Stribeck friction a chain of Taylor polynomials of bounded error (``rig.model.stribeck``). Viscous
friction needs no formula of its own: it lowers tau and K by the same factor (docs/theory.md 8.1).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.model import friction as friction_laws
from rig.model import step
from rig.model.compiled import motion
from rig.model.friction import Friction
from rig.model.library import LIBRARY, numbers
from rig.model.step import Plant
from rig.model.step import State as State

Array = NDArray[np.float64]


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
        return step.glide(self.start, self.target, self.tau_s, h_s)


class Arc(NamedTuple):
    """Motion under Stribeck friction, as a polynomial in time (``rig.model.stribeck``).

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
        state = step.series(self.start, self.v_unit, self.tau_s, self.coefficients, h_s)
        return state._replace(v=0.0) if self.rests and h_s >= self.duration_s else state


Piece = Glide | Arc


@dataclass(frozen=True)
class Motor:
    """Plant parameters.

    tau_s       velocity time constant without viscous friction, s, > 0
    K_rad_s_V   velocity gain of the measured shaft without viscous friction, (rad/s)/V, > 0
    friction    levels by direction, V, Stribeck velocity and viscous friction
    bias_V      constant added to the drive, V
    Raises ValueError outside these ranges.
    """

    tau_s: float
    K_rad_s_V: float
    friction: Friction = field(default=friction_laws.NONE)
    bias_V: float = 0.0

    def __post_init__(self) -> None:
        if not (self.tau_s > 0.0 and self.K_rad_s_V > 0.0):
            raise ValueError("tau_s and K_rad_s_V must be > 0")

    @cached_property
    def tau_eff_s(self) -> float:
        """Effective time constant, tau / (1 + K fv), s. A motion shows this one."""
        return self.tau_s / (1.0 + self.K_rad_s_V * self.friction.viscous_V_s_rad)

    @cached_property
    def K_eff_rad_s_V(self) -> float:
        """Effective gain, K / (1 + K fv), (rad/s)/V. A motion shows this one; tau / K does not depend on fv."""
        return self.K_rad_s_V / (1.0 + self.K_rad_s_V * self.friction.viscous_V_s_rad)

    @cached_property
    def has_closed_form(self) -> bool:
        """Whether the velocity is exponential between events: there is no Stribeck effect."""
        return not self.friction.falls_with_speed

    @property
    def asym_V(self) -> float:
        """Asymmetry a = b - (f+ - f-)/2 of the effective drive, V. A motion shows this sum, not bias b alone."""
        return self.bias_V - 0.5 * (self.friction.plus_V - self.friction.minus_V)

    @cached_property
    def plant(self) -> Plant:
        """The motor as the numbers that ``rig.model.step`` works with."""
        f = self.friction
        return Plant(
            float(self.tau_eff_s),
            float(self.K_eff_rad_s_V),
            float(f.plus_V),
            float(f.minus_V),
            float(f.static_plus_V),
            float(f.static_minus_V),
            float(f.stribeck_rad_s) if f.falls_with_speed else 0.0,
            float(self.bias_V),
        )

    @cached_property
    def _in_c(self) -> Any:
        return numbers(*self.plant)

    def advance(self, state: State, u_V: float, dt_s: float) -> State:
        """State after ``dt_s`` (>= 0) seconds of constant drive ``u_V``, through every velocity reversal."""
        at = numbers(*state)  # an observer asks three times a tick
        LIBRARY.plain_advance(self._in_c, at, u_V, dt_s)
        return State(*at)

    def pieces(self, state: State, u_V: float, dt_s: float) -> Iterator[Piece]:
        """The motion over ``dt_s`` seconds of constant drive ``u_V``, piece by piece.

        Within a piece the velocity keeps its sign. At a reversal, where two pieces meet, it is exactly 0.
        A motor that friction holds is a Glide from 0 to 0.
        """
        plant, drive_V = self.plant, u_V + self.bias_V
        while dt_s > 0.0:
            segment = step.next_segment(plant, state, drive_V, dt_s)
            piece: Piece
            if segment.is_series:
                unit, rests = segment.sign * plant.stribeck_rad_s, segment.end_rad_s == 0.0
                piece = Arc(state, segment.duration_s, segment.coefficients, unit, plant.tau_s, rests)
            else:
                piece = Glide(state, segment.duration_s, segment.target_rad_s, plant.tau_s)
            state = segment.end
            dt_s -= segment.duration_s
            yield piece

    def terminal_velocity(self, v: float, u_V: float) -> float:
        """Final velocity of the motion from ``v`` under constant ``u_V``, rad/s; 0 if friction stops it."""
        final: float = LIBRARY.plain_terminal_velocity(self._in_c, v, u_V)
        return final

    def stopping_distance(self, v: float) -> float:
        """Distance to standstill at 0 V from velocity ``v``, rad/s; in rad, with the sign of ``v``."""
        end = self.advance(State(v=v), 0.0, 40.0 * self.tau_s)
        return end.y

    def response(
        self,
        start: State,
        t_s: Sequence[float] | Array,
        edge_s: Sequence[float] | Array,
        edge_u_V: Sequence[float] | Array,
    ) -> Array:
        """States at the times ``t_s`` under a drive that is constant between edges.

        start      state at t_s[0]
        t_s        n times, s, non-decreasing
        edge_s     m times, s, non-decreasing, edge_s[0] <= t_s[0]: the drive is edge_u_V[j] from edge_s[j] on
        edge_u_V   m drives, V
        Returns an (n, 3) array of v, y, z. Raises ValueError on unordered times or shapes that differ.
        """
        t, edges, drive = (np.ascontiguousarray(series, float) for series in (t_s, edge_s, edge_u_V))
        if t.ndim != 1 or edges.shape != drive.shape or edges.ndim != 1 or edges.size == 0:
            raise ValueError("t_s, edge_s and edge_u_V must be one-dimensional, edges and drives of one length")
        if t.size == 0:
            return np.empty((0, 3))
        if np.any(np.diff(t) < 0.0) or np.any(np.diff(edges) < 0.0) or edges[0] > t[0]:
            raise ValueError("times must not decrease, and the drive must be known from the first sample on")
        states = np.empty((t.size, 3))
        v, y, z = map(float, start)
        motion.response(tuple(self.plant), (v, y, z), (edges, drive, 0.0), t, states)
        return states


class MovingPlainMotor:
    """A motor without parts in motion, for simulators: from rest at ``y0_rad`` each ``advance`` takes it on."""

    def __init__(self, motor: Motor, y0_rad: float) -> None:
        self._motor, self._state = motor, State(y=y0_rad)

    def advance(self, u_V: float, t_s: float, dt_s: float) -> None:
        """Let ``dt_s`` (>= 0) pass under the constant drive ``u_V``; the time ``t_s``, s, changes nothing."""
        self._state = self._motor.advance(self._state, u_V, dt_s)

    @property
    def reading_rad(self) -> float:
        """The position, rad."""
        return self._state.y
