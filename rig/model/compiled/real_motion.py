"""A real motor under a recorded drive: what its sensor reads, and the derivatives (docs/theory.md 12.4)."""

from __future__ import annotations

from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from rig.model.library import LIBRARY, RealColumns, RealRecord, address, filled, given, numbers, require_size, room
from rig.model.real_step import Numbers, RealMotor

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

NUMBERS = len(RealMotor._fields)
V0, Y0 = NUMBERS, NUMBERS + 1  # columns of a piece's start, behind the numbers of the motor
WAVES = NUMBERS + 2  # columns of waves of the force, behind them
_STAGE_ROWS = 11  # REAL_STAGE_ROWS


def readings(
    motor: tuple[Numbers, Numbers],
    drive: tuple[Array, Array],
    t_s: Array,
    pieces: tuple[Rows, Array],
    free: tuple[Rows, Array],
    out: tuple[Array, Array],
) -> None:
    """Fill the readings (n,) and their Jacobian (n, c): by the c - 2 numbers ``free``, and by the own piece's start.

    motor     its numbers, and those of its frame
    drive     edges, s, and drives that act from them on, V; before the first edge the drive is that edge's
    pieces    first rows (p,), increasing from 0 on, and starts (p, 4): v0, rad/s, y0, rad, side of the play, -1 to 1,
              and how far the bristles are bent, -1 to 1; 0: they balance the drive
    free      numbers (m,), and orders (k,), 1/rad, of waves of the force that the motor has not: the sine and the
              cosine of each are further numbers, c = m + 2 k + 2
    out       readings, rad, and Jacobian. One of no columns: it is left out. All nan for a motor that runs away,
              or that is so stiff that it takes too many steps
    Raises ValueError on arrays that do not fit together.
    """
    edge_s, u_V, t, starts = given(drive[0]), given(drive[1]), given(t_s), given(pieces[1])
    first, orders = np.ascontiguousarray(pieces[0], dtype=np.int64), given(free[1])
    require_size(u_V, max(edge_s.size, 1), "drives of the edges")
    require_size(starts, 4 * first.size, "starts of the pieces")
    if t.size == 0 or first.size == 0 or first[0] != 0 or first[-1] >= t.size or np.any(np.diff(first) <= 0):
        raise ValueError("pieces must begin in increasing rows, the first in row 0")
    columns = out[1].shape[1]
    which = np.empty(columns, dtype=np.int64)
    if columns:
        waves = np.arange(WAVES, WAVES + 2 * orders.size)
        which[:] = np.concatenate([np.asarray(free[0], dtype=np.int64), waves, (V0, Y0)])
        if which.min() < 0 or max(free[0], default=0) >= NUMBERS:
            raise ValueError("a number that no motor has")
    work = room(4 * columns + _STAGE_ROWS * (WAVES + 2 * orders.size))
    record = RealRecord(*(address(one) for one in (edge_s, u_V, t, first, starts)), edge_s.size, t.size, first.size)
    wanted = RealColumns(*(address(one) for one in (which, orders, work)), columns, orders.size)
    into = filled(out[0], t.size), filled(out[1], t.size, columns)
    LIBRARY.real_readings(numbers(*motor[0], *motor[1]), byref(record), byref(wanted), *into)
