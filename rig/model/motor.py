"""The exact event-driven motor: tau dv/dt + v = K (u + b - f(v)), dy/dt = v, dz/dt = y (docs/theory.md 1.2).

An event is a change of the drive, or a velocity that crosses zero. Between two events the motion is a formula: an
exponential, or under Stribeck friction a chain of Taylor polynomials of bounded error (docs/theory.md 8.2). Viscous
friction needs no formula of its own: it lowers tau and K by the same factor (docs/theory.md 8.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from rig.core.arrays import Array
from rig.model import friction as friction_laws
from rig.model.compiled import motion
from rig.model.friction import Friction
from rig.model.library import LIBRARY, numbers
from rig.model.step import Plant
from rig.model.step import State as State


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

    def __getstate__(self) -> dict[str, object]:
        """What a copy in another process needs: what was worked out for the library cannot be sent there."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

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
        levels_V = f.plus_V, f.minus_V, f.static_plus_V, f.static_minus_V
        stribeck_rad_s = f.stribeck_rad_s if f.falls_with_speed else 0.0
        return Plant(*map(float, (self.tau_eff_s, self.K_eff_rad_s_V, *levels_V, stribeck_rad_s, self.bias_V)))

    @cached_property
    def _in_c(self) -> Any:
        return numbers(*self.plant)

    def advance(self, state: State, u_V: float, dt_s: float) -> State:
        """State after ``dt_s`` (>= 0) seconds of constant drive ``u_V``, through every velocity reversal."""
        at = numbers(*state)  # an observer asks three times a tick
        LIBRARY.plain_advance(self._in_c, at, u_V, dt_s)
        return State(*at)

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
        if np.any(np.diff(t) < 0.0) or np.any(np.diff(edges) < 0.0) or np.any(edges[0] > t[:1]):
            raise ValueError("times must not decrease, and the drive must be known from the first sample on")
        v, y, z = map(float, start)
        return motion.states(self.plant, (v, y, z), (edges, drive, 0.0), t)


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
