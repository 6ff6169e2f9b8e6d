"""The exact motion under a recorded drive, and its derivatives by the motor's parameters.

Between events the motion has a closed form, and so have its derivatives (docs/theory.md 1.3, 1.4). When a parameter
changes, an event moves by a time dt. To first order this changes the velocity by (acceleration before - acceleration
after) * dt, and leaves the position as it is. So one pass over the events gives position and Jacobian.
"""

from __future__ import annotations

from typing import NamedTuple

from rig.core.arrays import Array
from rig.model.compiled import motion
from rig.model.step import Numbers, Plant


class Theta(NamedTuple):
    """Parameters of a series' motion (docs/theory.md 7.2), in the order of the Jacobian's columns.

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


def position(theta: Theta, edge_s: Array, u_V: Array, t_s: Array) -> Array:
    """Positions at the times ``t_s``, rad. ``edge_s``, ``u_V``: as in ``position_and_jacobian``."""
    return motion.positions(*_motion(theta), (edge_s, u_V, float(theta.delay_s)), t_s)


def position_and_jacobian(theta: Theta, edge_s: Array, u_V: Array, t_s: Array) -> tuple[Array, Array]:
    """Positions at the times ``t_s`` and their derivatives by each of ``Theta``.

    edge_s, u_V  m steps of the drive: u_V[j], V, acts from edge_s[j] on, s, non-decreasing, m >= 1
    t_s       n times, s, non-decreasing, n >= 1
    Returns y, (n,), rad, and dy/dtheta, (n, 7). Before the first edge the drive is u_V[0]. Derivatives are exact,
    except where a parameter decides *whether* the motor sticks.
    """
    return motion.position_and_jacobian(*_motion(theta), (edge_s, u_V, float(theta.delay_s)), t_s)


def _motion(theta: Theta) -> tuple[Numbers, Numbers]:
    """Plant and state at the first sample, as plain numbers."""
    tau, K, fc, asym, _, v0, y0 = map(float, theta)
    return tuple(Plant(tau, K, fc, fc, fc, fc, 0.0, asym)), (v0, y0, 0.0)
