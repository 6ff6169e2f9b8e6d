"""A simulated relay test: the exact motor under a dual-channel relay that decides at each sample."""

from __future__ import annotations

from ctypes import byref
from dataclasses import dataclass

import numpy as np

from rig.core.arrays import Array
from rig.model.library import LIBRARY, RelayPlan, address, given, numbers, require_size
from rig.model.motor import Motor, State


@dataclass(frozen=True)
class SimulatedRelayTest:
    """The recorded columns and the true states, n rows each.

    t_s, t_u_s       times of the samples, and times from which each row's drive acted, s
    y_rad, u_V       position as read, and drive
    z_rad_s          integral of the position as read
    true_v_rad_s, true_y_rad    the motor's own state at the samples
    """

    t_s: Array
    t_u_s: Array
    y_rad: Array
    u_V: Array
    z_rad_s: Array
    true_v_rad_s: Array
    true_y_rad: Array


@dataclass(frozen=True)
class Disturbance:
    """Noise and disturbances of a relay test; none by default.

    reading_rad   n values added to the position before it is read: noise and offset, rad
    drive_V       n values added to the drive at the motor during the tick, not recorded, V
    lsb_rad       step of the reading, rad; 0 for none
    """

    reading_rad: Array | None = None
    drive_V: Array | None = None
    lsb_rad: float = 0.0


UNDISTURBED = Disturbance()


def relay_test(
    motor: Motor,
    h1_V: float,
    h2_V: float,
    t_s: Array,
    latency_s: float | Array,
    *,
    disturbance: Disturbance = UNDISTURBED,
    start: State | None = None,
) -> SimulatedRelayTest:
    """Simulate ``u = -h1 sgn(y) - h2 sgn(z)``, decided at each sample and acting a latency later.

    t_s          n times of the samples, s, increasing
    latency_s    from each sample until its drive acts, s, >= 0; no drive may overtake the one before it
    disturbance  noise, offset, disturbing drive and the step of the reading
    start        state at the first sample; default: at rest at 0
    The law is ``rig.control.relay.DualChannelRelay``. Raises ValueError outside these ranges, and for a motor with
    Stribeck effect.
    """
    t = np.ascontiguousarray(t_s, dtype=float)
    t_u = t + np.broadcast_to(np.asarray(latency_s, dtype=float), t.shape)
    if t.ndim != 1 or t.size == 0 or np.any(np.diff(t) <= 0.0):
        raise ValueError("t_s must be one-dimensional and increase")
    if np.any(t_u < t) or np.any(np.diff(t_u) < 0.0):
        raise ValueError("latencies must be >= 0 s, and drives must take effect in their order")
    if not motor.has_closed_form:
        raise ValueError("the compiled relay test needs a motor without Stribeck effect")
    first = start or State()
    added = [np.zeros(t.size) if one is None else given(one) for one in (disturbance.reading_rad, disturbance.drive_V)]
    for one in added:
        require_size(one, t.size, "disturbances of a relay test")
    plan = RelayPlan(*map(address, (t, t_u, *added)), h1_V, h2_V, disturbance.lsb_rad, t.size)
    out = np.empty((t.size, 5))
    LIBRARY.relay_test(numbers(*motor.plant), byref(plan), numbers(first.v, first.y, 0.0), address(out))
    y, u, z, v, true_y = (np.ascontiguousarray(column) for column in out.T)
    return SimulatedRelayTest(t, t_u, y, u, z, v, true_y)
