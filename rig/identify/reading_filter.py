"""A low-pass filter in the reading: a velocity that a driver smooths, or a filtered potentiometer.

A reading y of a shaft at x obeys T dy/dt + y = x. So where T is known, y + T dy/dt is the shaft. The T is looked for
with which the plain motor explains pieces of the tests best. It counts where the plain motor leaves far more than
noise, and most of it goes with the filter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from rig.identify.departures.fit import CORE, DELAY, Problem, limits_of, solve
from rig.identify.departures.fit import start as begin
from rig.identify.departures.pieces import Cut
from rig.identify.estimate import Estimate
from rig.identify.plausibility import one_way
from rig.identify.thinning import thinned
from rig.model.real_motor import RealMotor
from rig.recording.series import TimeSeries

LEAVES = 3.0  # residual over the sensor's noise from which on a filter is looked for
CUTS = 0.5  # residual with the filter over that without it, at most
PIECE_S = 0.5
MOST_ROWS = 3000
LONGEST_S = 0.2
TRIED = 7
ITERATIONS = 8


def reading_filter_s(tests: Sequence[TimeSeries], plain: Estimate) -> float:
    """Time constant of the filter, s; 0.0 where none shows."""
    noise_rad = math.sqrt(sum(test.noise_rad() ** 2 for test in tests) / len(tests))
    if not plain.is_motor or plain.rms_rad < LEAVES * noise_rad or any(test.t_u_s is not None for test in tests):
        return 0.0
    without = _residual_rad(tests, plain, 0.0)
    lags_s = np.geomspace(0.5 * max(test.period_s for test in tests), LONGEST_S, TRIED)
    found = [_residual_rad(tests, plain, lag_s) for lag_s in lags_s.tolist()]
    best = int(np.argmin(found))
    if found[best] > 0.8 * without:
        return 0.0
    low, high = lags_s[max(best - 1, 0)], lags_s[min(best + 1, TRIED - 1)]
    fine = minimize_scalar(
        lambda lag_s: _residual_rad(tests, plain, lag_s), bounds=(low, high), method="bounded", options={"maxiter": 10}
    )
    return float(fine.x) if fine.fun < CUTS * without else 0.0


def unfiltered(test: TimeSeries, lag_s: float) -> TimeSeries:
    """The series as its shaft moved, behind a filter of this time constant, s, >= 0."""
    return replace(test, y_rad=test.y_rad + lag_s * np.gradient(test.y_rad, test.t_s)) if lag_s > 0.0 else test


def _residual_rad(tests: Sequence[TimeSeries], plain: Estimate, lag_s: float) -> float:
    """RMS residual of the plain motor on pieces behind such a filter, rad."""
    rows = math.ceil(sum(len(test) for test in tests) / MOST_ROWS)
    moved = [thinned(unfiltered(test, lag_s), rows) for test in tests]
    delay_s = (min(test.earliest_delay_s for test in tests), max(test.longest_delay_s for test in tests))
    cut = Cut.whole(moved, delay_s[1]).every(PIECE_S)
    free = tuple(name for name in (*CORE, DELAY) if name != "bias_V" or not one_way(tests))
    motor = RealMotor(plain.tau_s, plain.K_rad_s_V, max(plain.fc_V, 0.0), plain.asym_V, max(plain.delay_s, 0.0))
    problem = Problem(cut, free, limits_of(free, cut, delay_s), 1e-3 * cut.frames[0].half_travel_rad)
    return solve(begin(problem, motor), ITERATIONS).rms_rad
