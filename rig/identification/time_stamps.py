"""Time stamps, or drives, of another row: a logger that takes the time a line before, or after, it reads the position.

Where rows are uneven, the stamps of another row make the motion rough. So the plain motor explains pieces of the tests
far better with the stamps that belong to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.identification.estimate import Estimate
from rig.identification.in_pieces import plain_residual_rad
from rig.identification.preprocessing import with_stamps_of
from rig.run_folder.recording.series import TimeSeries, noise_of_all_rad

LEAVES = 3.0  # residual over the sensor's noise from which on other stamps are tried
UNEVEN = 0.05  # scatter of the steps of time over a period: of more even rows nobody can tell, and it does not matter
CUTS = 0.5  # residual with the other stamps over that with the own ones, at most


def stamps_off_by(tests: Sequence[TimeSeries], plain: Estimate) -> int:
    """By how many rows the stamps stand too late; -1: each row has that of the row before; 0 where none shows.

    Raises IdentifyError if the tests are too short for pieces.
    """
    noise_rad = noise_of_all_rad(tests)
    uneven = max(float(np.std(np.diff(test.t_s))) / test.period_s for test in tests)
    known = any(test.t_u_s is not None or test.edges is not None for test in tests)
    if known or not plain.is_motor or plain.rms_rad < LEAVES * noise_rad or uneven < UNEVEN:
        return 0
    own = plain_residual_rad(tests, plain)
    other = {rows: plain_residual_rad([with_stamps_of(test, rows) for test in tests], plain) for rows in (-1, 1)}
    best = min(other, key=lambda rows: other[rows])
    return best if other[best] < CUTS * own else 0


def stamps_by_motion(tests: Sequence[TimeSeries]) -> int:
    """The same as ``stamps_off_by`` by the motion alone, where that is far smoother with the stamps of other rows."""
    if any(test.t_u_s is not None or test.edges is not None for test in tests):
        return 0
    if max(float(np.std(np.diff(test.t_s))) / test.period_s for test in tests) < UNEVEN:
        return 0
    own = noise_of_all_rad(tests)
    other = {rows: noise_of_all_rad([with_stamps_of(test, rows) for test in tests]) for rows in (-1, 1)}
    best = min(other, key=lambda rows: other[rows])
    return best if other[best] < CUTS * own else 0


def drives_stand_late(tests: Sequence[TimeSeries], plain: Estimate) -> bool:
    """Whether the drives belong more than a row up: moved by a row, they explain pieces of the tests far better.

    Raises IdentifyError if the tests are too short for pieces.
    """
    moved = [
        replace(test, t_s=test.t_s[:-1], y_rad=test.y_rad[:-1], u_V=test.u_V[1:], even_s=None)
        for test in tests
        if test.t_u_s is None and test.edges is None
    ]
    return len(moved) == len(tests) and plain_residual_rad(moved, plain) < CUTS * plain_residual_rad(tests, plain)
