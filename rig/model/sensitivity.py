"""The exact motion together with its derivatives by the motor's parameters.

Between events the motion has a closed form (theory section 1), and so have its derivatives. An event moves when a
parameter does: by the same instant dt at which it moves, the velocity jumps by (acceleration before - acceleration
after) * dt to first order, and the position does not. So one pass over the events gives position and Jacobian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.model.motor import reversal_time

Array = NDArray[np.float64]


class Theta(NamedTuple):
    """Parameters of a record's motion (theory section 8), in the order of the Jacobian's columns.

    tau_s, K_rad_s_V, fc_V   the motor
    asym_V                   asymmetry a: the effective drive in motion is u + a - fc sgn(v)
    delay_s                  by which the drive acts later than its edges say
    v0_rad_per_s, y0_rad     state at the first sample
    """

    tau_s: float
    K_rad_s_V: float
    fc_V: float
    asym_V: float = 0.0
    delay_s: float = 0.0
    v0_rad_per_s: float = 0.0
    y0_rad: float = 0.0


@dataclass(frozen=True)
class Drive:
    """A drive that is constant between edges: ``u_V[j]`` acts from ``edge_s[j]`` on, s, V, m of each."""

    edge_s: tuple[float, ...]
    u_V: tuple[float, ...]

    @classmethod
    def from_arrays(cls, edge_s: Array, u_V: Array) -> Drive:
        """From arrays of edges (non-decreasing) and drives; edges that change nothing are dropped.

        Raises ValueError if the edges decrease, or shapes differ, or there is none.
        """
        if edge_s.shape != u_V.shape or edge_s.ndim != 1 or edge_s.size == 0:
            raise ValueError("edges and drives must be one-dimensional and of one length")
        if np.any(np.diff(edge_s) < 0.0):
            raise ValueError("the times at which the drive acts must not decrease")
        keep = np.concatenate(([True], u_V[1:] != u_V[:-1]))
        return cls(tuple(edge_s[keep].tolist()), tuple(u_V[keep].tolist()))


def position(theta: Theta, drive: Drive, t_s: Array) -> Array:
    """Positions at the times ``t_s`` (n, non-decreasing), rad, without the derivatives."""
    return position_and_jacobian(theta, drive, t_s)[0]


def position_and_jacobian(theta: Theta, drive: Drive, t_s: Array) -> tuple[Array, Array]:
    """Positions at the times ``t_s`` and their derivatives by each of ``Theta``.

    t_s   n times, s, non-decreasing, n >= 1
    Returns y, (n,), rad, and dy/dtheta, (n, 7). Coulomb friction, as strong at rest as in motion. The drive before its
    first edge is that of its first edge. Derivatives are exact but where a parameter decides *whether* the motor
    sticks.
    """
    tau, K, fc, asym, delay, v0, y0 = theta
    first, last = float(t_s[0]), float(t_s[-1])
    edges = [edge + delay for edge in drive.edge_s]
    j = 0
    while j + 1 < len(edges) and edges[j + 1] <= first:
        j += 1
    # One row a segment: begin, v, y, velocity it tends to, its derivatives by (fc, asym), then those of v and y at the
    # segment's begin by (tau, fc, asym, delay, v0).
    rows: list[tuple[float, ...]] = []
    now, v, y = first, v0, y0
    vt = vf = va = vd = 0.0
    v_0 = 1.0
    yt = yf = ya = yd = y_0 = 0.0
    target, sign = _target(v, drive.u_V[j] + asym, fc, K)
    while True:
        j += 1
        end = edges[j] if j < len(edges) else math.inf
        while True:
            reversal = now + reversal_time(v, target, tau) if v != 0.0 else math.inf
            reverses = reversal < end
            until = reversal if reverses else end
            tf, ta = (-K * sign, K) if sign else (0.0, 0.0)
            rows.append((now, v, y, target, tf, ta, vt, vf, va, vd, v_0, yt, yf, ya, yd, y_0))
            if until >= last:
                return _evaluate(rows, theta, t_s)
            h = until - now
            decay = -math.expm1(-h / tau)
            keep = 1.0 - decay
            glide, drift = tau * decay, h - tau * decay
            excess = v - target
            yt += vt * glide + excess * (decay - h / tau * keep)
            yf += vf * glide + tf * drift
            ya += va * glide + ta * drift
            yd += vd * glide
            y_0 += v_0 * glide
            vt = vt * keep + excess * keep * h / (tau * tau)
            vf = vf * keep + tf * decay
            va = va * keep + ta * decay
            vd *= keep
            v_0 *= keep
            y += target * h + excess * glide
            v = target + excess * keep
            now = until
            if not reverses:
                break
            v = 0.0
            before = target
            target, sign = _target(0.0, drive.u_V[j - 1] + asym, fc, K)
            jump = target / before
            vt, vf, va, vd, v_0 = vt * jump, vf * jump, va * jump, vd * jump, v_0 * jump
        before = target
        target, sign = _target(v, drive.u_V[j] + asym, fc, K)
        vd += (before - target) / tau


def _target(v: float, u_V: float, fc_V: float, K: float) -> tuple[float, float]:
    """Velocity that the motion tends to, rad/s, and the direction of motion (0: held by friction)."""
    if v > 0.0 or (v == 0.0 and u_V > fc_V):
        return K * (u_V - fc_V), 1.0
    if v < 0.0 or u_V < -fc_V:
        return K * (u_V + fc_V), -1.0
    return 0.0, 0.0


def _evaluate(rows: list[tuple[float, ...]], theta: Theta, t_s: Array) -> tuple[Array, Array]:
    table = np.array(rows)
    row = table[np.searchsorted(table[:, 0], t_s, side="right") - 1].T
    tau, K = theta.tau_s, theta.K_rad_s_V
    h = t_s - row[0]
    decay = -np.expm1(-h / tau)
    glide = tau * decay
    drift = h - glide
    excess = row[1] - row[3]
    y = row[2] + row[3] * h + excess * glide
    jacobian = np.empty((t_s.size, 7))
    jacobian[:, 0] = row[11] + row[6] * glide + excess * (decay - h / tau * (1.0 - decay))
    jacobian[:, 2] = row[12] + row[7] * glide + row[4] * drift
    jacobian[:, 3] = row[13] + row[8] * glide + row[5] * drift
    jacobian[:, 4] = row[14] + row[9] * glide
    jacobian[:, 5] = row[15] + row[10] * glide
    jacobian[:, 6] = 1.0
    # The motion is linear in K at a given v0 / K.
    jacobian[:, 1] = (y - theta.y0_rad - theta.v0_rad_per_s * jacobian[:, 5]) / K
    return y, jacobian
