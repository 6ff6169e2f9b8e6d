"""Where a record shows motion, and which motions begin at rest (docs/theory.md 7.11).

A shaft at rest shows that friction holds the drive, and nothing else: neither tau nor K, and of friction only that its
static level is above the drive. A plain motor whose moving friction is below the static one would move there. So rows
at rest are not fitted, but for a few beside each motion, in which the drive is far below friction: they show where the
motion begins and ends. A motion out of such a rest begins with no speed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array, Rows
from rig.run_folder.recording.series import Window

SHORTEST_REST_S, FEWEST_AT_REST = 0.12, 9  # a rest takes as long, and as many rows
SEEN = 2.5  # standard deviations beyond which a change of the position shows
OFF = 0.005  # of the largest drive: below it the drive is off, and a shaft at rest stays there
LEAST_TRAVEL = 6.0  # of a motion, in standard deviations of the noise
REST_ROWS = 8  # rows at rest that are fitted beside a motion
DITHERED = 0.4  # noise over the sensor's step from which on several readings say more than one


@dataclass(frozen=True)
class Motion:
    """A stretch of a window that is fitted as one piece.

    first, stop   its rows in the window; ``stop`` is exclusive
    from_rest     whether it begins with no speed
    """

    first: int
    stop: int
    from_rest: bool


def motions(window: Window, noise_rad: float, lsb_rad: float, *, through: bool = False) -> list[Motion]:
    """The motions of a window, in order; none if the shaft never moved.

    noise_rad   standard deviation of the sensor's noise, rad, > 0
    lsb_rad     step of the reading, rad; 0: none
    through     whether a motion goes on through rests under a drive: there a slow reversal looks like a rest, and of
                a motor whose static friction is its moving one a rest says as much as a motion
    """
    y_rad, drive = window.y_rad, _Drive.of(window)
    span = shortest_rest(window)
    still = at_rest(y_rad, noise_rad, lsb_rad, span)
    if through:
        still &= drive.off
    keeps = REST_ROWS if noise_rad >= DITHERED * lsb_rad else 1
    edges = np.flatnonzero(np.diff(np.concatenate(([True], still, [True])).astype(np.int8)))
    found: list[Motion] = []
    begin = 0  # of the rest before
    for first, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        before = slice(begin, first)
        begin = stop
        if float(np.ptp(y_rad[first:stop])) < LEAST_TRAVEL * noise_rad + lsb_rad:
            continue
        start, from_rest = _start(before, first, drive, y_rad, span, keeps)
        if found and start < found[-1].stop:
            found[-1] = Motion(found[-1].first, start, found[-1].from_rest)
        end = min(stop + span // 3, y_rad.size)  # a rest is seen to begin early
        driven = np.flatnonzero(~drive.off[end : end + keeps])
        end = min(end + (int(driven[0]) if driven.size else keeps), y_rad.size)
        found.append(Motion(start, end, from_rest))
    return found


def at_rest(y_rad: Array, noise_rad: float, lsb_rad: float, span: int) -> NDArray[np.bool_]:
    """For each row whether it lies in ``span`` rows (at least 9) in which the position shows no motion, (n,)."""
    still = np.zeros(y_rad.size, dtype=bool)
    if y_rad.size < span:
        return still
    third = span // 3
    sums = np.concatenate(([0.0], np.cumsum(y_rad - y_rad[0])))
    means = (sums[third:] - sums[:-third]) / third
    first, middle, last = means[: y_rad.size - span + 1], means[(span - third) // 2 :], means[span - third :]
    middle = middle[: first.size]
    sees = SEEN * noise_rad / math.sqrt(third)
    windows = np.lib.stride_tricks.sliding_window_view(y_rad, span)
    reach = windows.max(axis=1) - windows.min(axis=1)
    calm = (np.abs(last - first) < math.sqrt(2.0) * sees) & (
        np.abs(2.0 * middle - first - last) < math.sqrt(6.0) * sees
    )
    calm &= reach < 6.0 * noise_rad + lsb_rad
    count = np.zeros(y_rad.size + 1, dtype=np.int64)
    np.add.at(count, np.flatnonzero(calm), 1)
    np.add.at(count, np.flatnonzero(calm) + span, -1)
    return np.asarray(np.cumsum(count)[:-1] > 0)


def repeats(window: Window) -> NDArray[np.bool_]:
    """For each row whether it repeats the reading of a shaft at rest, and so says nothing more, (n,).

    A sensor without noise to dither it shows the same step all through a rest. So all of its rows have one error of
    rounding, and are one chance. The first row of them tells when the shaft came to the step, the last one where it
    rests. A shaft that slides through a step goes through the steps beside it in about as many rows: it rests where a
    reading stands for longer than the one before and the one behind together (docs/theory.md 7.6).
    """
    y_rad, series = window.y_rad, window.series
    found = np.zeros(y_rad.size, dtype=bool)
    if series.noise_rad() >= DITHERED * series.resolution_rad():
        return found
    edges = np.concatenate(([0], np.flatnonzero(np.diff(y_rad)) + 1, [y_rad.size]))
    rows = np.concatenate(([0], np.diff(edges), [0]))
    rests = rows[1:-1] > np.maximum(rows[:-2] + rows[2:], shortest_rest(window) - 1)
    for first, stop in np.column_stack((edges[:-1], edges[1:]))[rests].tolist():
        found[first + 1 : stop - 1] = True
    return found


def shortest_rest(window: Window) -> int:
    """Rows of the shortest rest."""
    return max(FEWEST_AT_REST, math.ceil(SHORTEST_REST_S / window.period_s))


class _Drive(NamedTuple):
    """The drive at each sample, V, and whether it is off there."""

    u_V: Array
    off: NDArray[np.bool_]

    @classmethod
    def of(cls, window: Window) -> _Drive:
        edge_s, u_V = window.steps
        at = u_V[np.maximum(np.searchsorted(edge_s, window.t_s, side="right") - 1, 0)]
        return cls(at, np.abs(at) <= OFF * float(np.abs(u_V).max()))


def _start(before: slice, first: int, drive: _Drive, y_rad: Array, span: int, keeps: int) -> tuple[int, bool]:
    """First row of a motion that shows from row ``first`` on, and whether it begins with no speed.

    before   rows of the rest before it
    span     rows of the shortest rest
    keeps    most rows of the rest that are fitted
    """
    low, third = before.start, span // 3
    if before.stop <= low:
        return first, False
    seen = min(first + third, y_rad.size - 1)
    way = np.sign(y_rad[seen] - float(np.mean(y_rad[low:first][-2 * third :])))
    pushes = np.flatnonzero(way * drive.u_V[low : seen + 1] > 0.0)
    if pushes.size == 0:
        return max(low, first - third), False
    # back along the drive that pushes, to where it began
    row = low + int(pushes[-1])
    while row > low and way * drive.u_V[row - 1] > 0.0 and not drive.off[row - 1]:
        row -= 1
    held = low + int(np.flatnonzero(~drive.off[low:row])[-1]) + 1 if not drive.off[low:row].all() else low
    if row - held >= span:
        return row - keeps, True
    # friction held it under a drive of some size: it began to move where that drive last rose
    rises = np.flatnonzero(way * np.diff(drive.u_V[max(low, row - 1) : seen + 1]) > 0.0)
    return (max(low, row - 1) + int(rises[-1]) if rises.size else max(low, first - third)), False


def in_parts(found: Sequence[Motion], longest: int) -> list[Motion]:
    """The motions in parts of about ``longest`` rows at most: over longer ones what a model leaves out adds up."""
    parts = []
    for whole in found:
        count = max(1, round((whole.stop - whole.first) / longest))
        rows = np.round(np.linspace(whole.first, whole.stop, count + 1)).astype(int).tolist()
        for k, (first, stop) in enumerate(pairwise(rows)):
            parts.append(Motion(first, stop, whole.from_rest and k == 0))
    return parts


def fitted_rows(found: Sequence[Motion], rows: int) -> tuple[Rows, NDArray[np.bool_], Array]:
    """First rows of pieces that cover ``rows`` rows, whether each begins at rest, and the weight of each row, 0 or 1.

    Rows between two motions belong to the piece before them, with no weight; a first piece of such rows is at rest.
    """
    first = [motion.first for motion in found]
    resting = [motion.from_rest for motion in found]
    if not first or first[0] > 0:
        first, resting = [0, *first], [True, *resting]
    weight = np.zeros(rows)
    for motion in found:
        weight[motion.first : motion.stop] = 1.0
    return np.array(first, dtype=np.int64), np.array(resting), weight
