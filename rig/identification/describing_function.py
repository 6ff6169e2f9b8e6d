"""The describing-function estimator (docs/theory.md 4.1, 4.4): two relay tests, two straight lines.

pi A w / 4 = K h2 - K fc is linear in K and K fc; tau follows from w = h1 / (tau (h2 - fc)). The method assumes a sine.
No interval shows the error of this assumption.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from rig.core.arrays import Array
from rig.identification.estimate import Estimate, student_intervals
from rig.identification.estimator import Estimator
from rig.identification.mean_cycle import Cycle
from rig.identification.measurements import Measurements
from rig.identification.starts import Start
from rig.identification.verdict import judge_reference, settled, unguarded
from rig.run_folder.recording.errors import IdentifyError

METHOD = "describing-function"
NEAREST_H2 = 0.05  # smallest relative difference between the gains h2 of two tests


class DescribingFunction(Estimator):
    """A reference estimator: quick, and biased by the assumption of a sine."""

    name = METHOD

    def applies(self, data: Measurements) -> IdentifyError | None:
        """It needs two settled cycles."""
        return lacking(data.settled)

    def fit(self, data: Measurements) -> Estimate:
        """From the frequency and amplitude of each settled cycle."""
        return fit(data.settled)

    def judge(self, estimate: Estimate, data: Measurements, earlier: Mapping[str, Estimate]) -> Estimate:
        """Always doubtful: no interval shows the error of assuming a sine."""
        bias = "its interval shows the scatter of the cycles, not the error of assuming a sine"
        return unguarded(settled(judge_reference(estimate, data.tests, bias), data), data)


def solve(omegas_rad_s: Array, amplitudes_rad: Array, h1_V: Array, h2_V: Array) -> Start:
    """tau, K and fc from the oscillations of at least two tests: least squares for K and K fc, mean of the taus."""
    design = np.column_stack([h2_V, -np.ones_like(h2_V)])
    K, K_fc = np.linalg.lstsq(design, 0.25 * math.pi * amplitudes_rad * omegas_rad_s, rcond=None)[0]
    fc = float(K_fc / K) if K != 0.0 else math.nan
    tau = float(np.mean(h1_V / (omegas_rad_s * (h2_V - fc))))
    return Start(tau, float(K), fc)


def lacking(cycles: Sequence[Cycle]) -> IdentifyError | None:
    """Why these cycles are not enough, and what to record; None if they are."""
    if len(cycles) < 2:
        return IdentifyError(
            "the describing function needs two relay tests", "give two recordings with different gains h2"
        )
    h2 = np.array([cycle.h2_V for cycle in cycles])
    if np.ptp(h2) < NEAREST_H2 * h2.max():
        return IdentifyError(
            f"the tests' gains h2 lie within {100 * NEAREST_H2:.0f} % of one another",
            "record the second test with an h2 a fifth larger or smaller: relay.gains or relay.second_ratio",
        )
    return None


def fit(cycles: Sequence[Cycle]) -> Estimate:
    """Estimate tau, K and fc from two or more relay tests with different gains.

    Intervals come only from the scatter between periods. The caller sets rms_rad. Raises IdentifyError for fewer than
    two tests, and for gains that are too near one another.
    """
    wrong = lacking(cycles)
    if wrong is not None:
        raise wrong
    h1 = np.array([cycle.h1_V for cycle in cycles])
    h2 = np.array([cycle.h2_V for cycle in cycles])
    omegas = np.array([cycle.omega_rad_s for cycle in cycles])
    amplitudes = np.array([cycle.amplitude_rad for cycle in cycles])
    theta = solve(omegas, amplitudes, h1, h2)
    covariance = np.full((5, 5), np.nan)
    spread = _propagated(cycles, omegas, amplitudes, h1, h2)
    covariance[:3, :3] = spread
    intervals = student_intervals(theta, spread, max(1, min(cycle.cycles for cycle in cycles) - 1))
    estimate = Estimate(
        METHOD,
        *theta,
        ci95=intervals,
        covariance=covariance,
        iterations=1,
        rows=(min(cycle.rows[0] for cycle in cycles), max(cycle.rows[1] for cycle in cycles)),
        iterates=np.array([theta]),
        cycles=tuple(cycles),
    )
    if not (theta.K_rad_s_V > 0.0 and 0.0 <= theta.fc_V < h2.min() and theta.tau_s > 0.0):
        return estimate.judged(
            "refused",
            f"the oscillations give no motor (f_c = {theta.fc_V:.3g} V, K = {theta.K_rad_s_V:.3g} (rad/s)/V): "
            "record larger and slower cycles, with gains that differ more",
        )
    return estimate


def _propagated(cycles: Sequence[Cycle], omegas: Array, amplitudes: Array, h1: Array, h2: Array) -> Array:
    """Covariance of tau, K, fc from the covariances of each test's mean frequency and amplitude."""
    total = np.zeros((3, 3))
    for k, cycle in enumerate(cycles):
        pairs = np.array([(2.0 * math.pi / wave.period_s, wave.amplitude_rad) for wave in cycle.waves])
        if len(pairs) < 2:
            return np.full((3, 3), np.nan)
        jacobian = np.empty((3, 2))
        for column, values in enumerate((omegas, amplitudes)):
            step = 1e-5 * values[k]
            sides = []
            for sign in (1.0, -1.0):
                moved = values.copy()
                moved[k] += sign * step
                sides.append(np.array(solve(*((moved, amplitudes) if column == 0 else (omegas, moved)), h1, h2)))
            jacobian[:, column] = (sides[0] - sides[1]) / (2.0 * step)
        total += jacobian @ (np.cov(pairs.T) / len(pairs)) @ jacobian.T
    return total
