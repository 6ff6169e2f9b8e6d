"""Least squares over pieces: a motor with some of its parts, and the start of each piece (Levenberg and Marquardt)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array
from rig.identification.departures.pieces import Cut
from rig.identification.descent import descend
from rig.identification.noise import WHITE, Noise
from rig.model.library import LIBRARY, BorderedRows, address, given
from rig.model.real_motor import Readings, RealMotor, index

CORE = ("tau_s", "K_rad_s_V", "fc_V", "bias_V")
DELAY = "delay_s"
POSITIVE = ("tau_s", "K_rad_s_V")  # fitted by their logarithms
LARGEST_STEP = 1.0  # of a logarithm, in one iteration
ITERATIONS = 40
OF_ALL = 1e-4  # of the squares: more than that is worth a step, however small they are
NEARLY = 100.0  # times a gain that is not worth a step: a larger one says too little of what is left
AS_MUCH = 1.1  # sum of squares from the start of a fit over that of the fit before it, that says as much
CANCELS = 1e8  # squares of a column over what is left of them without the pieces' starts
SINGULAR = 1e-12  # of a correlation: no variance is smaller


class Enough(NamedTuple):
    """When a fit has arrived: it gains less than ``squares`` of the whitened sum of squares, or ``share`` of it."""

    squares: float
    share: float


ENOUGH = Enough(0.01, 2e-6)  # the share is that of a model that leaves far more than noise
REGULAR = (
    1e-10  # least pivot of normal equations over their largest number, from which on any way to solve them is good
)
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
        if self.noise.white:
            white = rows / self.sigma_rad
            if cut.weight is not None:
                white[cut.weight == 0.0] = 0.0
            return white
        white = self.noise.whiten(cut.counting(rows), cut.counting(cut.t_s), cut.counting_lengths) / self.sigma_rad
        if cut.weight is None:
            return white
        every = np.zeros_like(rows)
        every[cut.weight > 0.0] = white
        return every

    def cost(self, residual: Array, motor: RealMotor) -> float:
        """Sum of squares of the whitened residual, large ones by their size; with the ``surprise`` of the motor."""
        surprise = self.surprise(motor)
        with np.errstate(over="ignore"):  # a trial far from any motor costs inf
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
        return self.rows_of(self.cut.derivatives(motor, starts, [index(name) for name in self.free]), motor)

    def rows_of(self, found: Readings, motor: RealMotor) -> Rows:
        """``rows`` of readings with their derivatives by the free numbers, as the cut gives them for this motor."""
        residual = found.y_rad - self.cut.y_rad
        unit = [getattr(motor, name) if name in POSITIVE else 1.0 for name in self.free]
        if math.isinf(self.robust_rad):
            own = Rows(
                residual, self.whitened(residual), self.whitened(found.by_number) * unit, self._by_start(found.by_start)
            )
        else:
            weight = self.robust_weight(residual)
            by = weight[:, None]
            own = Rows(residual, weight * residual, by * found.by_number * unit, by * found.by_start)
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

    def cost_of(self, rows: Rows, motor: RealMotor) -> float:
        """``cost`` of rows there."""
        if math.isinf(self.robust_rad):
            return float(rows.residual @ rows.residual)
        return self.cost(rows.residual_rad, motor)

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
    bare            fits without one of its laws that were asked for, by the law's name
    """

    problem: Problem
    motor: RealMotor
    starts: Array
    residual_rad: Array
    cost: float
    arrived: bool
    iterates: Array = field(default_factory=lambda: np.empty((0, 3)))
    bare: dict[str, Fit] = field(default_factory=dict, init=False)

    @cached_property
    def rows(self) -> Rows:
        """Its whitened residual and Jacobian."""
        return self.problem.rows_of(self.slopes, self.motor)

    @cached_property
    def slopes(self) -> Readings:
        """Its readings with their derivatives by the free numbers."""
        free = [index(name) for name in self.problem.free]
        return self.problem.cut.derivatives(self.motor, self.starts, free)

    @cached_property
    def covariance(self) -> Array:
        """Of the free numbers, (m, m), by the scatter of its residual; of the logarithms of ``POSITIVE``."""
        normal = Normal.of(self.rows, self.problem.cut)
        return np.asarray(np.linalg.pinv(normal.matrix, rcond=1e-14, hermitian=True) * unit(self))

    @cached_property
    def with_own_noise(self) -> Fit:
        """The same solution, seen as least squares with the noise of its residual, large residuals as they are."""
        problem = replace(self.problem, robust_rad=math.inf, noise=self.problem.cut.noise_of(self.residual_rad))
        if (problem.noise, problem.robust_rad) == (self.problem.noise, self.problem.robust_rad):
            return self
        seen = replace(self, problem=problem, cost=problem.cost(self.residual_rad, self.motor))
        if "slopes" in self.__dict__:
            seen.__dict__["slopes"] = self.slopes
        return seen

    @property
    def noise_rad(self) -> float:
        """What the sensor's noise alone would leave: its standard deviation, rad, and more where it adds up."""
        cut = self.problem.cut
        return self.problem.sigma_rad * float(np.sqrt(np.average(cut.adds_up**2, weights=cut.lengths)))

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


def begun(problem: Problem, motor: RealMotor, starts: Array, *, goes_on: bool = True) -> Fit:
    """The motor with these starts, (p, 2) velocity, rad/s, and position, rad, of each piece, not yet fitted.

    goes_on   whether its derivatives will be asked for: they come with the readings
    """
    if not goes_on:
        residual = problem.cut.readings(motor, starts) - problem.cut.y_rad
        return Fit(problem, motor, starts, residual, problem.cost(residual, motor), False)
    slopes = problem.cut.derivatives(motor, starts, [index(name) for name in problem.free])
    rows = problem.rows_of(slopes, motor)
    fit = Fit(problem, motor, starts, rows.residual_rad, problem.cost_of(rows, motor), False)
    fit.__dict__.update(slopes=slopes, rows=rows)
    return fit


def refitted(fit: Fit, problem: Problem | None = None, motor: RealMotor | None = None) -> Fit:
    """``fit`` with another problem, or from another motor, ready for ``solve``. The pieces stay the same.

    What another dead band takes of the drive may have been friction to the fit: where that leaves about as much as the
    fit does, it begins from there.
    """
    asked, first = problem or fit.problem, motor or fit.motor
    begin = begun(asked, first, fit.starts)
    if more_V := first.dead_band_V - fit.motor.dead_band_V:
        other = begun(asked, first._replace(fc_V=max(first.fc_V - more_V, 0.0)), fit.starts)
        if other.cost < min(begin.cost, AS_MUCH * begun(asked, fit.motor, fit.starts).cost):
            begin = other
    return replace(begin, iterates=fit.iterates)


def solve(fit: Fit, iterations: int = ITERATIONS, enough: Enough = ENOUGH) -> Fit:
    """The local solution from there.

    It has arrived where a step gains little, or as much as the linear model promised: then what is left to gain is
    what that model is off.
    """
    problem, iterates = fit.problem, [fit.iterates]
    promise = _Promise()

    def least(cost: float) -> float:
        return max(enough.squares, enough.share * cost)

    def linearised(at: Fit) -> Callable[[float], Fit] | None:
        normal = Normal.of(at.rows, problem.cut)
        if not normal.is_finite:
            return None
        held = problem.held(at.motor, normal.gradient)
        promise.made(normal.promised(held), min(least(at.cost), OF_ALL * at.cost))

        def moved(damping: float) -> Fit:
            change, starts = normal.step(held, damping)
            return begun(problem, problem.moved(at.motor, change), at.starts + starts, goes_on=promise.goes_on())

        return moved

    def is_enough(before: Fit, after: Fit) -> bool:
        iterates.append(np.array([[after.motor.tau_s, after.motor.K_rad_s_V, after.motor.fc_V]]))
        gain = before.cost - after.cost
        return gain < least(after.cost) or promise.is_kept(gain)

    found, arrived = descend(fit, linearised, is_enough, iterations)
    return replace(found, arrived=arrived, iterates=np.concatenate(iterates))


class _Promise:
    """What the linear model at a place promises a descent, and how near the last one was."""

    def __init__(self) -> None:
        self._off = 1.0  # what the last promise was off, of itself
        self._gain, self._least, self._tries, self._likely = math.inf, 0.0, 0, 1

    def made(self, gain: float, least: float) -> None:
        """By the undamped step from the next place on; ``least``: gain that is not worth a step."""
        self._likely = min(self._tries, 2) or 1  # where the last place's first step was in vain, this one's is, too
        self._gain, self._least, self._tries = gain, least, 0

    def goes_on(self) -> bool:
        """Whether the descent will go on from the next trial, as far as can be told."""
        self._tries += 1
        return self._tries == self._likely and self._gain * self._off > self._least

    def is_kept(self, gain: float) -> bool:
        """Whether a step gained what was promised, but for a gain that is not worth a step."""
        left = abs(self._gain - gain)
        self._off = min(left / max(self._gain, 1e-300), 1.0)
        return left < self._least and gain < NEARLY * self._least


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
    both: Array  # (m + 1, m + 1), of the numbers and the residual, before the starts are taken out
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
        table = BorderedRows(
            *(address(one) for one in (r, j, b, begins)),
            r.size, m, begins.size, *(one.strides[0] // one.itemsize for one in (j, b)),
        )  # fmt: skip
        LIBRARY.bordered_sums(byref(table), address(own), address(border))
        scale = own.reshape(-1, 4)[:, ::3].copy()
        # a shaft at rest shows no velocity: without this its start would go anywhere
        scale[:, 0] = np.maximum(scale[:, 0], scale[:, 1] * cut.shown_s2)
        both = np.empty((m + 1, m + 1))
        both[:-1, :-1], both[-1, -1] = j.T @ j, r @ r
        both[:-1, -1] = both[-1, :-1] = j.T @ r
        left, _ = _reduced(own, border, scale, 0.0, both)
        matrix, gradient = left[:-1, :-1], left[:-1, -1]
        if np.any(both.diagonal()[:-1] > CANCELS * matrix.diagonal()):  # what differences of squares leave is rounding
            each, pulled = sums_of_pieces(rows, begins)
            matrix, gradient = each.sum(axis=0), pulled.sum(axis=0)
        return cls(matrix, gradient, float(left[-1, -1]), own, border, both, scale)

    @property
    def raw(self) -> Array:
        """``matrix`` before the starts are taken out."""
        return self.both[:-1, :-1]

    @property
    def is_finite(self) -> bool:
        """Whether all of the rows are numbers."""
        return bool(math.isfinite(self.squares) and np.isfinite(self.matrix).all() and np.isfinite(self.gradient).all())

    def promised(self, held: NDArray[np.bool_]) -> float:
        """By how much the squares fall in the linear model, at most, while the numbers ``held`` stay."""
        return float(self.both[-1, -1]) - self.squares - float(self.gradient @ solved(self.matrix, self.gradient, held))

    def step(self, held: NDArray[np.bool_], damping: float) -> tuple[Array, Array]:
        """Change of the numbers and of the starts.

        held      which numbers stay, True or False each
        damping   share of the diagonal that is added to it, 1
        """
        left, of_starts = _reduced(self.own, self.border, self.scale, damping, self.both)
        diagonal = self.both.diagonal()[:-1]
        every = np.arange(diagonal.size)
        left[every, every] += damping * np.where(diagonal > 0.0, diagonal, 1.0)
        change = np.ones(diagonal.size + 1)
        change[:-1] = solved(left[:-1, :-1], left[:-1, -1], held)
        return change[:-1], -(of_starts @ change)


def sigma_of(fit: Fit, name: str) -> float:
    """Standard deviation of a number of the fit, by its noise."""
    normal = Normal.of(fit.rows, fit.problem.cut)
    covariance = np.linalg.pinv(normal.matrix, rcond=1e-14, hermitian=True) * unit(fit)
    at = fit.problem.free.index(name)
    return max(math.sqrt(max(float(covariance[at, at]), 0.0)), 1e-12)


def solved(matrix: Array, gradient: Array, held: NDArray[np.bool_], singular: float = 1e-14) -> Array:
    """The step (m,) of normal equations, each number in its unit; what is ``held`` stays.

    matrix, gradient   (m, m), (m,), 1 per unit of each number
    singular   share of the largest singular value, up to which rows do not show a way: along it the step is as short as
               can be
    """
    m = gradient.size
    step, work = np.empty(m), np.empty(m * (m + 4))
    table, pull = given(matrix), given(gradient)  # the library reads them where they are: they live as long as this
    into = address(held), m, address(work), address(step)
    if LIBRARY.normal_step(address(table), address(pull), *into) > max(REGULAR, singular):
        return step
    step[:] = 0.0
    free = np.flatnonzero(~held)
    if free.size:
        step[free] = -np.linalg.lstsq(matrix[np.ix_(free, free)], gradient[free], rcond=singular)[0]
    return step


def _reduced(own: Array, border: Array, scale: Array, damping: float, both: Array) -> tuple[Array, Array]:
    """``both`` without the starts, and what each start is for one of each column (p, 2, m + 1).

    damping   share of ``scale`` that is added to the starts' own sums
    """
    left, of_starts = both.copy(), np.empty_like(border)
    into = address(left), address(of_starts)
    LIBRARY.bordered_reduce(address(own), address(border), len(own), both.shape[0] - 1, damping, address(scale), *into)
    return left, of_starts


def to_diagonal_1(matrix: Array) -> Array:
    """(m,) by what to multiply rows and columns for a diagonal of 1; 0 of a number of no effect.

    matrix  (m, m) normal equations, whitened: in 1 over the units of its numbers
    """
    told = np.diag(matrix)
    return np.where(told > 0.0, 1.0 / np.sqrt(np.where(told > 0.0, told, 1.0)), 0.0)


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
