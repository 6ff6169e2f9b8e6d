"""A drive that is logged as it was asked for, beyond what the motor gets: the supply has less, or firmware limits the
speed.

A loop or a generator may ask for more than the bridge has: then the motor gets what is below a limit. Or the shaft has
reached the largest speed that firmware allows: while it turns so fast, the motor gets what holds that speed. The limit
is looked for with which the plain motor explains pieces of the tests best. It counts where the plain motor leaves far
more than noise, and where nearly all of it goes with the limit. That of a supply has drives of several sizes beyond it:
a single one that acts less than it says may be anything.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.identification.estimate import Estimate
from rig.identification.in_pieces import MOST_ROWS, SAG, free_between, plain_in_pieces, plain_residual_rad
from rig.identification.lowest import lowest
from rig.run_folder.recording.series import Steps, TimeSeries, delays_of_all_s, noise_of_all_rad

LEAVES = 3.0  # residual over the sensor's noise from which on a limit is looked for; with it at most that,
CUTS = 0.1  # or this residual over that without it
SHOWS = 0.8  # residual with the best of the first limits over that without, at most
# Of the largest drive: limits that are tried first, closer where drives are cut off by little; further steps
FIRST, FINER = (1.0, 0.95, 0.88, 0.78, 0.63, 0.42, 0.2, 0.05), 18
FEWEST_SIZES, BEYOND = 6, 0.02  # sizes of drives beyond the limit, at least, and how they differ, of the largest
# Of the largest speed: from which on the shaft may be at its limit; which quantile that is; its error. Rows on either
# side that show a speed, at most. Residual beyond noise with such a limit over that without: a drag cuts it by half
LIMITED, FASTEST, SURE, MOST_BESIDE, CUTS_BY_SPEED = (0.95, 0.97, 0.985), 0.98, 0.005, 10, 0.25
FIRST_BY_SPEED, FINER_BY_SPEED = tuple(np.geomspace(1.0, 0.25, 8).tolist()), 10
SAGS, AS_WELL = 0.05, 2.0  # of the largest drive: a sag to begin with; and its residual over that with a limit, at most
FEWEST = 40  # rows of a part that is slower behind the longest delay, where none are taken as one


class Limit(NamedTuple):
    """The largest drive that the motor gets, V, inf if any, where the shaft turns at least this fast, rad/s."""

    drive_V: float = math.inf
    from_rad_s: float = 0.0

    def in_words(self) -> str:
        """What the motor got."""
        if self.from_rad_s > 0.0:
            return (
                f"the speed stays near {self.from_rad_s:.3g} rad/s under drives that would turn the shaft faster, as "
                f"firmware limits it: there the motor gets {self.drive_V:.3g} V at most"
            )
        return (
            f"the drive is asked for beyond what the motor gets: it is limited to {self.drive_V:.4g} V, as by a supply"
        )


def limit_of(tests: Sequence[TimeSeries], plain: Estimate) -> Limit:
    """What the motor got at most; nothing is limited where none shows."""
    noise_rad = noise_of_all_rad(tests)
    if not plain.is_motor or plain.rms_rad < LEAVES * noise_rad:
        return Limit()
    largest_V = max(float(np.abs(test.steps.u_V).max()) for test in tests)
    sizes = np.unique(np.round(np.abs(np.concatenate([test.steps.u_V for test in tests])) / (BEYOND * largest_V)))
    without = _with(Limit(largest_V), tests, plain)
    if sizes.size >= FEWEST_SIZES:
        limit, left = _best(0.0, largest_V, tests, plain)
        cut_off = int(np.sum(BEYOND * sizes > limit.drive_V / largest_V))
        if left < max(LEAVES * noise_rad, CUTS * without) and cut_off >= FEWEST_SIZES:
            # behind a bridge that lets the motor run free between its pulses, the speed grows ever less with the drive
            free = plain_in_pieces(tests, plain, free_between(tests))
            return Limit() if free.rms_rad < left else limit
    if any(test.edges is not None or test.t_u_s is not None for test in tests):
        return Limit()
    top_rad_s = max(float(np.quantile(_speeds(test), FASTEST)) for test in tests)

    def beyond(rad: float) -> float:
        return max(rad**2 - noise_rad**2, 0.0)

    most = CUTS_BY_SPEED**2 * beyond(without)
    rows = sum(map(len, tests))
    fewest = FEWEST * math.ceil(rows / MOST_ROWS) + delays_of_all_s(tests)[1] / min(test.period_s for test in tests)
    slower = [part for test in tests for part in _slower(test, LIMITED[0] * top_rad_s) if len(part) >= fewest]
    share = sum(map(len, slower)) / rows
    if slower and share * beyond(plain_residual_rad(slower, plain)) > most:
        return Limit()  # that is left where no such limit acts
    by_speed = [_best(share * top_rad_s, largest_V, tests, plain) for share in LIMITED]
    limit, left = min(by_speed, key=lambda found: found[1])
    if not (left < SHOWS * without and beyond(left) < most):
        return Limit()
    # under a drive that sags, the speed grows ever less with the drive, too
    sags = plain_in_pieces(tests, plain, {SAG: SAGS / largest_V})
    return Limit() if sags.rms_rad < AS_WELL * left else limit


def _slower(test: TimeSeries, than_rad_s: float) -> Iterator[TimeSeries]:
    """The parts of a test, of two rows and more, in which all rows are slower."""
    is_slower = np.concatenate(([False], _speeds(test) < than_rad_s, [False]))
    parts = np.flatnonzero(np.diff(is_slower)).reshape(-1, 2).tolist()
    yield from (test.part(first, stop) for first, stop in parts if stop - first > 1)


def _best(from_rad_s: float, largest_V: float, tests: Sequence[TimeSeries], plain: Estimate) -> tuple[Limit, float]:
    """The best limit from this speed on, and its residual, rad; inf where it does not show."""

    def left(limit_V: float) -> float:
        return _with(Limit(limit_V, from_rad_s), tests, plain)

    limits_V = [share * largest_V for share in (FIRST_BY_SPEED if from_rad_s else FIRST)]
    found = list(map(left, limits_V))
    best = int(np.argmin(found))
    if found[best] > SHOWS * found[0] and (best or not from_rad_s):  # one by speed may cut off less than the first
        return Limit(), math.inf
    steps = FINER_BY_SPEED if from_rad_s else FINER
    limit_V, rad = lowest(left, limits_V[min(best + 1, len(limits_V) - 1)], limits_V[max(best - 1, 0)], steps)
    return Limit(limit_V, from_rad_s), rad


def clipped(test: TimeSeries, limit: Limit) -> TimeSeries:
    """The test as its motor was driven: no drive is beyond the limit, > 0."""
    edges, drive_V = test.edges, limit.drive_V
    most_V = np.where(_speeds(test) >= limit.from_rad_s, drive_V, math.inf) if limit.from_rad_s else drive_V
    cut = None if edges is None else Steps(edges.edge_s, np.clip(edges.u_V, -drive_V, drive_V))
    return replace(test, u_V=np.clip(test.u_V, -most_V, most_V), edges=cut)


def _speeds(test: TimeSeries) -> NDArray[np.float64]:
    """How fast the shaft turns at each row, rad/s: over so many rows that the sensor's noise hardly moves it."""
    way_rad = float(np.quantile(np.abs(np.diff(test.y_rad)), FASTEST))
    beside = min(max(1, math.ceil(test.noise_rad() / (SURE * max(way_rad, 1e-12)))), MOST_BESIDE, len(test) // 4)
    rows = np.arange(len(test))
    before, after = np.maximum(rows - beside, 0), np.minimum(rows + beside, len(test) - 1)
    return np.asarray(np.abs((test.y_rad[after] - test.y_rad[before]) / (test.t_s[after] - test.t_s[before])))


def _with(limit: Limit, tests: Sequence[TimeSeries], plain: Estimate) -> float:
    """RMS residual of the plain motor on pieces under such a limit, rad."""
    return plain_residual_rad([clipped(test, limit) for test in tests], plain)
