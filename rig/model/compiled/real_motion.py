"""A real motor under recorded drives: what its sensor reads, and the derivatives (docs/theory.md 12.4)."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import byref
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array, Rows
from rig.core.motor_numbers import Numbers, RealMotor
from rig.model.library import (
    LIBRARY,
    RealColumns,
    RealRecord,
    RealWindow,
    address,
    given,
    require_size,
)

NUMBERS = len(RealMotor._fields)
V0, Y0 = NUMBERS, NUMBERS + 1  # columns of a piece's start, behind the numbers of the motor
WAVES = NUMBERS + 2  # columns of waves of the force, behind them
PLAIN = tuple(RealMotor._fields.index(name) for name in ("tau_s", "K_rad_s_V", "fc_V", "bias_V", "delay_s"))
_COLUMN_ROWS, _STAGE_ROWS = 12, 11  # REAL_COLUMN_ROWS, REAL_STAGE_ROWS


class Record(NamedTuple):
    """A record in pieces.

    edge_s, u_V  edges, s, and drives that act from them on, V; before the first edge the drive is that edge's
    t_s          times of the rows, s
    first        first rows of the pieces, increasing from 0 on
    frame        what parts over position and time refer to, as numbers
    """

    edge_s: Array
    u_V: Array
    t_s: Array
    first: Rows
    frame: Numbers


class Windows:
    """Records that are read in one call, one after the other. Raises ValueError on arrays that do not fit together."""

    def __init__(self, records: Sequence[Record]) -> None:
        self._kept = []  # the library reads them where they are
        self._table = (RealWindow * len(records))()
        longest = 0
        for window, one in zip(self._table, records, strict=True):
            edge_s, u_V, t_s = given(one.edge_s), given(one.u_V), given(one.t_s)
            first = np.ascontiguousarray(one.first, dtype=np.int64)
            require_size(u_V, max(edge_s.size, 1), "drives of the edges")
            ends = np.diff(np.append(first, t_s.size))
            if t_s.size == 0 or first.size == 0 or first[0] != 0 or np.any(ends <= 0):
                raise ValueError("pieces must begin in increasing rows, the first in row 0")
            longest = max(longest, int(ends.max()))
            self._kept.append((edge_s, u_V, t_s, first))
            at = (address(array) for array in (edge_s, u_V, t_s, first))
            window.record = RealRecord(*at, 0, edge_s.size, t_s.size, first.size)
            window.frame[:] = one.frame
        self.rows = sum(window.record.rows for window in self._table)
        self.pieces = sum(window.record.pieces for window in self._table)
        self._longest = longest

    def read(
        self, motor: Array, starts: Array, free: Sequence[int] | None, orders: Array, *, plain: bool
    ) -> tuple[Array, Array]:
        """The readings (n,), rad, and their Jacobian (n, c): by c - 2 numbers, and by the own piece's start.

        motor    its numbers, in a row
        starts   (p, 4): v0, rad/s, y0, rad, side of the play, -1 to 1, and how far the bristles are bent, -1 to 1; 0:
                 they balance the drive
        free     numbers (m,); None: no Jacobian, which has no columns then
        orders   (k,), 1/rad, of waves of the force that the motor has not: the sine and the cosine of each are further
                 numbers, c = m + 2 k + 2
        plain    whether the motor has no parts, nor are their numbers free: it has a closed form
        All are nan in a window in which the motor runs away, or is so stiff that it takes too many steps.
        Raises ValueError on starts of another number of pieces, and on numbers that no motor has.
        """
        which = _places(None if free is None else tuple(free), orders.size, plain)
        begin, vector, waves = given(starts), given(motor), given(orders)
        require_size(begin, 4 * self.pieces, "starts of the pieces")
        require_size(vector, NUMBERS, "numbers of a motor")
        columns = which.size
        size = 7 * self._longest if plain else _COLUMN_ROWS * columns + _STAGE_ROWS * (WAVES + 2 * orders.size)
        work, y_rad, jacobian = np.empty(size), np.empty(self.rows), np.empty((self.rows, columns))
        wanted = RealColumns(address(which), address(waves), address(work), columns, orders.size)
        read = LIBRARY.windows_plain if plain else LIBRARY.windows_readings
        into = address(y_rad), address(jacobian)
        read(address(vector), self._table, len(self._table), address(begin), byref(wanted), *into)
        return y_rad, jacobian


@lru_cache(maxsize=512)
def _places(free: tuple[int, ...] | None, orders: int, plain: bool) -> Rows:
    """Columns of the Jacobian, as the library has them. Raises ValueError on numbers that no motor has."""
    if free is None:
        return np.zeros(0, dtype=np.int64)
    if free and not 0 <= min(free) <= max(free) < NUMBERS:
        raise ValueError("a number that no motor has")
    if plain:
        return np.array([*(PLAIN.index(k) for k in free), len(PLAIN), len(PLAIN) + 1], dtype=np.int64)
    return np.array([*free, *range(WAVES, WAVES + 2 * orders), V0, Y0], dtype=np.int64)
