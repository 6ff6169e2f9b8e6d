"""The exact event-driven motor: tau dv/dt + v = K (u + b - f(v)), dy/dt = v, dz/dt = y (theory (1)-(5)).

The motion has a closed form between the instants at which the drive changes or the velocity crosses
zero, so there is no integration step and no integration error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.model import friction as friction_laws
from rig.model.friction import Friction

Array = NDArray[np.float64]


class State(NamedTuple):
    """State of the measured shaft: velocity rad/s, position rad, integral of position rad s."""

    v: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(frozen=True)
class Motor:
    """Plant parameters.

    tau_s       velocity time constant, s, > 0
    K_rad_s_V   velocity gain of the measured shaft, (rad/s)/V, > 0
    friction    levels by direction, V
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

    @property
    def asym_V(self) -> float:
        """Asymmetry a = b - (f+ - f-)/2 of the effective drive, V: what motion can show of bias."""
        return self.bias_V - 0.5 * (self.friction.plus_V - self.friction.minus_V)

    def advance(self, state: State, u_V: float, dt_s: float) -> State:
        """State after ``dt_s`` (>= 0) seconds of constant drive ``u_V``, through every velocity reversal."""
        v, y, z = state
        segments = self._segments(v, u_V, dt_s)
        for k, (h, target) in enumerate(segments):
            v, y, z = _glide(v, y, z, target, self.tau_s, h)
            if k + 1 < len(segments):
                v = 0.0  # exactly at rest where the segments meet
        return State(v, y, z)

    def _segments(self, v: float, u_V: float, dt_s: float) -> list[tuple[float, float]]:
        """Cut ``dt_s`` at the reversal: (duration s, velocity that the segment tends to, rad/s).

        There is at most one reversal under constant drive. A velocity of 0 held by friction is a
        segment that tends to 0 from 0.
        """
        if dt_s <= 0.0:
            return []
        target = self.terminal_velocity(v, u_V)
        stop = reversal_time(v, target, self.tau_s)
        if v == 0.0 or stop >= dt_s:
            return [(dt_s, target)]
        return [(stop, target), (dt_s - stop, self.terminal_velocity(0.0, u_V))]

    def terminal_velocity(self, v: float, u_V: float) -> float:
        """Velocity that the motion tends to from ``v`` under ``u_V``, rad/s; 0 from rest if friction holds."""
        drive = u_V + self.bias_V
        f = self.friction
        if v > 0.0:
            return self.K_rad_s_V * (drive - f.plus_V)
        if v < 0.0:
            return self.K_rad_s_V * (drive + f.minus_V)
        if drive > f.static_plus_V:
            return self.K_rad_s_V * (drive - f.plus_V)
        if drive < -f.static_minus_V:
            return self.K_rad_s_V * (drive + f.minus_V)
        return 0.0

    def stopping_distance(self, v: float) -> float:
        """Distance still travelled at 0 V from velocity ``v``, rad, with the sign of ``v``."""
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

        Work is one scalar step an event (edge that changes the drive, or reversal), then one vector step for
        all samples.
        """
        t = np.asarray(t_s, dtype=float)
        edges = np.asarray(edge_s, dtype=float)
        drive = np.asarray(edge_u_V, dtype=float)
        if t.ndim != 1 or edges.shape != drive.shape or edges.ndim != 1 or edges.size == 0:
            raise ValueError("t_s, edge_s and edge_u_V must be one-dimensional, edges and drives of one length")
        if t.size == 0:
            return np.empty((0, 3))
        if np.any(np.diff(t) < 0.0) or np.any(np.diff(edges) < 0.0) or edges[0] > t[0]:
            raise ValueError("times must not decrease, and the drive must be known from the first sample on")
        first = int(np.searchsorted(edges, t[0], side="right")) - 1
        keep = np.arange(first, edges.size)
        keep = keep[np.concatenate(([True], drive[keep[1:]] != drive[keep[:-1]]))]
        starts = np.maximum(edges[keep], t[0]).tolist()
        ends = [*starts[1:], max(float(t[-1]), starts[-1])]
        rows: list[tuple[float, float, float, float, float]] = []
        v, y, z = start
        tau = self.tau_s
        for begin, end, u in zip(starts, ends, drive[keep].tolist(), strict=True):
            now = begin
            segments = self._segments(v, u, end - begin)
            for k, (h, target) in enumerate(segments):
                rows.append((now, v, y, z, target))
                v, y, z = _glide(v, y, z, target, tau, h)
                now += h
                if k + 1 < len(segments):
                    v = 0.0  # exactly at rest where the segments meet
            if begin >= t[-1]:
                break
        if not rows:
            rows.append((float(t[0]), v, y, z, v))
        table = np.array(rows)
        row = table[np.searchsorted(table[:, 0], t, side="right") - 1]
        h = t - row[:, 0]
        decay = -np.expm1(-h / tau)
        excess = row[:, 1] - row[:, 4]
        out = np.empty((t.size, 3))
        out[:, 0] = row[:, 1] - excess * decay
        out[:, 1] = row[:, 2] + row[:, 4] * h + excess * tau * decay
        out[:, 2] = row[:, 3] + row[:, 2] * h + 0.5 * row[:, 4] * h * h + excess * tau * (h - tau * decay)
        return out


def reversal_time(v: float, target: float, tau_s: float) -> float:
    """Time until a velocity ``v`` that tends to ``target`` reaches zero, s; inf if it never does."""
    if v == 0.0:
        return 0.0
    if v * target >= 0.0:
        return math.inf
    return tau_s * math.log1p(-v / target)


def _glide(v: float, y: float, z: float, target: float, tau: float, h: float) -> tuple[float, float, float]:
    """Closed form over ``h`` seconds of a velocity that tends to ``target`` (theory section 1)."""
    decay = -math.expm1(-h / tau)
    excess = v - target
    return (
        v - excess * decay,
        y + target * h + excess * tau * decay,
        z + y * h + 0.5 * target * h * h + excess * tau * (h - tau * decay),
    )
