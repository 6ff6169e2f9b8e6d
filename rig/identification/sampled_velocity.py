"""What the sum of a tachometer's samples misses: between two of them the velocity does not change evenly.

A log of sampled velocities is summed up by the trapezoid rule. After each step of the drive a quick motor bends between
two rows, and the sum is off by a share of some (period / tau)^2 / 12: K and tau with it. A motor says how its velocity
went in between, so the sum is mended by that of the motor that explains pieces of the tests, and the motor is fitted
again, until both agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.core.arrays import Array
from rig.identification.estimate import Estimate
from rig.identification.in_pieces import plain_in_pieces
from rig.model.compiled import motion
from rig.model.motor import Motor
from rig.run_folder.recording.series import TimeSeries

ROUNDS, AGREES = 12, 2e-4  # of tau
CHANCE = 4.0  # by how much twice the log likelihood may fall, at most
SAID = "between the samples of the velocity the motor bends, which their sum misses: put right before the fit"


def with_bends(tests: Sequence[TimeSeries], plain: Estimate) -> tuple[list[TimeSeries], float]:
    """The tests with what the motor did between samples, and what it leaves of their pieces, rad.

    As they are, with inf, where they are no samples, or where a motor explains them worse with that. Raises
    IdentifyError if a test is too short for pieces.
    """
    if not plain.is_motor or any(test.reads != "samples" for test in tests):
        return list(tests), math.inf
    without = plain_in_pieces(tests, plain, walks=tests)
    at, bent, fit = plain, list(tests), without
    for _ in range(ROUNDS):
        motor, delay_s = at.motor(), at.delay_s if math.isfinite(at.delay_s) else 0.0
        bent = [replace(test, y_rad=test.y_rad + bends_rad(test, motor, delay_s)) for test in tests]
        fit = plain_in_pieces(bent, at, walks=tests)
        found, before_s = fit.motor, at.tau_s
        at = replace(
            at,
            tau_s=found.tau_s,
            K_rad_s_V=found.K_rad_s_V,
            fc_V=found.fc_V,
            asym_V=found.bias_V,
            delay_s=found.delay_s,
        )
        if abs(found.tau_s / before_s - 1.0) < AGREES:
            break
    # in units of the same walk
    costs = [one.cost * one.problem.sigma_rad**2 for one in (fit, without)]
    if fit.residual_rad.size * math.log(costs[0] / costs[1]) > CHANCE:
        return list(tests), math.inf
    return bent, plain_in_pieces(bent, at).rms_rad


def bends_rad(test: TimeSeries, motor: Motor, delay_s: float) -> Array:
    """What the sum of the motor's velocities at the rows misses of its position, (n,), rad; 0 in the first row."""
    steps = test.steps
    v_rad_per_s = (test.y_rad[1] - test.y_rad[0]) / (test.t_s[1] - test.t_s[0])
    v, y, _ = motion.states(motor.plant, (v_rad_per_s, 0.0, 0.0), (steps.edge_s, steps.u_V, delay_s), test.t_s).T
    summed = np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(test.t_s))
    return np.asarray(y - y[0] - np.concatenate(([0.0], summed)))
