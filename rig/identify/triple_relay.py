"""The triple-relay estimator (theory section 7, (24)-(29)): Theorem 2.1 turned round.

Friction is the third relay, so one cycle's three durations and two positions determine tau, K and fc. Five residuals in
three parameters, solved by damped Gauss-Newton from several starts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from rig.identify.cycles import Cycle, average
from rig.identify.estimate import Estimate, student_intervals
from rig.identify.record import IdentifyError
from rig.identify.sampled_data import Start, ridge_starts
from rig.model.limit_cycle import effective_inputs, stage_states

Array = NDArray[np.float64]

METHOD = "triple-relay"
MAX_ITERATIONS = 60
DIFFERENCE = 1e-6  # half step of the central differences, of the scaled parameters
FARTHEST = 12.0  # bound on them
WINDOW = 0.6  # of the time from RC to RB: samples that locate the extremum


class Features(NamedTuple):
    """What is read off a cycle; t = 0 where the drive steps to +(h1 + h2).

    t1_s, t2_s, t3_s   durations of the stages, s
    y_extremum_rad     position at t1
    y_rc_rad           position at t = 0
    y_rb_rad, z_rc_rad_s   position at the RB edge and integral at the RC edge: zero for an ideal relay; measured at the
                       edge for a sampled one, which switches late
    """

    t1_s: float
    t2_s: float
    t3_s: float
    y_extremum_rad: float
    y_rc_rad: float
    y_rb_rad: float = 0.0
    z_rc_rad_s: float = 0.0


@dataclass(frozen=True)
class Fit:
    """Solution of the five equations.

    theta     tau, s, K, (rad/s)/V, and fc, V
    residual  the five residuals, relative to the cycle's size
    iterates  (n, 3): theta at each iteration of the winning start, the start first
    """

    theta: Start
    residual: Array
    iterates: Array

    @property
    def cost(self) -> float:
        """Sum of squared relative residuals."""
        return float(self.residual @ self.residual)


def residuals(theta: Start, features: Features, h1_V: float, h2_V: float) -> Array:
    """The conditions of the three switching planes and the two positions, each relative to the cycle's size.

    In this order: z at RC, v at RA, y at RB, y at the extremum, y at RC.
    """
    durations = (features.t1_s, features.t2_s, features.t3_s)
    states = stage_states(theta.tau_s, theta.K_rad_s_V, durations, effective_inputs(theta.fc_V, h1_V, h2_V))
    return _relative(states, features, abs(features.y_extremum_rad), math.pi / sum(durations))


def _relative(states: Array, features: Features, amplitude: float, omega: float) -> Array:
    return np.array(
        [
            (states[0, 2] - features.z_rc_rad_s) * omega / amplitude,
            states[1, 0] / (omega * amplitude),
            (states[2, 1] - features.y_rb_rad) / amplitude,
            (states[1, 1] - features.y_extremum_rad) / amplitude,
            (states[0, 1] - features.y_rc_rad) / amplitude,
        ]
    )


@dataclass(frozen=True)
class _Scale:
    """Unknowns of order one: logarithms of tau and K in units of the cycle's, and fc over h2."""

    tau_s: float
    K_rad_s_V: float
    fc_V: float

    @classmethod
    def of(cls, features: Features, h2_V: float) -> _Scale:
        omega = math.pi / (features.t1_s + features.t2_s + features.t3_s)
        return cls(1.0 / omega, abs(features.y_extremum_rad) * omega / h2_V, h2_V)

    def theta(self, x: Array) -> Start:
        return Start(self.tau_s * math.exp(x[0]), self.K_rad_s_V * math.exp(x[1]), self.fc_V * float(x[2]))

    def unknowns(self, theta: Start) -> Array:
        return np.array(
            [math.log(theta.tau_s / self.tau_s), math.log(theta.K_rad_s_V / self.K_rad_s_V), theta.fc_V / self.fc_V]
        )


def solve(features: Features, h1_V: float, h2_V: float, starts: Sequence[Start]) -> Fit:
    """Best solution of the five equations from the given starts, t1 being known.

    Raises IdentifyError if no start leads anywhere.
    """
    _check_order(features)

    scale = _Scale.of(features, h2_V)

    def evaluate(x: Array) -> Array:
        return residuals(scale.theta(x), features, h1_V, h2_V)

    return _best([_gauss_newton(evaluate, scale.unknowns(start)) for start in starts], scale.theta)


def solve_cycle(cycle: Cycle, starts: Sequence[Start]) -> Fit:
    """The same for an averaged, sampled cycle: t1 follows from v(t1) = 0, and samples about the extremum locate it.

    The curve about the extremum comes from the motor that is sought, so that its jumps of acceleration at RA and RC are
    in it. The samples together weigh as much as one position read off the curve. Raises IdentifyError.
    """
    h1, h2 = cycle.h1_V, cycle.h2_V
    features = features_of(cycle)
    _check_order(features)
    inner = features.t1_s + features.t2_s
    at_s = cycle.phase * cycle.period_s
    window = at_s <= WINDOW * inner
    at_s, y_rad = at_s[window], cycle.curve_rad[window]
    weight = 1.0 / (cycle.amplitude_rad * math.sqrt(at_s.size))

    scale = _Scale.of(features, h2)

    def evaluate(x: Array) -> Array:
        theta = scale.theta(x)
        inputs = effective_inputs(theta.fc_V, h1, h2)
        t1 = _reversal(theta.tau_s, inputs, inner, features.t3_s)
        states = stage_states(theta.tau_s, theta.K_rad_s_V, (t1, inner - t1, features.t3_s), inputs)
        planes = _relative(states, features, cycle.amplitude_rad, cycle.omega_rad_s)
        curve = _curve(theta, states, t1, inputs, at_s)
        return np.concatenate((planes[[0, 2, 4]], weight * (curve - y_rad)))

    return _best([_gauss_newton(evaluate, scale.unknowns(start)) for start in starts], scale.theta)


def _reversal(tau_s: float, inputs: tuple[float, float, float], inner_s: float, t3_s: float) -> float:
    """t1 for which v(t1) = 0 and v(T/2) = -v(0), s; 0 or ``inner_s`` where there is none between them."""
    keep = math.exp(-t3_s / tau_s)

    def excess(t1: float) -> float:
        inner_speed = -inputs[1] * math.expm1((t1 - inner_s) / tau_s)
        return inputs[0] * math.expm1(min(t1 / tau_s, 500.0)) - inputs[2] - (inner_speed - inputs[2]) * keep

    if excess(0.0) >= 0.0:
        return 0.0
    if excess(inner_s) <= 0.0:
        return inner_s
    return float(brentq(excess, 0.0, inner_s, xtol=1e-13))


def _curve(theta: Start, states: Array, t1: float, inputs: tuple[float, float, float], at_s: Array) -> Array:
    """Position in the first two stages, at times after RC."""
    early = at_s < t1
    h = np.where(early, at_s, at_s - t1)
    target = theta.K_rad_s_V * np.where(early, inputs[0], inputs[1])
    v = np.where(early, states[0, 0], states[1, 0])
    y = np.where(early, states[0, 1], states[1, 1])
    return np.asarray(y + target * h - (v - target) * theta.tau_s * np.expm1(-h / theta.tau_s))


def _check_order(features: Features) -> None:
    if min(features.t1_s, features.t2_s, features.t3_s) <= 0.0:
        raise IdentifyError(
            "the relays' edges are not in the order RA, RB, RC", "record a settled cycle of the relay test"
        )


@dataclass(frozen=True)
class _Path:
    iterates: list[Array]
    residual: Array


def _best(paths: list[_Path], unscaled: Callable[[Array], Start]) -> Fit:
    finite = [path for path in paths if np.isfinite(path.residual).all()]
    if not finite:
        raise IdentifyError("no start of the triple-relay equations converges", "record a longer, settled relay test")
    best = min(finite, key=lambda path: float(path.residual @ path.residual))
    return Fit(unscaled(best.iterates[-1]), best.residual, np.array([unscaled(x) for x in best.iterates]))


def _gauss_newton(evaluate: Callable[[Array], Array], x: Array) -> _Path:
    """Damped Gauss-Newton: the damping grows until a step lowers the cost, and falls after one that does."""
    r = evaluate(x)
    iterates = [x]
    damping = 1e-3
    for _ in range(MAX_ITERATIONS):
        jacobian = np.column_stack(
            [(evaluate(x + e) - evaluate(x - e)) / (2.0 * DIFFERENCE) for e in DIFFERENCE * np.eye(x.size)]
        )
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ r
        scale = np.diag(np.maximum(np.diag(normal), 1e-12))
        step = trial = None
        while damping < 1e9:
            step = -np.linalg.solve(normal + damping * scale, gradient)
            if np.abs(x + step).max() < FARTHEST:
                trial = evaluate(x + step)
                if trial @ trial <= r @ r:
                    break
            step = None
            damping = max(10.0 * damping, 1e-10)
        if step is None or trial is None:
            break
        x, r = x + step, trial
        iterates.append(x)
        damping *= 0.1
        if np.abs(step).max() < 1e-11:
            break
    return _Path(iterates, r)


def features_of(cycle: Cycle) -> Features:
    """Features of an averaged cycle, with position and integral measured at the edges."""
    return Features(
        cycle.t1_s,
        cycle.t2_s,
        cycle.t3_s,
        cycle.y_extremum_rad,
        cycle.y_rc_rad,
        cycle.y_rb_rad,
        cycle.z_rc_rad_s,
    )


def fit(cycle: Cycle, start: Start | None = None) -> Estimate:
    """Estimate tau, K and fc from one averaged cycle.

    start   a first guess, e.g. the describing function's (the two-stage method, Remark 3.3), tried beside the others
    Intervals are a jackknife over periods. rms_rad is left to the caller. Raises IdentifyError if nothing converges.
    """
    starts = ridge_starts(cycle.omega_rad_s, cycle.amplitude_rad, cycle.h1_V, cycle.h2_V)
    starts = ([start] if start is not None else []) + starts
    found = solve_cycle(cycle, starts)
    covariance = np.full((5, 5), np.nan)
    intervals: dict[str, tuple[float, float]] = {}
    spread = _jackknife(cycle, found.theta)
    if spread is not None:
        covariance[:3, :3] = spread
        intervals = student_intervals(found.theta, spread, cycle.cycles - 1)
    estimate = Estimate(
        METHOD,
        *found.theta,
        ci95=intervals,
        covariance=covariance,
        iterations=len(found.iterates) - 1,
        rows=cycle.rows,
        iterates=found.iterates,
    )
    if spread is None:
        return estimate.judged(
            "doubtful", "its interval could not be had from the cycles: record at least ten settled ones"
        )
    return estimate


def _jackknife(cycle: Cycle, theta: Start) -> Array | None:
    """Covariance over periods, each left out in turn; None if one of these does not converge."""
    n = len(cycle.waves)
    solutions = []
    for k in range(n):
        rest = cycle.waves[:k] + cycle.waves[k + 1 :]
        try:
            part = average(rest, cycle.h1_V, cycle.h2_V, cycle.period_sampling_s, cycle.resolution_rad, cycle.rows)
            solutions.append(solve_cycle(part, [theta]).theta)
        except IdentifyError:
            return None
    deviation = np.array(solutions) - np.mean(solutions, axis=0)
    return np.asarray((n - 1) / n * deviation.T @ deviation)
