"""Time stamps that are not those of their rows.

A logger may take the time of a line before, or after, it reads the position. Where rows are uneven, the stamps of
another row make the motion rough. So the plain motor explains pieces of the tests far better with the stamps that
belong to them. Or rows come evenly, and their stamps scatter, as those of a computer that receives them: at even times
the motion is smooth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.identification.estimate import Estimate
from rig.identification.in_pieces import plain_residual_rad
from rig.run_folder.recording.series import TimeSeries

LEAVES = 3.0  # residual over the sensor's noise from which on other stamps are tried
UNEVEN = 0.05  # scatter of the steps of time over a period: of more even rows nobody can tell, and it does not matter
CUTS = 0.5  # residual, noise of the sensor, or roughness, with other stamps over that with the own ones, at most
FROM_LINE = 8.0  # periods: no stamp of even rows is farther from where it belongs, nor of those that come in bunches


def stamps_off_by(tests: Sequence[TimeSeries], plain: Estimate) -> int:
    """By how many rows the stamps stand too late; -1: each row has that of the row before; 0 where none shows.

    Raises IdentifyError if the tests are too short for pieces.
    """
    noise_rad = math.sqrt(sum(test.noise_rad() ** 2 for test in tests) / len(tests))
    uneven = max(float(np.std(np.diff(test.t_s))) / test.period_s for test in tests)
    known = any(test.t_u_s is not None or test.edges is not None for test in tests)
    if known or not plain.is_motor or plain.rms_rad < LEAVES * noise_rad or uneven < UNEVEN:
        return 0
    own = plain_residual_rad(tests, plain)
    other = {rows: plain_residual_rad([with_stamps_of(test, rows) for test in tests], plain) for rows in (-1, 1)}
    best = min(other, key=lambda rows: other[rows])
    return best if other[best] < CUTS * own else 0


def with_stamps_of(test: TimeSeries, rows: int) -> TimeSeries:
    """The test with each stamp moved up by a row (-1) or down (1). The row that has none then is left out."""
    kept, stamps = (slice(0, -1), slice(1, None)) if rows < 0 else (slice(1, None), slice(0, -1))
    return replace(test, t_s=test.t_s[stamps], y_rad=test.y_rad[kept], u_V=test.u_V[kept], even_s=None)


def evened(test: TimeSeries) -> tuple[TimeSeries, list[str]]:
    """The test at even times, and a sentence, if its motion is far smoother there; else as it is."""
    if test.t_u_s is not None or test.edges is not None:
        return test, []
    rows = np.arange(len(test), dtype=np.float64)
    even_s = np.polynomial.Polynomial.fit(rows, test.t_s, 1)(rows)
    off_s, period_s = test.t_s - even_s, float(even_s[1] - even_s[0])
    even = replace(test, t_s=even_s)
    smooth = even.noise_rad() <= CUTS * test.noise_rad() or _roughness(even) <= CUTS * _roughness(test)
    if np.abs(off_s).max() > FROM_LINE * period_s or not smooth:
        return test, []
    said = (
        f"{test.name}: the time stamps scatter by {1e3 * float(np.std(off_s)):.2g} ms about even times, "
        f"{1e3 * period_s:.4g} ms apart, and the motion does not: it is taken at even times"
    )
    return even, [said]


def _roughness(test: TimeSeries) -> float:
    """By how much the speed changes from row to row, on average, rad/s: within a bunch of stamps a shaft would race."""
    return float(np.mean(np.abs(np.diff(np.diff(test.y_rad) / np.diff(test.t_s)))))
