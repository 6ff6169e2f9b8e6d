"""The triple-relay equations (24)-(29) solved as the paper does: plain Gauss-Newton, no damping, no scaling.

Five residuals in theta = (tau, K, fc): z at RC, v at RA and y at RB are zero, y at RA and y at RC are as measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.identification.triple_relay import Features
from rig.model.describing_function import RelayGains
from rig.model.limit_cycle import LimitCycle, effective_inputs, stage_states

Array = NDArray[np.float64]

MOST_STEPS = 40
ARRIVED = 1e-8  # relative step at which it stops
DIFFERENCE = 1e-6
STOPS = (1e-1, 1e-2, 1e-4, 1e-6, 1e-8)  # relative steps below which one may stop: the paper's rule did not survive


@dataclass(frozen=True)
class Path:
    """Where the iteration went.

    iterates   (n + 1, 3): tau, K, fc, the start first
    converged  whether the relative step fell below ``ARRIVED``
    """

    iterates: Array
    converged: bool

    @property
    def theta(self) -> Array:
        """Last iterate: tau, s, K, (rad/s)/V, fc, V."""
        return np.asarray(self.iterates[-1])

    def steps_to_rest(self, relative: float) -> int | None:
        """Steps until one changes no part of theta by more than this, relative to it; None if none is so small."""
        steps = np.abs(np.diff(self.iterates, axis=0) / self.iterates[1:]).max(axis=1)
        small = np.flatnonzero(steps < relative)
        return int(small[0]) + 1 if small.size else None

    @property
    def counts(self) -> tuple[int | None, ...]:
        """``steps_to_rest`` by each of ``STOPS``."""
        return tuple(self.steps_to_rest(stop) for stop in STOPS)

    def steps_until(self, truth: Array, relative: float = 1e-8) -> int | None:
        """Steps after which all of theta stays within ``relative`` of the truth; None if it never does."""
        error = np.abs(self.iterates / truth - 1.0).max(axis=1)
        if not error[-1] <= relative:
            return None
        outside = np.flatnonzero(~(error <= relative))
        return int(outside[-1]) + 1 if outside.size else 0


def features_of(cycle: LimitCycle) -> Features:
    """What an ideal measurement would read off a cycle."""
    return Features(*cycle.durations_s, float(cycle.states[1, 1]), float(cycle.states[0, 1]))


def residuals(theta: Array, features: Features, gains: RelayGains) -> Array:
    """The five, in rad s, rad/s, rad, rad, rad."""
    durations = (features.t1_s, features.t2_s, features.t3_s)
    states = stage_states(
        float(theta[0]), float(theta[1]), durations, effective_inputs(float(theta[2]), gains.h1_V, gains.h2_V)
    )
    return np.array([
        states[0, 2], states[1, 0], states[2, 1],
        states[1, 1] - features.y_extremum_rad, states[0, 1] - features.y_rc_rad,
    ])  # fmt: skip


def iterate(features: Features, gains: RelayGains, start: tuple[float, float, float]) -> Path:
    """Plain Gauss-Newton from ``start``; ends early where it leaves what can be computed."""
    theta = np.array(start, dtype=float)
    iterates = [theta]
    step = np.full(3, np.inf)
    for _ in range(MOST_STEPS):
        with np.errstate(all="ignore"):
            try:
                r = residuals(theta, features, gains)
                sides = [
                    (residuals(theta + e, features, gains) - residuals(theta - e, features, gains)) / (2.0 * DIFFERENCE)
                    for e in DIFFERENCE * np.eye(3)
                ]
                step = -np.linalg.lstsq(np.column_stack(sides), r, rcond=None)[0]
            except (OverflowError, ZeroDivisionError, ValueError, np.linalg.LinAlgError):
                break  # exp(-h/tau) of a tau near or below zero: diverged
        if not np.isfinite(step).all():
            break
        theta = theta + step
        iterates.append(theta)
        if np.abs(step / theta).max() < ARRIVED:
            break
    return Path(np.array(iterates), bool(np.abs(step / theta).max() < ARRIVED))
