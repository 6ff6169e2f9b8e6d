"""Least squares over pieces: a motor with some of its parts, and the start of each piece (Levenberg and Marquardt)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.identification.departures.pieces import Cut
from rig.identification.descent import descend
from rig.identification.noise import WHITE, Noise
from rig.model.library import LIBRARY, BorderedRows, address
from rig.model.real_motor import RealMotor, index

Array = NDArray[np.float64]

CORE = ("tau_s", "K_rad_s_V", "fc_V", "bias_V")
DELAY = "delay_s"
POSITIVE = ("tau_s", "K_rad_s_V")  # fitted by their logarithms
LARGEST_STEP = 1.0  # of a logarithm, in one iteration
ITERATIONS = 40
VELOCITY_SHOWN = 0.1  # share of a piece's duration in which its start's velocity is taken to show at least
CANCELS = 1e8  # squares of a column over what is left of them without the pieces' starts
SINGULAR = 1e-12  # of a correlation: no variance is smaller


class Enough(NamedTuple):
    """When a fit has arrived: it gains less than ``squares`` of the whitened sum of squares, or ``share`` of it."""

    squares: float
    share: float


ENOUGH = Enough(0.01, 2e-6)  # the share is that of a model that leaves far more than noise
BOUNDLESS: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of some numbers of a motor before a fit, or from beside it.

    names   fields of ``RealMotor``; those that a fit has not free stay as they are
    mean    (k,) of ``POSITIVE`` the logarithm
    root    (m, k): root.T @ root is the inverse of their covariance
    """

    names: tuple[str, ...]
    mean: Array
    root: Array

    @classmethod
    def of(cls, names: Sequence[str], mean: Sequence[float], covariance: Array) -> Known:
        """From a covariance, (k, k); of a combination of numbers without a variance nothing is known."""
        size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        variances, ways = np.linalg.eigh(covariance / np.outer(size, size))
        known = variances > SINGULAR  # a shaft that turned one way tells nothing of one of them
        root = np.where(known, 1.0 / np.sqrt(np.where(known, variances, 1.0)), 0.0)[:, None] * ways.T / size
        return cls(tuple(names), np.array(mean), root)

    @classmethod
    def of_sum(cls, names: Sequence[str], value_V: float, error_V: float) -> Known:
        """From the sum of these voltages, and its standard error."""
        mean = np.zeros(len(names))
        mean[0] = value_V
        return cls(tuple(names), mean, np.full((1, len(names)), 1.0 / error_V))

    def by(self, names: Sequence[str]) -> Array:
        """Derivatives of ``off`` by these fields, (m, len(names)), by the logarithms of ``POSITIVE``."""
        found = np.zeros((self.root.shape[0], len(names)))
        for k, name in enumerate(names):
            if name in self.names:
                found[:, k] = self.root[:, self.names.index(name)]
        return found

    def off(self, motor: RealMotor) -> Array:
        """How far the motor is from it, (m,), in independent standard deviations."""
        values = [getattr(motor, name) for name in self.names]
        scaled = [math.log(v) if name in POSITIVE else v for name, v in zip(self.names, values, strict=True)]
        return np.asarray(self.root @ (np.array(scaled) - self.mean))


@dataclass(frozen=True, eq=False)
class Problem:
    """What is fitted to what.

    cut        the tests in pieces
    free       fields of ``RealMotor`` that are fitted
    limits     their bounds; without an entry: none
    sigma_rad  standard deviation of the white noise, rad
    robust_rad residuals beyond it count by their size, not by its square (soft L1); inf: least squares
    noise      coloured noise; without robust_rad only
    known      what is known of numbers beforehand, or from beside the tests; None: nothing
    """

    cut: Cut
    free: tuple[str, ...]
    limits: Mapping[str, tuple[float, float]]
    sigma_rad: float
    robust_rad: float = math.inf
    noise: Noise = WHITE
    known: Known | None = None

    def whitened(self, rows: Array) -> Array:
        """``rows``, (n,) or (n, k), rad, filtered to unit white noise; each piece has noise of its own."""
        cut = self.cut
        white = self.noise.whiten(cut.counting(rows), cut.counting(cut.t_s), cut.counting_lengths) / self.sigma_rad
        if cut.weight is None:
            return white
        every = np.zeros_like(rows)
        every[cut.weight > 0.0] = white
        return every

    def cost(self, residual: Array, motor: RealMotor) -> float:
        """Sum of squares of the whitened residual, large ones by their size; with the ``surprise`` of the motor."""
        surprise = self.surprise(motor)
        if math.isinf(self.robust_rad):
            white = self.whitened(residual)
            return float(white @ white) + surprise
        share = (self.cut.counting(residual) / self.robust_rad) ** 2
        return 2.0 * (self.robust_rad / self.sigma_rad) ** 2 * float(np.sum(np.sqrt(1.0 + share) - 1.0)) + surprise

    def surprise(self, motor: RealMotor) -> float:
        """Sum of squares of how far the motor is from what is known beforehand, in standard deviations."""
        if self.known is None:
            return 0.0
        off = self.known.off(motor)
        return float(off @ off)

    def rows(self, motor: RealMotor, starts: Array) -> Rows:
        """Residual and Jacobian there, whitened, by the logarithms of ``POSITIVE``; ``starts``: rad/s, rad.

        What is known beforehand follows, as further rows of the last piece.
        """
        found = self.cut.derivatives(motor, starts, [index(name) for name in self.free])
        residual = found.y_rad - self.cut.y_rad
        by_number = found.by_number * [getattr(motor, name) if name in POSITIVE else 1.0 for name in self.free]
        if math.isinf(self.robust_rad):
            own = Rows(residual, self.whitened(residual), self.whitened(by_number), self._by_start(found.by_start))
        else:
            weight = self.robust_weight(residual)
            by = weight[:, None]
            own = Rows(residual, weight * residual, by * by_number, by * found.by_start)
        return self._with_known(own, motor)

    def robust_weight(self, residual: Array) -> Array:
        """(n,) 1/rad: of each row, less of a large residual, rad."""
        weight = (1.0 + (residual / self.robust_rad) ** 2) ** -0.25 / self.sigma_rad
        return weight if self.cut.weight is None else np.asarray(weight * self.cut.weight)

    def _by_start(self, by_start: Array) -> Array:
        white = self.whitened(by_start)
        if self.cut.resting is not None:
            white[self.cut.resting[self.cut.piece], 0] = 0.0
        return white

    def _with_known(self, rows: Rows, motor: RealMotor) -> Rows:
        if self.known is None:
            return rows
        off = self.known.off(motor)
        return Rows(
            rows.residual_rad,
            np.concatenate((rows.residual, off)),
            np.concatenate((rows.by_number, self.known.by(self.free))),
            np.concatenate((rows.by_start, np.zeros((off.size, 2)))),
        )

    def moved(self, motor: RealMotor, change: Array) -> RealMotor:
        """The motor after a step ``change`` of its free numbers, each in its unit, within its limits."""
        new = {}
        for name, step in zip(self.free, change.tolist(), strict=True):
            value = getattr(motor, name)
            if name in POSITIVE:
                value *= math.exp(max(-LARGEST_STEP, min(LARGEST_STEP, step)))
            else:
                value += step
            low, high = self.limits.get(name, BOUNDLESS)
            new[name] = max(low, min(high, value))
        return motor._replace(**new)

    def held(self, motor: RealMotor, gradient: Array) -> NDArray[np.bool_]:
        """Which numbers stand at a bound that the descent along ``gradient``, 1 per unit, would pass."""
        out = np.zeros(len(self.free), dtype=bool)
        for k, name in enumerate(self.free):
            low, high = self.limits.get(name, BOUNDLESS)
            value = getattr(motor, name)
            out[k] = (value <= low and gradient[k] > 0.0) or (value >= high and gradient[k] < 0.0)
        return out


@dataclass(frozen=True, eq=False)
class Rows:
    """Whitened rows: the residual in rad, and whitened; its derivatives by the numbers and by the own piece's start."""

    residual_rad: Array
    residual: Array
    by_number: Array
    by_start: Array


@dataclass(frozen=True, eq=False)
class Fit:
    """A local solution.

    motor, starts   the numbers, and (p, 2) velocity and position at each piece's start
    problem         what was fitted
    residual_rad    predicted less recorded, rad
    cost            its whitened sum of squares
    arrived         whether the iterations came to an end
    iterates        tau, K, fc after each
    """

    problem: Problem
    motor: RealMotor
    starts: Array
    residual_rad: Array
    cost: float
    arrived: bool
    iterates: Array = field(default_factory=lambda: np.empty((0, 3)))

    @property
    def rms_rad(self) -> float:
        """RMS residual of the rows that count, rad."""
        return float(np.sqrt(np.mean(self.problem.cut.counting(self.residual_rad) ** 2)))

    @property
    def scatter_rad(self) -> float:
        """Standard deviation of the residual by its median, which outliers do not move, rad."""
        return float(np.median(np.abs(self.problem.cut.counting(self.residual_rad)))) / 0.6745


def start(problem: Problem, motor: RealMotor) -> Fit:
    """The motor with starts as the record shows them, not yet fitted."""
    return begun(problem, motor, problem.cut.guessed())


def begun(problem: Problem, motor: RealMotor, starts: Array) -> Fit:
    """The motor with these starts, (p, 2) velocity, rad/s, and position, rad, of each piece, not yet fitted."""
    residual = problem.cut.readings(motor, starts) - problem.cut.y_rad
    return Fit(problem, motor, starts, residual, problem.cost(residual, motor), False)


def refitted(fit: Fit, problem: Problem | None = None, motor: RealMotor | None = None) -> Fit:
    """``fit`` with another problem, or from another motor, ready for ``solve``. The pieces stay the same."""
    given = replace(fit, problem=problem or fit.problem, motor=motor or fit.motor)
    residual = given.problem.cut.readings(given.motor, given.starts) - given.problem.cut.y_rad
    return replace(given, residual_rad=residual, cost=given.problem.cost(residual, given.motor), arrived=False)


def solve(fit: Fit, iterations: int = ITERATIONS, enough: Enough = ENOUGH) -> Fit:
    """The local solution from there."""
    problem, iterates = fit.problem, [fit.iterates]

    def linearised(at: Fit) -> Callable[[float], Fit] | None:
        normal = Normal.of(problem.rows(at.motor, at.starts), problem.cut)
        held = problem.held(at.motor, normal.gradient)

        def moved(damping: float) -> Fit:
            change, starts = normal.step(held, damping)
            return begun(problem, problem.moved(at.motor, change), at.starts + starts)

        return moved if normal.is_finite else None

    def is_enough(before: Fit, after: Fit) -> bool:
        iterates.append(np.array([[after.motor.tau_s, after.motor.K_rad_s_V, after.motor.fc_V]]))
        return before.cost - after.cost < max(enough.squares, enough.share * after.cost)

    found, arrived = descend(fit, linearised, is_enough, iterations)
    return replace(found, arrived=arrived, iterates=np.concatenate(iterates))


def unit(fit: Fit) -> float:
    """Variance of a least-squares fit's whitened residual."""
    freedom = fit.problem.cut.freedom - len(fit.problem.free)
    return max(fit.cost / max(freedom, 1), 1e-12)


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations with the starts of the pieces taken out: each piece has a 2 x 2 block of its own.

    matrix, gradient, squares   (m, m), (m,) and the sum of squares, of the numbers alone, at the best starts for each
    """

    matrix: Array
    gradient: Array
    squares: float
    own: Array  # (p, 2, 2)
    border: Array  # (p, 2, m + 1), the last column with the residual
    raw: Array  # (m, m), before the starts are taken out
    raw_gradient: Array
    scale: Array  # (p, 2): of the starts; damping is measured in it

    @classmethod
    def of(cls, rows: Rows, cut: Cut) -> Normal:
        """From whitened rows."""
        b, j = (
            part if part.strides[1] == part.itemsize else np.ascontiguousarray(part)
            for part in (rows.by_start, rows.by_number)
        )
        r, begins, m = rows.residual, cut.begins, j.shape[1]
        own, border = np.empty((begins.size, 2, 2)), np.empty((begins.size, 2, m + 1))
        given = BorderedRows(
            *(address(one) for one in (r, j, b, begins)),
            r.size, m, begins.size, *(one.strides[0] // one.itemsize for one in (j, b)),
        )  # fmt: skip
        LIBRARY.bordered_sums(byref(given), address(own), address(border))
        scale = np.einsum("pii->pi", own).copy()
        # a shaft at rest shows no velocity: without this its start would go anywhere
        scale[:, 0] = np.maximum(scale[:, 0], scale[:, 1] * (VELOCITY_SHOWN * cut.durations_s) ** 2)
        raw, raw_gradient = j.T @ j, j.T @ r
        left, _ = _reduced(own, border, scale, 0.0, _bordered(raw, raw_gradient, float(r @ r)))
        matrix, gradient = left[:-1, :-1], left[:-1, -1]
        if np.any(np.diag(raw) > CANCELS * np.diag(matrix)):  # what differences of squares leave is rounding
            each, pulled = sums_of_pieces(rows, begins)
            matrix, gradient = each.sum(axis=0), pulled.sum(axis=0)
        return cls(matrix, gradient, float(left[-1, -1]), own, border, raw, raw_gradient, scale)

    @property
    def is_finite(self) -> bool:
        """Whether all of the rows are numbers."""
        return bool(math.isfinite(self.squares) and np.isfinite(self.matrix).all() and np.isfinite(self.gradient).all())

    def step(self, held: NDArray[np.bool_], damping: float) -> tuple[Array, Array]:
        """Change of the numbers and of the starts.

        held      which numbers stay, True or False each
        damping   share of the diagonal that is added to it, 1
        """
        diagonal = np.diag(self.raw)
        damped = self.raw + np.diag(damping * np.where(diagonal > 0.0, diagonal, 1.0))
        left, solved = _reduced(self.own, self.border, self.scale, damping, _bordered(damped, self.raw_gradient, 0.0))
        change = np.zeros(diagonal.size + 1)
        change[-1] = 1.0
        free = np.flatnonzero(~held)
        if free.size:
            change[free] = -np.linalg.lstsq(left[np.ix_(free, free)], left[free, -1], rcond=1e-14)[0]
        return change[:-1], -(solved @ change)


def _bordered(matrix: Array, gradient: Array, squares: float) -> Array:
    """(m + 1, m + 1) sums of products of the numbers' columns and the residual."""
    both = np.empty((gradient.size + 1, gradient.size + 1))
    both[:-1, :-1], both[:-1, -1], both[-1, :-1], both[-1, -1] = matrix, gradient, gradient, squares
    return both


def _reduced(own: Array, border: Array, scale: Array, damping: float, both: Array) -> tuple[Array, Array]:
    """``both``, which is filled anew, without the starts, and what each start is for one of each column (p, 2, m + 1).

    damping   share of ``scale`` that is added to the starts' own sums
    """
    solved = np.empty_like(border)
    into = address(both), address(solved)
    LIBRARY.bordered_reduce(address(own), address(border), len(own), both.shape[0] - 1, damping, address(scale), *into)
    return both, solved


def sums_of_pieces(rows: Rows, begins: NDArray[np.int64]) -> tuple[Array, Array]:
    """Normal equations (p, m, m) and (p, m) of each piece, its start taken out; ``begins``: first rows, row numbers."""
    ends = np.append(begins[1:], rows.residual.size)
    matrix, gradient = [], []
    for begin, end in zip(begins, ends, strict=True):
        own = np.linalg.qr(rows.by_start[begin:end])[0]
        both = np.column_stack((rows.by_number[begin:end], rows.residual[begin:end]))
        left = both - own @ (own.T @ both)
        squares = left.T @ left
        matrix.append(squares[:-1, :-1])
        gradient.append(squares[:-1, -1])
    return np.array(matrix), np.array(gradient)


def limits_of(free: Sequence[str], cut: Cut, delay_s: tuple[float, float]) -> dict[str, tuple[float, float]]:
    """Bounds of the plain motor's numbers among ``free``."""
    largest = max(float(np.abs(window.steps.u_V).max()) for window in cut.windows)
    period = min(window.period_s for window in cut.windows)
    longest = max(window.duration_s for window in cut.windows)
    bounds = {
        "tau_s": (0.2 * period, 10.0 * longest),
        "fc_V": (0.0, largest),
        "bias_V": (-largest, largest),
        DELAY: delay_s,
    }
    return {name: bounds[name] for name in free if name in bounds}
