"""A low-pass filter in the reading: a velocity that a driver smooths, or a filtered potentiometer.

A reading y of a shaft at x obeys T dy/dt + y = x. So where T is known, y + T dy/dt is the shaft. The T is looked for
with which the plain motor explains pieces of the tests best. It counts where the plain motor leaves far more than
noise, and most of it goes with the filter. A driver filters row by row, y_k = a y_{k-1} + (1 - a) x_k: that is undone
to the last bit. Some filter twice. Behind a filter of resistor and capacitor the same leaves a delay of half a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rig.identification.estimate import Estimate
from rig.identification.in_pieces import plain_residual_rad
from rig.identification.lowest import lowest
from rig.identification.preprocessing import unfiltered
from rig.run_folder.recording.series import TimeSeries, noise_of_all_rad

LEAVES = 3.0  # residual over the sensor's noise from which on a filter is looked for
CUTS = 0.5  # residual with the filter over that without it, at most
NEARLY_ALL = 0.1  # the same where the record looks wrong: a lag makes a shaft turn against its drive
SURELY = 0.7  # residual with two filters over that with one, at most
LONGEST_S = 0.2
TRIED = 7
FINER = 16


class ReadingFilter(NamedTuple):
    """So many equal filters one after the other, and the time constant of each, s."""

    lag_s: float
    order: int

    def undone(self, test: TimeSeries) -> TimeSeries:
        """The test as its shaft moved."""
        for _ in range(self.order):
            test = unfiltered(test, self.lag_s)
        return test


def reading_filter(tests: Sequence[TimeSeries], plain: Estimate) -> ReadingFilter | None:
    """The filter of the readings; None where none shows."""
    noise_rad = noise_of_all_rad(tests)
    if not plain.is_motor or plain.rms_rad < LEAVES * noise_rad or any(test.t_u_s is not None for test in tests):
        return None
    without = plain_residual_rad(tests, plain)
    lags_s = np.geomspace(0.5 * max(test.period_s for test in tests), LONGEST_S, TRIED)
    found = [_without(tests, plain, ReadingFilter(lag_s, 1)) for lag_s in lags_s.tolist()]
    best = int(np.argmin(found))
    if found[best] > 0.8 * without:
        return None
    low, high = float(lags_s[max(best - 1, 0)]), float(lags_s[min(best + 1, TRIED - 1)])

    def of(order: int) -> tuple[float, ReadingFilter]:
        lag_s, left = lowest(
            lambda each_s: _without(tests, plain, ReadingFilter(each_s, order)), low / order, high / order, FINER
        )
        return left, ReadingFilter(lag_s, order)

    left, filtered = of(1)
    if left > LEAVES * noise_rad:  # two of half the time constant are late by as much, and round off more
        twice = of(2)
        left, filtered = twice if twice[0] < SURELY * left else (left, filtered)
    return filtered if left < (NEARLY_ALL if plain.spoiled else CUTS) * without else None


def _without(tests: Sequence[TimeSeries], plain: Estimate, filtered: ReadingFilter) -> float:
    """RMS residual of the plain motor on pieces behind such a filter, rad."""
    return plain_residual_rad([filtered.undone(test) for test in tests], plain)
