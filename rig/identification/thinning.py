"""Several rows of a long test as one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.run_folder.recording.series import TimeSeries, steps_of

COARSEST_PATH_RAD = 1.0  # from one sample to the next: of a law over the angle
OF_COARSEST = 0.8  # mean way of several rows as one, at most, of that beyond which no law over the angle is looked for


def showing_the_angle(test: TimeSeries, rows: int) -> int:
    """How many rows at a time may be one, at most ``rows``: rows that show a law over the angle still do.

    A quick shaft turns so far in a few rows that nobody would look for a force over its angle any more.
    """
    path_rad = float(np.mean(np.abs(np.diff(test.y_rad))))
    if not 0.0 < path_rad < COARSEST_PATH_RAD:
        return rows
    return max(min(rows, int(OF_COARSEST * COARSEST_PATH_RAD / path_rad)), 1)


def thinned(test: TimeSeries, rows: int, of_drive: int = 0) -> TimeSeries:
    """The test with so many rows at a time as one: their first position, and their mean drive.

    of_drive   so many rows at a time have their mean as drive, where that are fewer than ``rows``; 0: ``rows``
    A drive with fewer edges than rows that are left keeps each of them where it was. A relay's does: the mean of its
    two levels is a small drive that no motor had, and a dead band would explain it. A motor takes the mean of a drive
    that changes within a small part of its tau; but it breaks away by the drive that it has.
    """
    if rows < 2:
        return test
    first = np.arange(0, len(test) - rows + 1, rows)
    edges = None
    if test.steps.edge_s.size <= first.size:
        edges = test.steps
    elif 0 < of_drive < rows:
        finer = np.arange(0, len(test), of_drive)
        edges = steps_of(test.edge_s[finer], _mean_V(test, finer))
    return replace(
        test,
        t_s=test.t_s[first],
        y_rad=test.y_rad[first],
        t_u_s=None if test.t_u_s is None else test.t_u_s[first],
        even_s=None if test.even_s is None else test.even_s[first],
        u_V=_mean_V(test, first),
        edges=edges,
    )


def _mean_V(test: TimeSeries, first: NDArray[np.int64]) -> NDArray[np.float64]:
    """Mean drive from each of these rows to the next of them, V."""
    ends_s = np.append(test.edge_s[first], test.edge_s[-1] + test.period_s)
    whole = np.diff(ends_s)
    return np.asarray(np.diff(test.steps.area_V_s(ends_s)) / np.where(whole > 0.0, whole, 1.0))
