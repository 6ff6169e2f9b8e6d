"""The exact event-driven motor: tau dv/dt + v = K (u + b - f(v)), dy/dt = v, dz/dt = y (docs/theory.md 1.2).

Between the instants at which the drive changes or the velocity crosses zero the motion is a formula: an exponential,
or under Stribeck friction a chain of Taylor polynomials of bounded error (``rig.model.stribeck``). Viscous friction
needs no formula of its own: it lowers tau and K alike (docs/theory.md 8.1).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.model import friction as friction_laws
from rig.model import stribeck
from rig.model.friction import Friction

Array = NDArray[np.float64]


class State(NamedTuple):
    """State of the measured shaft: velocity rad/s, position rad, integral of position rad s."""

    v: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Glide(NamedTuple):
    """Motion whose velocity tends exponentially to ``target`` (docs/theory.md 1.3); at rest both are 0.

    start, duration_s   its first state, and how long it lasts (may be inf)
    target, tau_s       rad/s, s
    """

    start: State
    duration_s: float
    target: float
    tau_s: float

    def at(self, h_s: float) -> State:
        """State ``h_s`` after the start."""
        return State(*_glide(*self.start, self.target, self.tau_s, h_s))


class Arc(NamedTuple):
    """Motion under Stribeck friction, as a polynomial in time (``rig.model.stribeck``).

    start, duration_s   its first state, and how long it lasts
    coefficients        of the speed in v_unit over time in tau_s
    v_unit, tau_s       Stribeck velocity with the sign of the motion, rad/s; effective time constant, s
    rests               it ends with the velocity at zero
    """

    start: State
    duration_s: float
    coefficients: tuple[float, ...]
    v_unit: float
    tau_s: float
    rests: bool

    def at(self, h_s: float) -> State:
        """State ``h_s`` after the start."""
        _, y, z = self.start
        c, h, unit = self.coefficients, h_s / self.tau_s, self.v_unit
        v = 0.0 if self.rests and h_s >= self.duration_s else unit * stribeck.speed_at(c, h)
        y_unit = unit * self.tau_s
        return State(
            v,
            y + y_unit * stribeck.path_at(c, h),
            z + y * h_s + y_unit * self.tau_s * stribeck.integral_at(c, h),
        )


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
        """Time constant that the motion shows: tau / (1 + K fv), s."""
        return self.tau_s / (1.0 + self.K_rad_s_V * self.friction.viscous_V_s_rad)

    @cached_property
    def K_eff_rad_s_V(self) -> float:
        """Gain that the motion shows: K / (1 + K fv), (rad/s)/V; tau / K is as without viscous friction."""
        return self.K_rad_s_V / (1.0 + self.K_rad_s_V * self.friction.viscous_V_s_rad)

    @cached_property
    def has_closed_form(self) -> bool:
        """Whether the velocity is exponential between events: there is no Stribeck effect."""
        return not self.friction.falls_with_speed

    @property
    def asym_V(self) -> float:
        """Asymmetry a = b - (f+ - f-)/2 of the effective drive, V: what motion can show of bias."""
        return self.bias_V - 0.5 * (self.friction.plus_V - self.friction.minus_V)

    def advance(self, state: State, u_V: float, dt_s: float) -> State:
        """State after ``dt_s`` (>= 0) seconds of constant drive ``u_V``, through every velocity reversal."""
        if not self.has_closed_form:
            for piece in self._arcs(state, u_V, dt_s):
                state = piece.at(piece.duration_s)
            return state
        v, y, z = state
        segments = self._segments(v, u_V, dt_s)
        for k, (h, target) in enumerate(segments):
            v, y, z = _glide(v, y, z, target, self.tau_eff_s, h)
            if k + 1 < len(segments):
                v = 0.0  # exactly at rest where the segments meet
        return State(v, y, z)

    def pieces(self, state: State, u_V: float, dt_s: float) -> Iterator[Piece]:
        """The motion over ``dt_s`` seconds of constant drive ``u_V``, piece by piece.

        Within a piece the velocity does not change its sign; where two meet with the velocity crossing zero it is
        exactly 0. A motor that friction holds is a Glide from 0 to 0.
        """
        if not self.has_closed_form:
            yield from self._arcs(state, u_V, dt_s)
            return
        for h, target in self._segments(state.v, u_V, dt_s):
            piece = Glide(state, h, target, self.tau_eff_s)
            yield piece
            state = piece.at(h)._replace(v=0.0)  # there is a further segment only from rest

    def _segments(self, v: float, u_V: float, dt_s: float) -> list[tuple[float, float]]:
        """Cut ``dt_s`` at the reversal: (duration s, velocity that the segment tends to, rad/s).

        There is at most one reversal under constant drive. A velocity of 0 held by friction is a
        segment that tends to 0 from 0.
        """
        if dt_s <= 0.0:
            return []
        target = self._target(v, u_V)
        stop = reversal_time(v, target, self.tau_eff_s)
        if v == 0.0 or stop >= dt_s:
            return [(dt_s, target)]
        return [(stop, target), (dt_s - stop, self._target(0.0, u_V))]

    def _target(self, v: float, u_V: float) -> float:
        """Velocity that a closed form tends to from ``v`` until the next reversal, rad/s."""
        drive = u_V + self.bias_V
        direction = self._direction(v, drive)
        if direction > 0.0:
            return self.K_eff_rad_s_V * (drive - self.friction.plus_V)
        if direction < 0.0:
            return self.K_eff_rad_s_V * (drive + self.friction.minus_V)
        return 0.0

    def _direction(self, v: float, drive_V: float) -> float:
        """Direction of motion: that of ``v``, or into which the drive breaks away from rest; 0 if friction holds."""
        if v != 0.0:
            return math.copysign(1.0, v)
        if drive_V > self.friction.static_plus_V:
            return 1.0
        return -1.0 if drive_V < -self.friction.static_minus_V else 0.0

    def _arcs(self, state: State, u_V: float, dt_s: float) -> Iterator[Piece]:
        """Pieces under Stribeck friction: polynomials, and exponentials where its effect is below rounding."""
        f, tau, gain, unit = self.friction, self.tau_eff_s, self.K_eff_rad_s_V, self.friction.stribeck_rad_s
        drive = u_V + self.bias_V
        c, w = [0.0] * (stribeck.ORDER + 1), [0.0] * (stribeck.ORDER + 1)
        while dt_s > 0.0:
            sign = self._direction(state.v, drive)
            if sign == 0.0:
                yield Glide(state, dt_s, 0.0, tau)
                return
            moving, static = (f.plus_V, f.static_plus_V) if sign > 0.0 else (f.minus_V, f.static_minus_V)
            b = gain * (static - moving) / unit
            e = gain * (sign * drive - static) / unit
            x, target = abs(state.v) / unit, e + b
            far = stribeck.far_speed(b)
            piece: Piece
            if stribeck.is_exponential(x, target, b):
                # down to where the Stribeck effect begins, or to rest where this direction has none
                leaves_s = tau * math.log((x - target) / (far - target)) if target < far < x else math.inf
                piece = Glide(state, min(leaves_s, dt_s), sign * unit * target, tau)
                end = piece.at(piece.duration_s)
                if leaves_s <= dt_s:
                    end = end._replace(v=sign * unit * far)
            else:
                duration_s = min(tau * stribeck.expand(x, e, b, c, w), dt_s)
                rests = x > 0.0 and stribeck.speed_at(c, duration_s / tau) <= 0.0
                if rests:
                    duration_s = tau * stribeck.rest_within(c, duration_s / tau)
                piece = Arc(state, duration_s, tuple(c), sign * unit, tau, rests)
                end = piece.at(duration_s)
            yield piece
            dt_s -= piece.duration_s
            state = end

    def terminal_velocity(self, v: float, u_V: float) -> float:
        """Velocity in which the motion from ``v`` under constant ``u_V`` ends, rad/s; 0 if friction holds it there."""
        drive = u_V + self.bias_V
        direction = self._direction(v, drive)
        if direction == 0.0:
            return 0.0
        f, gain = self.friction, self.K_eff_rad_s_V
        moving, static = (f.plus_V, f.static_plus_V) if direction > 0.0 else (f.minus_V, f.static_minus_V)
        if f.stribeck_rad_s > 0.0 and static > moving:
            speed = stribeck.terminal_speed(
                abs(v) / f.stribeck_rad_s,
                gain * (direction * drive - static) / f.stribeck_rad_s,
                gain * (static - moving) / f.stribeck_rad_s,
            )
            speed *= f.stribeck_rad_s
        else:
            speed = max(gain * (direction * drive - moving), 0.0)
        if speed > 0.0 or v == 0.0:
            return direction * speed
        return self.terminal_velocity(0.0, u_V)

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
        if not self.has_closed_form:
            return self._response_by_pieces(start, t, edges, drive, first)
        keep = np.arange(first, edges.size)
        keep = keep[np.concatenate(([True], drive[keep[1:]] != drive[keep[:-1]]))]
        starts = np.maximum(edges[keep], t[0]).tolist()
        ends = [*starts[1:], max(float(t[-1]), starts[-1])]
        rows: list[tuple[float, float, float, float, float]] = []
        v, y, z = start
        tau = self.tau_eff_s
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

    def _response_by_pieces(self, start: State, t: Array, edges: Array, drive: Array, first: int) -> Array:
        out = np.empty((t.size, 3))
        state, k = start, 0
        for j in range(first, edges.size):
            begin = max(float(edges[j]), float(t[0]))
            end = float(edges[j + 1]) if j + 1 < edges.size else math.inf
            last = min(end, float(t[-1]))
            now = begin
            for piece in self.pieces(state, float(drive[j]), last - begin):
                until = now + piece.duration_s
                while k < t.size and t[k] < until:
                    out[k] = piece.at(float(t[k]) - now)
                    k += 1
                state, now = piece.at(piece.duration_s), until
            if last < end:
                break
        out[k:] = state  # samples at the very end
        return out


def reversal_time(v: float, target: float, tau_s: float) -> float:
    """Time until a velocity ``v`` that tends to ``target`` reaches zero, s; inf if it never does."""
    if v == 0.0:
        return 0.0
    if v < 0.0 < target or target < 0.0 < v:  # not by the sign of their product, which can round to 0
        return tau_s * math.log1p(-v / target)
    return math.inf


def _glide(v: float, y: float, z: float, target: float, tau: float, h: float) -> tuple[float, float, float]:
    """Closed form over ``h`` seconds of a velocity that tends to ``target`` (docs/theory.md 1.3)."""
    decay = -math.expm1(-h / tau)
    excess = v - target
    return (
        v - excess * decay,
        y + target * h + excess * tau * decay,
        z + y * h + 0.5 * target * h * h + excess * tau * (h - tau * decay),
    )
