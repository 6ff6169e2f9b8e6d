"""What a law predicts of a record: pieces with starts of their own, the record from its start, the closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emps.record import LARGEST_V, Record
from rig.model.real_motor import Frame, MovingMotor, RealMotor
from shared.pieces import Pieces, response, response_and_jacobian

Array = NDArray[np.float64]

START_S = 0.1  # of a piece: the part that shows its start
ROUNDS = 6  # of Newton's method for a start
CORE = ("tau_s", "K_rad_s_V", "fc_V")


@dataclass(frozen=True)
class Law:
    """A motor with its parts, and what they refer to."""

    motor: RealMotor
    frame: Frame


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def in_pieces(law: Law, record: Record, rows: Sequence[int]) -> Array:
    """Predicted less recorded position, m, (n,), in pieces from ``rows`` on.

    The first 0.1 s of a piece says where it starts, and how fast.
    """
    series, first = record.series, np.array(rows, dtype=np.int64)
    shown = round(START_S / series.period_s)
    y0 = series.y_rad[first]
    v0 = (series.y_rad[first + shown] - y0) / START_S
    top = float(np.abs(v0).max())
    for _ in range(ROUNDS):
        found = response_and_jacobian(law.motor, law.frame, series.steps, series.t_s, _pieces(first, v0, y0, top), ())
        for k, row in enumerate(rows):
            seen = slice(row, row + shown)
            missing = series.y_rad[seen] - found.y_rad[seen]
            change = np.linalg.lstsq(found.by_start[seen], missing, rcond=None)[0]
            v0[k], y0[k] = v0[k] + change[0], y0[k] + change[1]
    pieces = _pieces(first, v0, y0, top)
    return response(law.motor, law.frame, series.steps, series.t_s, pieces) - series.y_rad


def _pieces(first: NDArray[np.int64], v0: Array, y0: Array, top: float) -> Pieces:
    moving = np.where(np.abs(v0) > 0.02 * top, np.sign(v0), 0.0)
    return Pieces(first, v0.copy(), y0.copy(), np.sign(v0), moving)


def free_run(law: Law, record: Record) -> Array:
    """Predicted less recorded position, m, (n,): after the first 0.1 s by the recorded drive alone, to the end."""
    return in_pieces(law, record, [0])


def moved_by(law: Law, record: Record, share: float) -> dict[str, float]:
    """How far, RMS in m, the free run moves if tau, K or fc is ``share`` larger, or smaller: the less of both."""
    base = free_run(law, record)
    moves = {}
    for name in CORE:
        sizes = (getattr(law.motor, name) * (1.0 + sign * share) for sign in (1.0, -1.0))
        others = (Law(law.motor._replace(**{name: size}), law.frame) for size in sizes)
        moves[name] = min(rms(free_run(other, record) - base) for other in others)
    return moves


def closed_loop(law: Law, record: Record) -> tuple[Array, Array]:
    """Position, m, and drive, V, (n,), of the law under the record's controller, which follows the same reference."""
    series, dt_s = record.series, record.series.period_s
    motor = MovingMotor(law.motor, law.frame, float(series.y_rad[0]))
    y, u_V = np.empty(len(series)), np.empty(len(series))
    for k, t_s in enumerate(series.t_s.tolist()):
        y[k] = motor.state.y
        asked = record.kp_1_s * record.kv_V_s_m * (record.reference_m[k] - y[k]) - record.kv_V_s_m * motor.state.v
        u_V[k] = min(max(asked, -LARGEST_V), LARGEST_V)
        motor.advance(float(u_V[k]), t_s, dt_s)
    return y, u_V
