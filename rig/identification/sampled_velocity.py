"""What the sum of a tachometer's samples misses: between two of them the velocity does not change evenly.

A log of sampled velocities is summed up by the trapezoid rule. After each step of the drive a quick motor bends between
two rows, and the sum is off by a share of some (period / tau)^2 / 12: K and tau with it. A motor says how its velocity
went in between. So the sum is mended by that of the motor that explains pieces of what was mended: by it and by nearby
ones it is told where both agree, and how much a fit's errors grow by the bends that err with them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.identification.departures.fit import Fit
from rig.identification.estimate import Estimate
from rig.identification.in_pieces import plain_in_pieces
from rig.model.compiled import motion
from rig.model.motor import Motor
from rig.run_folder.recording.series import TimeSeries

ROUNDS, AGREES, ASIDE = 12, 1e-3, 0.02  # of a number's size: the last step, and how far beside the numbers it is tried
CHANCE = 4.0  # by how much twice the log likelihood may fall, at most
NUMBERS = ("tau_s", "K_rad_s_V", "fc_V", "asym_V", "delay_s")
HALF_A_ROW = (0.3, 0.7)  # of a period that the drive acts before its row
SAID_SAMPLES = (
    "the drive would act half a row too early if each velocity were a mean since the row before: it is a sample"
)
SAID = "between the samples of the velocity the motor bends, which their sum misses: put right before the fit"


def are_samples(tests: Sequence[TimeSeries], plain: Estimate) -> bool:
    """Whether velocities that were taken for means since the row before are samples: rounded, or held over rows.

    Summed up as means they are half a row ahead, and so the drive would act before its row.
    """
    early = -plain.delay_s / max(test.period_s for test in tests)
    of_speed = all(test.reads == "speed" and test.t_u_s is None for test in tests)
    return of_speed and plain.is_motor and HALF_A_ROW[0] < early < HALF_A_ROW[1]


def as_sampled(test: TimeSeries) -> TimeSeries:
    """A sum of velocities as means, as that of samples, between which they change evenly."""
    moved_rad = np.diff(test.y_rad, prepend=2.0 * test.y_rad[0] - test.y_rad[1])
    return replace(test, y_rad=test.y_rad - 0.5 * moved_rad, reads="samples")


class Bends(NamedTuple):
    """What a motor did between samples.

    tests   with that
    rad     what the motor leaves of pieces of them, rad
    grows   (5, 5) what errors of a fit to them make of ``NUMBERS``: the bends err as they do
    """

    tests: Sequence[TimeSeries]
    rad: float
    grows: Array


def with_bends(tests: Sequence[TimeSeries], plain: Estimate) -> Bends | None:
    """The tests with what the motor did between samples, such that the motor fitted to them does just that.

    None where they are no samples, where no motor does, or where one explains them worse with that. Raises
    IdentifyError if a test is too short for pieces.
    """
    if not plain.is_motor or any(test.reads != "samples" for test in tests):
        return None
    largest_V = max(float(np.abs(test.u_V).max()) for test in tests)
    sizes = np.array([plain.tau_s, abs(plain.K_rad_s_V), largest_V, largest_V, plain.tau_s])

    def fitted(at: Array) -> tuple[Array, Fit, list[TimeSeries]]:
        tau_s, K_rad_s_V, fc_V, asym_V, delay_s = (at * sizes).tolist()
        begin = replace(plain, tau_s=tau_s, K_rad_s_V=K_rad_s_V, fc_V=max(fc_V, 0.0), asym_V=asym_V, delay_s=delay_s)
        bent = [replace(test, y_rad=test.y_rad + bends_rad(test, begin.motor(), begin.delay_s)) for test in tests]
        fit = plain_in_pieces(bent, begin, walks=tests)
        return _numbers(fit) / sizes, fit, bent

    def turning(at: Array, became: Array) -> Array:
        """(5, 5) what the difference of ``became`` and ``at`` does over ``at``."""
        beside = [fitted(at + ASIDE * axis)[0] - became for axis in np.eye(len(NUMBERS))]
        return np.stack(beside, axis=1) / ASIDE - np.eye(len(NUMBERS))

    without = plain_in_pieces(tests, plain, walks=tests)
    at = fitted(_numbers(without) / sizes)[0]
    became, fit, bent = fitted(at)
    off, turns = became - at, turning(at, became)
    for _ in range(ROUNDS):
        step = -np.linalg.lstsq(turns, off, rcond=None)[0]
        if np.abs(step).max() < AGREES:
            break
        at = at + step
        if not at[0] > 0.0 or not at[1] > 0.0:
            return None
        became, fit, bent = fitted(at)
        turns += np.outer(became - at - off - turns @ step, step) / float(step @ step)  # Broyden, Math. Comput. 1965
        off = became - at
    else:
        return None
    # in units of the same walk
    costs = [one.cost * one.problem.sigma_rad**2 for one in (fit, without)]
    if fit.residual_rad.size * math.log(costs[0] / costs[1]) > CHANCE:
        return None
    rad = plain_in_pieces(bent, plain).rms_rad
    grows = np.asarray(-np.linalg.pinv(turning(at, became)) * np.outer(sizes, 1.0 / sizes), dtype=np.float64)
    return Bends(bent, rad, grows)


def _numbers(fit: Fit) -> Array:
    """(5,) ``NUMBERS`` of a fit."""
    motor = fit.motor
    return np.array([motor.tau_s, motor.K_rad_s_V, motor.fc_V, motor.bias_V, motor.delay_s])


def bends_rad(test: TimeSeries, motor: Motor, delay_s: float) -> Array:
    """What the sum of the motor's velocities at the rows misses of its position, (n,), rad; 0 in the first row."""
    steps = test.steps
    v_rad_per_s = (test.y_rad[1] - test.y_rad[0]) / (test.t_s[1] - test.t_s[0])
    v, y, _ = motion.states(motor.plant, (v_rad_per_s, 0.0, 0.0), (steps.edge_s, steps.u_V, delay_s), test.t_s).T
    summed = np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(test.t_s))
    return np.asarray(y - y[0] - np.concatenate(([0.0], summed)))
