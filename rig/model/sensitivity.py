"""The exact motion together with its derivatives by the motor's parameters.

Between events the motion has a closed form (theory section 1), and so have its derivatives. An event moves when a
parameter does: by the same instant dt at which it moves, the velocity jumps by (acceleration before - acceleration
after) * dt to first order, and the position does not. So one pass over the events gives position and Jacobian.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Theta(NamedTuple):
    """Parameters of a series' motion (theory section 8), in the order of the Jacobian's columns.

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


def position(theta: Theta, edge_s: Array, u_V: Array, t_s: Array, static_V: float | None = None) -> Array:
    """Positions at the times ``t_s``, rad, without the derivatives; arguments as ``position_and_jacobian``."""
    from rig.model.compiled import motion

    y = np.empty(t_s.size)
    motion.position(_floats(theta), _level(theta, static_V), edge_s, u_V, t_s, y)
    return y


def position_and_jacobian(
    theta: Theta, edge_s: Array, u_V: Array, t_s: Array, static_V: float | None = None
) -> tuple[Array, Array]:
    """Positions at the times ``t_s`` and their derivatives by each of ``Theta``.

    edge_s, u_V  m steps of the drive: u_V[j], V, acts from edge_s[j] on, s, non-decreasing, m >= 1
    t_s       n times, s, non-decreasing, n >= 1
    static_V  level that holds the motor at rest, V; default: as strong as in motion
    Returns y, (n,), rad, and dy/dtheta, (n, 7). The drive before its first edge is that of its first edge. Derivatives
    are exact but where a parameter decides *whether* the motor sticks.
    """
    from rig.model.compiled import motion

    y, jacobian = np.empty(t_s.size), np.empty((t_s.size, 7))
    motion.position_and_jacobian(_floats(theta), _level(theta, static_V), edge_s, u_V, t_s, y, jacobian)
    return y, jacobian


def _floats(theta: Theta) -> tuple[float, float, float, float, float, float, float]:
    tau, K, fc, asym, delay, v0, y0 = theta
    return float(tau), float(K), float(fc), float(asym), float(delay), float(v0), float(y0)


def _level(theta: Theta, static_V: float | None) -> float:
    return float(theta.fc_V if static_V is None else max(static_V, theta.fc_V))
