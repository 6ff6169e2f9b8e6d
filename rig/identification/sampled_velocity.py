"""What the sum of a tachometer's samples misses: between two of them the velocity does not change evenly.

A log of sampled velocities is summed up by the trapezoid rule. After each step of the drive a quick motor bends between
two rows, and the sum is off by a share of some (period / tau)^2 / 12: K and tau with it. A motor says how its velocity
went in between. So the motor is looked for whose own sum of its own samples explains pieces of the tests best, and what
this sum misses is put right in theirs. Where samples behind a short low pass explain much more, its lag is put right,
too. A longer one is undone before (``smoothing``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.identification.departures.fit import Fit
from rig.identification.estimate import Estimate
from rig.identification.in_pieces import plain_in_pieces
from rig.model.compiled import motion
from rig.model.compiled.row_filter import filtered
from rig.model.motor import Motor
from rig.run_folder.recording.series import TimeSeries, delays_of_all_s

CHANCE, SURE = 4.0, 20.0  # by how much twice the log likelihood may fall, at most; what a low pass has to gain
TRIALS, NEAR = 40, 1e-6  # of a descent, and the step that ends it, of the numbers
STEPS = (0.1, 0.1, 0.01, 0.01, 0.1, 0.1)  # of log tau, log K; f_c, a, of the largest drive; delay and lag, of a period
LARGEST = 20.0  # log tau or log K, of any motor
LONGEST_ROWS = 5.0  # of such a low pass
SHORTEST = 0.01  # of a period: in less, a motor lags behind no row
COVERAGE = 2.0
HALF_A_ROW = (0.3, 0.7)  # of a period that the drive acts before its row
SAID_SAMPLES = (
    "the drive would act half a row too early if each velocity were a mean since the row before: it is a sample"
)
KNOWN = 0.1  # of the lag: in 20 made logs whose velocities were low-passed counts, tau was off by less in 19
SAID = "between the samples of the velocity the motor bends, which their sum misses: put right before the fit"
LAGS = "the velocity is low-passed by {ms:.2g} ms: that, and what the sum of its samples misses, is put right"


class Bends(NamedTuple):
    """Tests with what the motor did between their samples.

    rad    what the plain motor leaves of their pieces, rad
    moves  half widths at 95 % of tau and K, of themselves, and f_c, V: what is put right is known as well as the motor
    lag_s  of a low pass that is put right, too, s; 0: none
    """

    tests: list[TimeSeries]
    rad: float
    moves: tuple[float, float, float]
    lag_s: float

    @property
    def words(self) -> str:
        """What is said of it."""
        return LAGS.format(ms=1e3 * self.lag_s) if self.lag_s > 0.0 else SAID


def bends(tests: Sequence[TimeSeries], plain: Estimate) -> Bends | None:
    """What the tests miss; None where they are no samples, or where the plain motor explains them worse with that.

    Raises IdentifyError if a test is too short for pieces.
    """
    if not plain.is_motor or any(test.reads != "samples" or test.t_u_s is not None for test in tests):
        return None
    without = plain_in_pieces(tests, plain, walks=tests)
    if not without.cost > 0.0:
        return None  # nothing is left to put right
    found, of_means, apart = _fitted(tests, plain, _numbers(without)), False, 0.0
    rows, period_s = found.fun.size, max(test.period_s for test in tests)
    first = np.append(_numbers(without), 0.3 * period_s)
    lagging = {means: _fitted(tests, plain, first, means) for means in (False, True)}
    best = min(lagging, key=lambda means: float(lagging[means].cost))
    if found.cost > lagging[best].cost * math.exp(SURE / rows):
        of_means = best
        # motor and low pass may stand in each other's place, but for friction
        both = [lagging[best], _fitted(tests, plain, _swapped(lagging[best].x, period_s), best)]
        found, other = sorted(both, key=lambda one: float(one.cost))
        for numbers in (other.x, _swapped(found.x, period_s)):
            cost = 0.5 * float(np.sum(_left(tests, plain, numbers, best) ** 2))
            if cost < found.cost * math.exp(SURE / rows):
                apart = max(apart, abs(math.expm1(float(numbers[0] - found.x[0]))))
        apart = max(apart, KNOWN * float(found.x[5]) * math.exp(-float(found.x[0])))
    if 2.0 * found.cost > without.cost * math.exp(CHANCE / rows):
        return None
    motor, lag_s = _with(plain, found.x)
    bent = _bent(tests, motor, lag_s, of_means)
    own = np.diag(plain_in_pieces(bent, motor, walks=tests).covariance)[:3]  # of tau, K and f_c, with these bends
    slopes: Array = np.asarray(found.jac)
    scatter = 2.0 * found.cost / max(rows - found.x.size, 1)
    of_both = np.diag(np.linalg.pinv(slopes.T @ slopes, rcond=1e-12, hermitian=True))[:3] * scatter
    tau, gain, friction_V = (COVERAGE * np.sqrt(np.maximum(of_both - own, 0.0))).tolist()
    return Bends(bent, plain_in_pieces(bent, motor).rms_rad, (max(tau, apart), gain, friction_V), lag_s)


def _numbers(fit: Fit) -> Array:
    m = fit.motor
    return np.array([math.log(m.tau_s), math.log(m.K_rad_s_V), m.fc_V, m.bias_V, m.delay_s])


def _swapped(numbers: Array, period_s: float) -> Array:
    """The same with the time constants of motor and low pass in each other's place; as for ``_fitted``."""
    tau_s, lag_s = max(math.exp(numbers[0]), SHORTEST * period_s), max(float(numbers[5]), NEAR * period_s)
    found = numbers.copy()
    found[0], found[5] = math.log(period_s / math.log1p(period_s / lag_s)), period_s / math.expm1(period_s / tau_s)
    return found


def _fitted(tests: Sequence[TimeSeries], plain: Estimate, first: Array, of_means: bool = False) -> Any:
    """The numbers of the motor, and of a low pass, whose samples explain the tests best: scipy's result.

    first   to begin with: log tau, log K, f_c and a, V, the delay, s; the lag of a low pass, s, or not
    """
    from scipy.optimize import least_squares  # it loads slowly, and few records need it

    drive_V, period_s = max(float(np.abs(test.u_V).max()) for test in tests), max(test.period_s for test in tests)
    earliest_s, latest_s = delays_of_all_s(tests)
    least = np.array([-LARGEST, -LARGEST, 0.0, -drive_V, earliest_s, 0.0])[: first.size]
    most = np.array([LARGEST, LARGEST, drive_V, drive_V, latest_s, LONGEST_ROWS * period_s])[: first.size]
    sizes = (np.array(STEPS) * (1.0, 1.0, drive_V, drive_V, period_s, period_s))[: first.size]
    inside = np.clip(first, least + NEAR * sizes, most - NEAR * sizes)

    def left(numbers: Array) -> Array:
        return _left(tests, plain, numbers, of_means)

    return least_squares(left, inside, bounds=(least, most), x_scale=sizes, xtol=NEAR, max_nfev=TRIALS)


def _left(tests: Sequence[TimeSeries], plain: Estimate, numbers: Array, of_means: bool) -> Array:
    at, lag_s = _with(plain, numbers)
    return plain_in_pieces(_bent(tests, at, lag_s, of_means), at, walks=tests, starts_alone=True).rows.residual


def _with(plain: Estimate, numbers: Array) -> tuple[Estimate, float]:
    tau, gain, friction_V, asym_V, delay_s, *lag_s = numbers.tolist()
    motor = replace(
        plain, tau_s=math.exp(tau), K_rad_s_V=math.exp(gain), fc_V=friction_V, asym_V=asym_V, delay_s=delay_s
    )
    return motor, sum(lag_s)


def _bent(tests: Sequence[TimeSeries], at: Estimate, lag_s: float, of_means: bool) -> list[TimeSeries]:
    motor = at.motor()
    return [replace(test, y_rad=test.y_rad + bends_rad(test, motor, at.delay_s, lag_s, of_means)) for test in tests]


def bends_rad(test: TimeSeries, motor: Motor, delay_s: float, lag_s: float = 0.0, of_means: bool = False) -> Array:
    """What the sum of the motor's velocities at the rows misses of its position, (n,), rad; 0 in the first row.

    lag_s     of a low pass, row by row, that the velocities went through
    of_means  whether each of them is the mean since the row before, as a counter's
    """
    steps = test.steps
    v_rad_per_s = (test.y_rad[1] - test.y_rad[0]) / (test.t_s[1] - test.t_s[0])
    v, y, _ = motion.states(motor.plant, (v_rad_per_s, 0.0, 0.0), (steps.edge_s, steps.u_V, delay_s), test.t_s).T
    if of_means:
        v = np.concatenate(([v_rad_per_s], np.diff(y) / np.diff(test.t_s)))
    if lag_s > 0.0:
        keep = lag_s / (lag_s + test.period_s)
        v = v_rad_per_s + filtered([1.0 - keep], [-keep], (v - v_rad_per_s)[:, None])[:, 0]
    summed = np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(test.t_s))
    return np.asarray(y - y[0] - np.concatenate(([0.0], summed)))


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
