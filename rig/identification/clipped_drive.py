"""A drive that is logged as it was asked for, beyond what the supply gives.

A loop or a generator may ask for more than the bridge has: then the motor gets what is below a limit. The limit is
looked for with which the plain motor explains pieces of the tests best. It counts where the plain motor leaves far more
than noise, where nearly all of it goes with the limit, and where drives of several sizes lie beyond it: a
single one that acts less than it says may be anything.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.identification.estimate import Estimate
from rig.identification.in_pieces import plain_residual_rad
from rig.identification.lowest import lowest
from rig.run_folder.recording.series import Steps, TimeSeries, noise_of_all_rad

LEAVES = 3.0  # residual over the sensor's noise from which on a limit is looked for; with it at most that,
CUTS = 0.1  # or this residual over that without it
SHOWS = 0.8  # residual with the best of the first limits over that without, at most
TRIED, LEAST, FINER = 8, 0.05, 18  # limits that are tried first, from the largest drive to this share; further steps
FEWEST_SIZES, BEYOND = 6, 0.02  # sizes of drives beyond the limit, at least, and how they differ, of the largest


def clipped_at_V(tests: Sequence[TimeSeries], plain: Estimate) -> float:
    """The largest drive that the motor got, V; inf where no limit shows."""
    noise_rad = noise_of_all_rad(tests)
    largest_V = max(float(np.abs(test.steps.u_V).max()) for test in tests)
    sizes = np.unique(np.round(np.abs(np.concatenate([test.steps.u_V for test in tests])) / (BEYOND * largest_V)))
    if not plain.is_motor or plain.rms_rad < LEAVES * noise_rad or sizes.size < FEWEST_SIZES:
        return math.inf
    limits_V = largest_V * np.geomspace(1.0, LEAST, TRIED)
    found = [_with(limit_V, tests, plain) for limit_V in limits_V.tolist()]
    best = int(np.argmin(found))
    beyond = np.sum(BEYOND * sizes > limits_V[best] / largest_V)
    if found[best] > SHOWS * found[0] or beyond < FEWEST_SIZES:
        return math.inf
    low_V, high_V = float(limits_V[min(best + 1, TRIED - 1)]), float(limits_V[best - 1])
    limit_V, left = lowest(lambda at_V: _with(at_V, tests, plain), low_V, high_V, FINER)
    return limit_V if left < max(LEAVES * noise_rad, CUTS * found[0]) else math.inf


def clipped(test: TimeSeries, limit_V: float) -> TimeSeries:
    """The test as its motor was driven: no drive is beyond the limit, V, > 0."""
    edges = test.edges
    cut = None if edges is None else Steps(edges.edge_s, np.clip(edges.u_V, -limit_V, limit_V))
    return replace(test, u_V=np.clip(test.u_V, -limit_V, limit_V), edges=cut)


def _with(limit_V: float, tests: Sequence[TimeSeries], plain: Estimate) -> float:
    """RMS residual of the plain motor on pieces under such a limit, rad."""
    return plain_residual_rad([clipped(test, limit_V) for test in tests], plain)
