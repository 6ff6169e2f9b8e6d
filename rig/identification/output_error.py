"""Output-error fit: exact motion under the recorded drive, fitted to the recorded positions (docs/theory.md 7.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.departures.choice import AT_NOISE
from rig.identification.departures.fit import CORE, DELAY, Enough, Fit, Normal, Problem, begun, limits_of, solve
from rig.identification.departures.pieces import Cut
from rig.identification.estimate import PARAMETERS
from rig.identification.noise import WHITE, Noise
from rig.model.real_motor import RealMotor, index
from rig.model.sensitivity import Theta
from rig.run_folder.recording.series import TimeSeries, Window, noise_of_all_rad

SHARED = 5  # number of parameters that all windows share: tau, K, fc, asym, delay
SINGULAR = 1e10  # condition of the scaled Jacobian beyond which parameters cannot be separated
NAMES = (*CORE, DELAY)  # of these five
ITERATIONS = 100
ENOUGH = Enough(0.0, 1e-8)


@dataclass(frozen=True)
class OutputErrorProblem:
    """Least squares over windows. They share tau, K, fc, asym and delay; each window has its own v0 and y0.

    The full vector is log tau, log K, fc, asym, delay, then v0 and y0 of each window.

    free   which of the shared five are fitted; the others keep their start value
    noise  of the residual; the fit minimises the whitened squares
    once   whether a rest behind a sensor without noise is one chance
    """

    windows: tuple[Window, ...]
    delay_bounds_s: tuple[float, float]
    free: tuple[bool, bool, bool, bool, bool]
    noise: Noise = WHITE
    once: bool = False

    def mask(self) -> NDArray[np.bool_]:
        """Which entries of the full vector are fitted."""
        return np.array([*self.free, *([True] * (2 * len(self.windows)))])

    def solve(self, x0: Array, enough: Enough = ENOUGH, iterations: int = ITERATIONS) -> Solution:
        """Local least-squares solution from the full vector ``x0``, after so many iterations at most."""
        names = tuple(name for name, is_free in zip(NAMES, self.free, strict=True) if is_free)
        cut = Cut.of_windows(self.windows)
        cut = cut.rests_once() if self.once else cut
        problem = Problem(cut, names, limits_of(names, cut, self.delay_bounds_s), 1.0, noise=self.noise)
        shared = x0[:SHARED].tolist()
        motor = RealMotor(math.exp(shared[0]), math.exp(shared[1]), *shared[2:])
        motor = problem.moved(motor, np.zeros(len(names)))  # inside its bounds
        return Solution(solve(begun(problem, motor, x0[SHARED:].reshape(-1, 2)), iterations, enough))


@dataclass(frozen=True, eq=False)
class Solution:
    """A local solution."""

    fit: Fit

    @cached_property
    def x(self) -> Array:
        """The full vector."""
        motor = self.fit.motor
        shared = [math.log(motor.tau_s), math.log(motor.K_rad_s_V), motor.fc_V, motor.bias_V, motor.delay_s]
        return np.concatenate((shared, self.fit.starts.ravel()))

    @property
    def residual(self) -> Array:
        """Predicted less recorded positions of all windows, rad."""
        return self.fit.residual_rad

    @cached_property
    def jacobian(self) -> Array:
        """Its derivatives by the full vector."""
        cut, motor = self.fit.problem.cut, self.fit.motor
        found = cut.derivatives(motor, self.fit.starts, [index(name) for name in NAMES])
        full = np.zeros((found.y_rad.size, self.x.size))
        full[:, :SHARED] = found.by_number
        full[:, :2] *= motor.tau_s, motor.K_rad_s_V
        row = np.arange(found.y_rad.size)
        for k in range(2):
            full[row, SHARED + 2 * cut.piece + k] = found.by_start[:, k]
        return full

    @property
    def iterates(self) -> Array:
        """tau, K, fc after each iteration."""
        return self.fit.iterates

    def after(self, earlier: Solution) -> Solution:
        """The same, behind the iterations of an earlier one."""
        return Solution(replace(self.fit, iterates=np.concatenate((earlier.iterates, self.iterates))))

    @cached_property
    def converged(self) -> bool:
        """Whether the iterations ended, or the next Gauss-Newton step is small against the standard errors."""
        if self.fit.arrived:
            return True
        normal = Normal.of(self.fit.rows, self.fit.problem.cut)
        if not normal.is_finite:
            return False
        step, _ = normal.step(self.fit.problem.held(self.fit.motor, normal.gradient), 0.0)
        return bool(np.all(np.abs(step) < 0.05 * np.sqrt(np.maximum(np.diag(self.fit.covariance), 0.0))))

    @property
    def cost(self) -> float:
        """Sum of squared residuals of the rows that count, rad^2."""
        residual = self.counting(self.residual)
        return float(residual @ residual)

    @property
    def rms_rad(self) -> float:
        """RMS residual of the rows that count, rad."""
        return self.fit.rms_rad

    def counting(self, rows: Array) -> Array:
        """Those of ``rows``, (n,) or (n, p), that count."""
        return self.fit.problem.cut.counting(rows)


def rests_once(problem: OutputErrorProblem, found: Solution) -> tuple[OutputErrorProblem, Solution]:
    """The problem and its solution with each rest as one chance, where the motor leaves no more than the sensor does.

    Where it leaves more, rows at rest differ from it by what it lacks, and each shows that for as long as it lasts.
    """
    noise_rad = noise_of_all_rad([window.series for window in problem.windows])
    if found.rms_rad > AT_NOISE * noise_rad or Cut.of_windows(problem.windows).rests_once().weight is None:
        return problem, found
    problem = replace(problem, once=True)
    return problem, problem.solve(found.x).after(found)


def refit(
    tests: Sequence[TimeSeries],
    theta: Theta,
    free: Sequence[str] = (),
    delay_bounds_s: tuple[float, float] | None = None,
) -> Solution:
    """Prediction of the tests by a given motor, with only the initial states and the ``free`` parameters fitted.

    theta           the motor: fixed parameters have its values, free ones start there; its v0 and y0 are not used
    free            names of ``PARAMETERS`` to fit
    delay_bounds_s  bounds of a free delay, s; they may be negative
    """
    reach = delay_bounds_s or (theta.delay_s, theta.delay_s)
    windows = tuple(test.predictable(max(0.0, reach[1])) for test in tests)
    tau, K, fc, asym, delay = (name in free for name in PARAMETERS)
    problem = OutputErrorProblem(windows, reach, (tau, K, fc, asym, delay))
    shared = [math.log(theta.tau_s), math.log(theta.K_rad_s_V), theta.fc_V, theta.asym_V, theta.delay_s]
    found = problem.solve(np.array(shared + [value for window in windows for value in initial_state(window)]))
    return rests_once(problem, found)[1]


def initial_state(window: Window) -> tuple[float, float]:
    """Velocity and position at the first sample, from a line through the first few samples."""
    n = 4
    slope, offset = np.polyfit(window.t_s[:n] - window.t_s[0], window.y_rad[:n], 1)
    return float(slope), float(offset)


def covariance_of(jacobian: Array, residual: Array) -> tuple[Array, float]:
    """Covariance of a least-squares solution, (J^T J)^-1 s^2, and its degrees of freedom.

    jacobian, residual  (n, p) and (n,), whitened
    The covariance is infinite for parameters that cannot be separated.
    """
    n, p = jacobian.shape
    columns = np.linalg.norm(jacobian, axis=0)
    columns[columns == 0.0] = 1.0
    r = np.linalg.qr(jacobian / columns, mode="r")
    freedom = max(1, n - p)
    if np.linalg.cond(r) > SINGULAR:
        return np.full((p, p), np.inf), float(freedom)
    inverse = np.linalg.inv(r) / columns[:, None]
    return inverse @ inverse.T * (float(residual @ residual) / freedom), float(freedom)
