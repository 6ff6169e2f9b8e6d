"""The exact motion under a recorded drive, sample by sample: its states, and its positions with their derivatives."""

from __future__ import annotations

from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from rig.model.library import LIBRARY, PlainDrive, address, filled, given, numbers, require_size
from rig.model.step import Numbers

Array = NDArray[np.float64]
Drive = tuple[Array, Array, float]  # edges, s, the drives that act from them on, V, and by how much later all do, s


def response(motor: Numbers, start: Numbers, drive: Drive, t_s: Array, out: Array) -> None:
    """Fill ``out`` at the times ``t_s`` (n, s, non-decreasing): positions, (n,), or v, y, z, (n, 3).

    motor   numbers of a ``Plant``
    start   state at the first sample
    Before its first edge the drive is the drive of that edge.
    """
    t, edge_s, u_V = _series(drive, t_s)
    whole = out.ndim == 2
    into = filled(out, *((t.size, 3) if whole else (t.size,)))
    if t.size:
        acts = PlainDrive(address(edge_s), address(u_V), edge_s.size, drive[2])
        follow = LIBRARY.plain_states if whole else LIBRARY.plain_positions
        follow(numbers(*motor), numbers(*start), byref(acts), address(t), t.size, into)


def position_and_jacobian(
    motor: Numbers, start: Numbers, drive: Drive, t_s: Array, y_rad: Array, jacobian: Array
) -> None:
    """Fill ``y_rad`` (n,) and ``jacobian`` (n, 7), by tau, K, fc, asym, delay, v0, y0; no Stribeck effect.

    fc is the plant's level in both directions, and asym its bias.
    """
    t, edge_s, u_V = _series(drive, t_s)
    into = filled(y_rad, t.size), filled(jacobian, t.size, 7)
    if t.size:
        acts = PlainDrive(address(edge_s), address(u_V), edge_s.size, drive[2])
        LIBRARY.plain_jacobian(numbers(*motor), numbers(*start), byref(acts), address(t), t.size, *into)


def _series(drive: Drive, t_s: Array) -> tuple[Array, Array, Array]:
    """Times, edges and drives. Raises ValueError where a drive is missing."""
    edge_s, u_V = given(drive[0]), given(drive[1])
    require_size(u_V, max(edge_s.size, 1), "drives of the edges")
    return given(t_s), edge_s, u_V
