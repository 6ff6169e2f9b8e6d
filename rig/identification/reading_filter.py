"""A low-pass filter in the reading: a velocity that a driver smooths, or a filtered potentiometer.

A reading y of a shaft at x obeys T dy/dt + y = x. So where T is known, y + T dy/dt is the shaft. The T is looked for
with which the plain motor explains pieces of the tests best. It counts where the plain motor leaves far more than
noise, and most of it goes with the filter. A driver filters row by row, y_k = a y_{k-1} + (1 - a) x_k: that is undone
to the last bit. Behind a filter of resistor and capacitor the same leaves a delay of half a row.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rig.identification.estimate import Estimate
from rig.identification.in_pieces import plain_residual_rad
from rig.identification.lowest import lowest
from rig.identification.preprocessing import unfiltered
from rig.run_folder.recording.series import TimeSeries

LEAVES = 3.0  # residual over the sensor's noise from which on a filter is looked for
CUTS = 0.5  # residual with the filter over that without it, at most
LONGEST_S = 0.2
TRIED = 7
FINER = 8


def reading_filter_s(tests: Sequence[TimeSeries], plain: Estimate) -> float:
    """Time constant of the filter, s; 0.0 where none shows."""
    noise_rad = math.sqrt(sum(test.noise_rad() ** 2 for test in tests) / len(tests))
    if not plain.is_motor or plain.rms_rad < LEAVES * noise_rad or any(test.t_u_s is not None for test in tests):
        return 0.0
    without = plain_residual_rad(tests, plain)
    lags_s = np.geomspace(0.5 * max(test.period_s for test in tests), LONGEST_S, TRIED)
    found = [_without(tests, plain, lag_s) for lag_s in lags_s.tolist()]
    best = int(np.argmin(found))
    if found[best] > 0.8 * without:
        return 0.0
    low, high = lags_s[max(best - 1, 0)], lags_s[min(best + 1, TRIED - 1)]
    lag_s, left = lowest(lambda lag_s: _without(tests, plain, lag_s), float(low), float(high), FINER)
    return lag_s if left < CUTS * without else 0.0


def _without(tests: Sequence[TimeSeries], plain: Estimate, lag_s: float) -> float:
    """RMS residual of the plain motor on pieces behind such a filter, rad."""
    return plain_residual_rad([unfiltered(test, lag_s) for test in tests], plain)
