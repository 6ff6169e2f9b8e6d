"""The exact motion under a recorded drive, sample by sample: its states, and its positions with their derivatives."""

from __future__ import annotations

from ctypes import byref
from typing import Any

import numpy as np

from rig.core.arrays import Array
from rig.model.library import LIBRARY, PlainDrive, address, given, numbers, require_size
from rig.model.step import Numbers

Drive = tuple[Array, Array, float]  # edges, s, the drives that act from them on, V, and by how much later all do, s


def states(motor: Numbers, start: Numbers, drive: Drive, t_s: Array) -> Array:
    """v, y, z at the times ``t_s`` (n, s, non-decreasing), (n, 3).

    motor   numbers of a ``Plant``
    start   state at the first sample
    Before its first edge the drive is the drive of that edge.
    """
    return _followed(LIBRARY.plain_states, motor, start, drive, t_s, 3)[0]


def positions(motor: Numbers, start: Numbers, drive: Drive, t_s: Array) -> Array:
    """Positions, (n,), as ``states``."""
    return _followed(LIBRARY.plain_positions, motor, start, drive, t_s, 1)[0][:, 0]


def position_and_jacobian(motor: Numbers, start: Numbers, drive: Drive, t_s: Array) -> tuple[Array, Array]:
    """Positions, (n,), and their derivatives, (n, 7), by tau, K, fc, asym, delay, v0, y0; no Stribeck effect.

    fc is the plant's level in both directions, and asym its bias. The rest as in ``states``.
    """
    y_rad, jacobian = _followed(LIBRARY.plain_jacobian, motor, start, drive, t_s, 1, 7)
    return y_rad[:, 0], jacobian


def _followed(follow: Any, motor: Numbers, start: Numbers, drive: Drive, t_s: Array, *widths: int) -> list[Array]:
    """What a function of the library fills, an array of each width. Raises ValueError where a drive is missing."""
    t, edge_s, u_V = given(t_s), given(drive[0]), given(drive[1])
    require_size(u_V, max(edge_s.size, 1), "drives of the edges")
    found = [np.empty((t.size, width)) for width in widths]
    if t.size:
        acts = PlainDrive(address(edge_s), address(u_V), edge_s.size, drive[2])
        follow(numbers(*motor), numbers(*start), byref(acts), address(t), t.size, *map(address, found))
    return found
