"""The exact motion under a recorded drive, and its derivatives by the motor's parameters.

Between events the motion has a closed form, and so have its derivatives (docs/theory.md 1.3, 1.4). When a parameter
changes, an event moves by a time dt. To first order this changes the velocity by (acceleration before - acceleration
after) * dt, and leaves the position as it is. So one pass over the events gives position and Jacobian.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.model.step import Numbers, Plant

Array = NDArray[np.float64]


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


class StribeckTheta(NamedTuple):
    """Parameters of a series' motion under Tustin's law: all of ``Theta``, and two more.

    tau_s, K_rad_s_V, fc_V   the motor; viscous friction is in tau and K
    asym_V                   asymmetry a: the effective drive is u + a
    delay_s                  by which the drive acts later than its edges say
    v0_rad_per_s, y0_rad     state at the first sample
    fs_V, stribeck_rad_s     static level, V, >= fc, and the velocity over which it falls to fc, rad/s, > 0
    """

    tau_s: float
    K_rad_s_V: float
    fc_V: float
    asym_V: float
    delay_s: float
    v0_rad_per_s: float
    y0_rad: float
    fs_V: float
    stribeck_rad_s: float


def position(theta: Theta, edge_s: Array, u_V: Array, t_s: Array, static_V: float | None = None) -> Array:
    """Positions at the times ``t_s``, rad. ``edge_s``, ``u_V``, ``static_V``: as in ``position_and_jacobian``."""
    from rig.model.compiled import motion

    y = np.empty(t_s.size)
    motion.response(*_motion(theta, static_V), (edge_s, u_V, float(theta.delay_s)), t_s, y)
    return y


def position_and_jacobian(
    theta: Theta, edge_s: Array, u_V: Array, t_s: Array, static_V: float | None = None
) -> tuple[Array, Array]:
    """Positions at the times ``t_s`` and their derivatives by each of ``Theta``.

    edge_s, u_V  m steps of the drive: u_V[j], V, acts from edge_s[j] on, s, non-decreasing, m >= 1
    t_s       n times, s, non-decreasing, n >= 1
    static_V  level that holds the motor at rest, V; default: the level in motion
    Returns y, (n,), rad, and dy/dtheta, (n, 7). Before the first edge the drive is u_V[0]. Derivatives are exact,
    except where a parameter decides *whether* the motor sticks.
    """
    from rig.model.compiled import motion

    y, jacobian = np.empty(t_s.size), np.empty((t_s.size, 7))
    motion.position_and_jacobian(*_motion(theta, static_V), (edge_s, u_V, float(theta.delay_s)), t_s, y, jacobian)
    return y, jacobian


def stribeck_response(theta: StribeckTheta, edge_s: Array, u_V: Array, t_s: Array) -> Array:
    """Positions at the times ``t_s`` (n, s, non-decreasing, n >= 1), rad; compiled.

    Before the first edge the drive is u_V[0]. Raises ValueError on parameters out of range.
    """
    from rig.model.compiled import motion

    tau, K, fc, asym, delay, v0, y0, fs, unit = map(float, theta)
    if not (all(map(math.isfinite, theta)) and min(tau, K, unit) > 0.0 and 0.0 <= fc <= fs):
        raise ValueError(f"need tau, K, the Stribeck velocity > 0 and 0 <= f_c <= f_s, all finite, not {theta}")
    y = np.empty(t_s.size)
    plant = Plant(tau, K, fc, fc, fs, fs, unit, asym)
    motion.response(tuple(plant), (v0, y0, 0.0), (edge_s, u_V, delay), t_s, y)
    return y


def _motion(theta: Theta, static_V: float | None) -> tuple[Numbers, Numbers]:
    """Plant and state at the first sample, as plain numbers."""
    tau, K, fc, asym, _, v0, y0 = map(float, theta)
    fs = fc if static_V is None else max(float(static_V), fc)
    return tuple(Plant(tau, K, fc, fc, fs, fs, 0.0, asym)), (v0, y0, 0.0)
