"""The readings of one record in pieces, each with its own start, by a real motor; and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.model.real_motor import Frame, Readings, RealMotor, readings_of, windows_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pieces:
    """A record in p pieces, each with its own start. The drive before a piece decides how its lag starts.

    first_row     first sample of each piece, (p,), increasing from 0 on
    v0_rad_per_s  velocity there, (p,)
    y0_rad        position there, (p,), behind the backlash and before the sensor's linearity
    side          where the play stands, (p,), -1 to 1: 1 after a motion towards +y; default: in its middle
    bent          how far the bristles are bent, (p,), -1 to 1: 1 in a motion towards +y; 0 (default): they balance the
                  drive, as in a motor at rest
    Raises ValueError on arrays of other shapes.
    """

    first_row: NDArray[np.int64]
    v0_rad_per_s: Array
    y0_rad: Array
    side: Array | None = None
    bent: Array | None = None

    def __post_init__(self) -> None:
        given = (self.v0_rad_per_s, self.y0_rad, self.side, self.bent)
        if any(a is not None and a.shape != self.first_row.shape for a in given) or self.first_row.ndim != 1:
            raise ValueError("all arrays of the pieces need one entry for each piece")
        if self.first_row.size == 0 or self.first_row[0] != 0 or np.any(np.diff(self.first_row) <= 0):
            raise ValueError("first_row must increase from 0 on")

    @classmethod
    def one(cls, v0_rad_per_s: float = 0.0, y0_rad: float = 0.0) -> Pieces:
        """The whole record as one piece. Velocity, rad/s, and position, rad, are those at its first sample."""
        sign = float(np.sign(v0_rad_per_s))
        v0, y0, side = np.array([v0_rad_per_s]), np.array([y0_rad]), np.array([sign])
        return cls(np.zeros(1, dtype=np.int64), v0.astype(float), y0.astype(float), side, side)


def response(motor: RealMotor, frame: Frame, drive: tuple[Array, Array], t_s: Array, pieces: Pieces) -> Array:
    """Readings of the sensor at the times ``t_s`` (n, s, increasing, n >= 1), (n,), rad.

    drive   m edges, s, non-decreasing, and m drives, V, each from its edge on, m >= 1. Before the first edge the drive
            is the first one.
    All are nan for a motor that runs away, to more than 1e5 rad/s.
    Raises ValueError on numbers out of range.
    """
    return response_and_jacobian(motor, frame, drive, t_s, pieces, None).y_rad


def response_and_jacobian(
    motor: RealMotor,
    frame: Frame,
    drive: tuple[Array, Array],
    t_s: Array,
    pieces: Pieces,
    free: Sequence[int] | None,
    waves_per_rad: Sequence[float] = (),
) -> Readings:
    """``response``, with derivatives by the numbers at the places ``free`` (see ``index``), and by each piece's start.

    free            None: no derivatives
    waves_per_rad   orders, > 0, of forces over position: derivatives by the sine and the cosine of each, V, follow
                    those by ``free``. All orders cost about as much as one. Of a motor without cogging only
    Derivatives are exact, except where a number decides *whether* the motor sticks. A part may be at 0 and free, except
    the bristles; the Stribeck effect and cogging then need their velocity and order.
    Raises ValueError on numbers out of range, and on waves beside cogging.
    """
    starts = np.zeros((pieces.first_row.size, 4))
    starts[:, 0], starts[:, 1] = pieces.v0_rad_per_s, pieces.y0_rad
    if pieces.side is not None:
        starts[:, 2] = pieces.side
    if pieces.bent is not None:
        starts[:, 3] = pieces.bent
    return readings_of(motor, windows_of([(frame, drive, t_s, pieces.first_row)]), starts, free, waves_per_rad)
