"""What the sum of a tachometer's samples misses: between two of them the velocity does not change evenly.

A log of sampled velocities is summed up by the trapezoid rule. After each step of the drive a quick motor bends between
two rows, and the sum is off by a share of some (period / tau)^2 / 12: K and tau with it. A motor says how its velocity
went in between. So the motor is looked for whose own sum of its own samples explains pieces of the tests best, and what
this sum misses is put right in theirs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from rig.core.arrays import Array
from rig.identification.departures.fit import Fit
from rig.identification.estimate import Estimate
from rig.identification.in_pieces import plain_in_pieces
from rig.model.compiled import motion
from rig.model.motor import Motor
from rig.run_folder.recording.series import TimeSeries, delays_of_all_s

CHANCE = 4.0  # by how much twice the log likelihood may fall, at most
TRIALS, NEAR = 40, 1e-6  # of a descent, and the step that ends it, of the numbers
STEPS = (0.1, 0.1, 0.01, 0.01, 0.1)  # of log tau, log K; f_c, a, of the largest drive; the delay, of a period
LARGEST = 20.0  # log tau or log K, of any motor
COVERAGE = 2.0
SAID = "between the samples of the velocity the motor bends, which their sum misses: put right before the fit"


class Bends(NamedTuple):
    """Tests with what the motor did between their samples.

    rad    what the plain motor leaves of their pieces, rad
    moves  half widths at 95 % of tau and K, of themselves, and f_c, V: what is put right is known as well as the motor
    """

    tests: list[TimeSeries]
    rad: float
    moves: tuple[float, float, float]


def bends(tests: Sequence[TimeSeries], plain: Estimate) -> Bends | None:
    """What the tests miss; None where they are no samples, or where the plain motor explains them worse with that.

    Raises IdentifyError if a test is too short for pieces.
    """
    if not plain.is_motor or any(test.reads != "samples" for test in tests):
        return None
    without = plain_in_pieces(tests, plain, walks=tests)
    drive_V, period_s = max(float(np.abs(test.u_V).max()) for test in tests), max(test.period_s for test in tests)
    low, high = (-LARGEST, -LARGEST, 0.0, -drive_V), (LARGEST, LARGEST, drive_V, drive_V)
    earliest_s, latest_s = delays_of_all_s(tests)
    least, most = np.array([*low, earliest_s]), np.array([*high, latest_s])

    def left(numbers: Array) -> Array:
        at = _with(plain, numbers)
        return plain_in_pieces(_bent(tests, at), at, walks=tests, starts_alone=True).rows.residual

    sizes = np.array(STEPS) * (1.0, 1.0, drive_V, drive_V, period_s)
    first = np.clip(_numbers(without), least + NEAR * sizes, most - NEAR * sizes)
    found = least_squares(left, first, bounds=(least, most), x_scale=sizes, xtol=NEAR, max_nfev=TRIALS)
    if found.fun.size * math.log(2.0 * found.cost / without.cost) > CHANCE:
        return None
    motor = _with(plain, found.x)
    bent = _bent(tests, motor)
    own = np.diag(plain_in_pieces(bent, motor, walks=tests).covariance)[:3]  # of tau, K and f_c, with these bends
    slopes: Array = np.asarray(found.jac)
    scatter = 2.0 * found.cost / max(found.fun.size - found.x.size, 1)
    of_both = np.diag(np.linalg.pinv(slopes.T @ slopes, rcond=1e-12, hermitian=True))[:3] * scatter
    tau, gain, friction_V = (COVERAGE * np.sqrt(np.maximum(of_both - own, 0.0))).tolist()
    return Bends(bent, plain_in_pieces(bent, motor).rms_rad, (tau, gain, friction_V))


def _numbers(fit: Fit) -> Array:
    m = fit.motor
    return np.array([math.log(m.tau_s), math.log(m.K_rad_s_V), m.fc_V, m.bias_V, m.delay_s])


def _with(plain: Estimate, numbers: Array) -> Estimate:
    tau, gain, friction_V, asym_V, delay_s = numbers.tolist()
    return replace(
        plain, tau_s=math.exp(tau), K_rad_s_V=math.exp(gain), fc_V=friction_V, asym_V=asym_V, delay_s=delay_s
    )


def _bent(tests: Sequence[TimeSeries], at: Estimate) -> list[TimeSeries]:
    motor = at.motor()
    return [replace(test, y_rad=test.y_rad + bends_rad(test, motor, at.delay_s)) for test in tests]


def bends_rad(test: TimeSeries, motor: Motor, delay_s: float) -> Array:
    """What the sum of the motor's velocities at the rows misses of its position, (n,), rad; 0 in the first row."""
    steps = test.steps
    v_rad_per_s = (test.y_rad[1] - test.y_rad[0]) / (test.t_s[1] - test.t_s[0])
    v, y, _ = motion.states(motor.plant, (v_rad_per_s, 0.0, 0.0), (steps.edge_s, steps.u_V, delay_s), test.t_s).T
    summed = np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(test.t_s))
    return np.asarray(y - y[0] - np.concatenate(([0.0], summed)))
