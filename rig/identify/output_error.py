"""Output-error fit: exact motion under the recorded drive, fitted to the recorded positions (docs/theory.md 7.1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from rig.identify.estimate import PARAMETERS
from rig.identify.noise import WHITE, Noise
from rig.model.sensitivity import Theta, position_and_jacobian
from rig.recording.series import TimeSeries, Window, joined_times_s

Array = NDArray[np.float64]

SHARED = 5  # number of parameters that all windows share: tau, K, fc, asym, delay
LARGEST_LOG_K = 40.0  # keeps exp(log K) finite
SINGULAR = 1e10  # condition of the scaled Jacobian beyond which parameters cannot be separated


class Accuracy(NamedTuple):
    """When a fit ends: relative changes of the vector and of the squares, and the most iterations."""

    step: float
    squares: float
    iterations: int


ACCURACY = Accuracy(1e-11, 1e-13, 100)


@dataclass(frozen=True)
class OutputErrorProblem:
    """Least squares over windows. They share tau, K, fc, asym and delay; each window has its own v0 and y0.

    The full vector is log tau, log K, fc, asym, delay, then v0 and y0 of each window.

    free   which of the shared five are fitted; the others keep their start value
    noise  of the residual; the fit minimises the whitened squares
    """

    windows: tuple[Window, ...]
    delay_bounds_s: tuple[float, float]
    free: tuple[bool, bool, bool, bool, bool]
    noise: Noise = WHITE

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the full vector, in its order."""
        period = min(window.period_s for window in self.windows)
        duration = max(window.duration_s for window in self.windows)
        largest = max(float(np.abs(window.steps.u_V).max()) for window in self.windows)
        low = [math.log(0.2 * period), -LARGEST_LOG_K, 0.0, -largest, self.delay_bounds_s[0]]
        high = [math.log(10.0 * duration), LARGEST_LOG_K, largest, largest, self.delay_bounds_s[1]]
        nuisance = 2 * len(self.windows)
        return np.array(low + [-math.inf] * nuisance), np.array(high + [math.inf] * nuisance)

    def lengths(self) -> list[int]:
        """Number of rows of each window."""
        return [window.t_s.size for window in self.windows]

    def whiten(self, rows: Array) -> Array:
        """``rows`` of all windows, (n,) or (n, p), any unit, filtered so that their noise is white."""
        return self.noise.whiten(rows, joined_times_s(self.windows), self.lengths())

    def mask(self) -> NDArray[np.bool_]:
        """Which entries of the full vector are fitted."""
        return np.array([*self.free, *([True] * (2 * len(self.windows)))])

    def residual_and_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Predicted minus recorded positions of all windows, rad, and their Jacobian by the full vector ``x``."""
        residuals, blocks = [], []
        tau, K = math.exp(x[0]), math.exp(x[1])
        for k, window in enumerate(self.windows):
            v0, y0 = x[SHARED + 2 * k], x[SHARED + 2 * k + 1]
            y, jacobian = position_and_jacobian(Theta(tau, K, x[2], x[3], x[4], v0, y0), *window.steps, window.t_s)
            residuals.append(y - window.y_rad)
            blocks.append(by_full_vector(jacobian, (tau, K), x.size, SHARED + 2 * k))
        return np.concatenate(residuals), np.concatenate(blocks)

    def solve(self, x0: Array) -> Solution:
        """Local least-squares solution from the full vector ``x0`` (trust region, analytic Jacobian)."""
        mask = self.mask()
        low, high = (bound[mask] for bound in self.bounds())
        full = x0.copy()
        cached: dict[bytes, tuple[Array, Array]] = {}
        iterates: list[Array] = []

        def evaluate(part: Array) -> tuple[Array, Array]:
            key = part.tobytes()
            if key not in cached:
                cached.clear()
                full[mask] = part
                values, derivatives = self.residual_and_jacobian(full)
                cached[key] = self.whiten(values), self.whiten(derivatives[:, mask])
            return cached[key]

        def jacobian(part: Array) -> Array:
            derivatives = evaluate(part)[1]
            iterates.append(np.array([math.exp(full[0]), math.exp(full[1]), full[2]]))
            return derivatives

        def residual(part: Array) -> Array:
            return evaluate(part)[0]

        found = bounded_least_squares(residual, jacobian, x0[mask], (low, high), ACCURACY)
        full[mask] = found.x
        left, full_jacobian = self.residual_and_jacobian(full)
        arrived = found.status > 0 or _arrived(np.asarray(found.jac), found.fun)
        return Solution(full.copy(), left, full_jacobian, np.array(iterates), arrived)


def by_full_vector(jacobian: Array, tau_K: tuple[float, float], size: int, at: int) -> Array:
    """The derivatives of a window by the full vector, (n, ``size``), from those by ``Theta``, (n, 7).

    jacobian  rad per unit of the parameter
    tau_K     of the motor, s and (rad/s)/V: the full vector has their logarithms
    at        place of the window's v0 in the full vector
    """
    block = np.zeros((jacobian.shape[0], size))
    block[:, :SHARED] = jacobian[:, :SHARED]
    block[:, :2] *= tau_K
    block[:, at : at + 2] = jacobian[:, SHARED:]
    return block


def bounded_least_squares(
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    x0: Array,
    bounds: tuple[Array, Array],
    accuracy: Accuracy,
) -> OptimizeResult:
    """The solution by scipy's trust region from ``x0``, which is moved inside ``bounds``: low and high, (p,) each."""
    low, high = bounds
    margin = 1e-9 * np.where(np.isfinite(high - low), high - low, 0.0)
    return least_squares(
        residual,
        np.clip(x0, low + margin, high - margin),
        jac=jacobian,
        bounds=bounds,
        x_scale="jac",
        xtol=accuracy.step,
        ftol=accuracy.squares,
        gtol=1e-14,
        max_nfev=accuracy.iterations,
    )


def _arrived(jacobian: Array, residual: Array) -> bool:
    """Whether the next Gauss-Newton step is small against the standard errors, although the iterations ran out."""
    step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
    covariance, _ = covariance_of(jacobian, residual)
    return bool(np.all(np.abs(step) < 0.05 * np.sqrt(np.diag(covariance))))


@dataclass(frozen=True)
class Solution:
    """A local solution: full vector, residual, Jacobian (by log tau and log K), iterates, and whether it converged."""

    x: Array
    residual: Array
    jacobian: Array
    iterates: Array
    converged: bool

    @property
    def cost(self) -> float:
        """Sum of squared residuals, rad^2."""
        return float(self.residual @ self.residual)


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
    return problem.solve(np.array(shared + [value for window in windows for value in initial_state(window)]))


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
