"""Several rows of a long test as one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.run_folder.recording.series import TimeSeries, steps_of

COARSEST_PATH_RAD = 1.0  # from one sample to the next: of a law over the angle
OF_COARSEST = 0.8  # mean way of several rows as one, at most, of that beyond which no law over the angle is looked for
OF_STEP = 0.25  # mean way from one kept row to the next, at most, of a step of the sensor
MOST_OF_STEP = 10  # rows that are taken as one for it
EVEN_DRIVE = 0.005  # of the largest drive: a drive that changes by less meanwhile acts as its mean


def showing_the_angle(test: TimeSeries, rows: int) -> int:
    """How many rows at a time may be one, at most ``rows``: rows that show a law over the angle still do.

    A quick shaft turns so far in a few rows that nobody would look for a force over its angle any more.
    """
    path_rad = float(np.mean(np.abs(np.diff(test.y_rad))))
    if not 0.0 < path_rad < COARSEST_PATH_RAD:
        return rows
    return max(min(rows, int(OF_COARSEST * COARSEST_PATH_RAD / path_rad)), 1)


def of_one_step(test: TimeSeries) -> int:
    """How many rows at a time show little more than one of them: the shaft moves on by a quarter of a coarse step.

    Rows within one step of the sensor have the same error of rounding, so they are not as many readings.
    """
    step_rad, rows = test.resolution_rad(), 1
    while rows < MOST_OF_STEP and float(np.mean(np.abs(np.diff(test.y_rad[:: rows + 1])))) <= OF_STEP * step_rad:
        rows += 1
    return rows


def thinned(test: TimeSeries, rows: int, of_drive: int = 0) -> TimeSeries:
    """The test with so many rows at a time as one: their first position, and their mean drive.

    of_drive   so many rows at a time have their mean as drive, where that are fewer than ``rows``; more have it where
               it hardly changes; 0: ``rows``
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
        finer = _where_it_changes(test.u_V, np.arange(0, len(test), of_drive), rows)
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


def _where_it_changes(u_V: NDArray[np.float64], first: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Those of the rows ``first`` from which on the drive is another, or that are ``most`` rows after the last one."""
    bound_V = EVEN_DRIVE * float(np.abs(u_V).max())
    kept, low_V, high_V = [0], math.inf, -math.inf
    for row, stop in zip(first.tolist(), [*first[1:].tolist(), u_V.size], strict=True):
        least_V, largest_V = float(u_V[row:stop].min()), float(u_V[row:stop].max())
        low_V, high_V = min(low_V, least_V), max(high_V, largest_V)
        if stop - kept[-1] > most or high_V - low_V > bound_V:
            if row > 0:
                kept.append(row)
            low_V, high_V = least_V, largest_V
    return np.array(kept)
