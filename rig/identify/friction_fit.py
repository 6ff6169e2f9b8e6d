"""Least squares of one friction law (docs/theory.md 8.1 and 8.4).

The fit of a law starts at the fit without the law. For each trial it takes the direction in which a little of the law
lowers the squares most, to first order, while all other parameters adjust. A law whose parameters are scanned is tried
at all of its trials. Parameters that the breakaway ramps show are kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.identify import laws
from rig.identify.breakaway import Ramps
from rig.identify.estimate import PARAMETERS, Estimate
from rig.identify.laws.asymmetric import Asymmetric
from rig.identify.laws.law import CandidateLaw, Plain
from rig.identify.output_error import (
    SHARED,
    Accuracy,
    OutputErrorProblem,
    bounded_least_squares,
    by_full_vector,
    covariance_of,
    initial_state,
)
from rig.model.sensitivity import Theta
from rig.recording.series import Window, spread_rad

Array = NDArray[np.float64]

LOGARITHMS = (0, 1)  # entries of the vector that are logarithms: tau and K
FC, ASYM, DELAY = 2, 3, 4
STEPS = (1e-5, 1e-5, 1e-5, 1e-6, 1e-6)  # of forward differences of the first five entries, in the vector's units
STATE_STEP = 1e-5  # of forward differences of an initial velocity, rad/s
STARTS = 2  # number of a law's trials that are iterated
SCANNED = 4  # number of scanned trials that are iterated
ACCURACY = Accuracy(1e-6, 1e-6, 40)
VISIBLE = 1.0  # smallest visible change of the sum of squares, over the noise's variance
PLAIN = Asymmetric()  # every law starts from this one, and is compared with it


@dataclass(frozen=True)
class LawSolution:
    """One law fitted.

    x           full vector: log tau, log K, fc, asym, delay, the law's own parameters, then v0 and y0 of each window
    residual    whitened, of the tests alone, rad
    fitted      names of the parameters that are fitted
    covariance  of these, in their units
    seen        whether the tests depend on the parameters that the law adds
    """

    law: CandidateLaw
    x: Array
    residual: Array
    fitted: tuple[str, ...]
    covariance: Array
    seen: bool = True

    @property
    def squares(self) -> float:
        """Sum of squared residuals, rad^2."""
        return float(self.residual @ self.residual)

    @property
    def rms_rad(self) -> float:
        """RMS of the residual, rad."""
        return math.sqrt(self.squares / self.residual.size)

    def value(self, name: str) -> float:
        """The parameter ``name``, in its unit."""
        at = _names(self.law).index(name)
        return math.exp(self.x[at]) if at in _logarithms(self.law) else float(self.x[at])

    def error(self, *names: str) -> float | None:
        """Standard error of a parameter, or of the sum of several; None if one of them is not fitted."""
        if not all(name in self.fitted for name in names):
            return None
        at = [self.fitted.index(name) for name in names]
        if len(at) == 1:
            return float(np.sqrt(self.covariance[at[0], at[0]]))
        return math.sqrt(max(0.0, float(self.covariance[np.ix_(at, at)].sum())))


@dataclass(frozen=True)
class LawProblem:
    """The tests to which laws are fitted.

    problem   their windows, bounds and noise; the fifth entry of its ``free`` says whether the delay is fitted
    ramps     static levels from breakaway ramps; None without ramps
    """

    problem: OutputErrorProblem
    ramps: Ramps | None = None

    @property
    def windows(self) -> tuple[Window, ...]:
        """The predicted window of each test."""
        return self.problem.windows

    @cached_property
    def spread_rad(self) -> float:
        """Standard deviation of the positions about their means, rad."""
        return spread_rad(self.windows)

    def start(self, estimate: Estimate) -> Array:
        """The full vector of a sampled-data estimate: asymmetric Coulomb friction, rough initial states."""
        delay = estimate.delay_s if self.problem.free[DELAY] else 0.0
        shared = [math.log(estimate.tau_s), math.log(estimate.K_rad_s_V), estimate.fc_V, estimate.asym_V, delay]
        return self._with_states(np.array(shared))

    def fit(self, start: Array) -> dict[str, LawSolution]:
        """All laws by name, from the vector ``start`` of an asymmetric Coulomb motor."""
        plain = self._solve(PLAIN, start)
        return {law.name: self._fit(law, plain) for law in laws.LAWS}

    def predict(self, fit: LawSolution) -> LawSolution:
        """Prediction of these tests by a law fitted to others: only initial states and an unknown delay are fitted."""
        return self._solve(fit.law, self._with_states(fit.x[: _count(fit.law)]), given=True)

    def _with_states(self, parameters: Array) -> Array:
        """The full vector of these parameters, with rough initial states."""
        return np.concatenate((parameters, *(initial_state(window) for window in self.windows)))

    def _fit(self, law: CandidateLaw, plain: LawSolution) -> LawSolution:
        if law.name == PLAIN.name:
            return plain
        if not law.parameters:
            symmetric = plain.x.copy()
            symmetric[ASYM] = 0.0
            return self._solve(law, symmetric)
        explained = self._explained(plain)
        known = law.known(explained, self.ramps)
        if known is not None:
            return self._solve(law, _with_own(plain.x, known))
        if all(parameter.fitted for parameter in law.parameters):
            return self._from_residual(law, plain, explained)
        return self._scan(law, plain, explained)

    def _explained(self, plain: LawSolution) -> Plain:
        positions = [PLAIN.position(_theta(plain.x, SHARED, k), (), window) for k, window in enumerate(self.windows)]
        return Plain(self.windows, float(plain.x[FC]), float(plain.x[ASYM]), positions)

    def _scan(self, law: CandidateLaw, plain: LawSolution, explained: Plain) -> LawSolution:
        """The best of all trials; the fit without the law if no trial is visible."""
        found: list[tuple[float, list[float]]] = []
        for trial in law.trials(explained):
            residual = self.problem.whiten(self._residual(_with_own(plain.x, trial), law))
            squares = float(residual @ residual)
            if abs(squares - plain.squares) > VISIBLE * plain.rms_rad**2:
                found.append((squares, trial))
        fits = [self._solve(law, _with_own(plain.x, trial)) for _, trial in sorted(found)[:SCANNED]]
        return min([replace(_without(law, plain), seen=bool(found)), *fits], key=lambda fit: fit.squares)

    def _from_residual(self, law: CandidateLaw, plain: LawSolution, explained: Plain) -> LawSolution:
        """The best of a few starts; the fit without the law if a little of the law makes all starts worse."""
        before, jacobian = self._residual_and_jacobian(plain.x, PLAIN, self._free(PLAIN))
        fitted = np.flatnonzero(self._mask(PLAIN))
        trials = law.trials(explained)
        ranges = law.ranges(explained) if trials else []
        step = law.parameters[0].step
        found: list[tuple[float, Array]] = []
        for trial in trials:
            by_strength = (self._residual(_with_own(plain.x, [step, *trial[1:]]), law) - before) / step
            columns = self.problem.whiten(np.column_stack((jacobian[:, fitted], by_strength)))
            sizes = np.linalg.norm(columns, axis=0)
            sizes[sizes == 0.0] = 1.0
            move = -np.linalg.lstsq(columns / sizes, plain.residual, rcond=1e-12)[0] / sizes
            left = plain.residual + columns @ move
            if move[-1] > ranges[0][0]:
                moved = plain.x.copy()
                moved[fitted] += move[:-1]
                found.append((float(left @ left), _with_own(moved, [move[-1], *trial[1:]])))
        found.sort(key=lambda entry: entry[0])
        fits = [self._solve(law, x, ranges) for _, x in found[:STARTS]]
        return min([*fits, _without(law, plain)], key=lambda fit: fit.squares)

    def _free(self, law: CandidateLaw, given: bool = False) -> tuple[bool, ...]:
        delay = self.problem.free[DELAY]
        own = [parameter.fitted and not given for parameter in law.parameters]
        return (*[not given] * 3, law.asymmetric and not given, delay, *own)

    def _mask(self, law: CandidateLaw, given: bool = False) -> NDArray[np.bool_]:
        return np.array([*self._free(law, given), *([True] * (2 * len(self.windows)))])

    def _bounds(self, law: CandidateLaw, ranges: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
        low, high = self.problem.bounds()
        at = [SHARED] * len(ranges)
        return np.insert(low, at, [a for a, _ in ranges]), np.insert(high, at, [b for _, b in ranges])

    def _residual(self, x: Array, law: CandidateLaw) -> Array:
        """Predicted minus recorded positions, rad."""
        return np.concatenate([_position(x, law, k, window) - window.y_rad for k, window in enumerate(self.windows)])

    def _residual_and_jacobian(self, x: Array, law: CandidateLaw, free: Sequence[bool]) -> tuple[Array, Array]:
        """The residual and its derivatives by the ``free`` entries of the full vector."""
        residuals, blocks = [], []
        count = _count(law)
        for k, window in enumerate(self.windows):
            at = count + 2 * k
            theta = _theta(x, count, k)
            exact = law.position_and_jacobian(theta, x[SHARED:count].tolist(), window)
            if exact is None:
                y = _position(x, law, k, window)
                block = np.zeros((window.t_s.size, x.size))
                steps = [*STEPS, *(parameter.step for parameter in law.parameters)]
                for i, step in [*((i, step) for i, step in enumerate(steps) if free[i]), (at, STATE_STEP)]:
                    moved = x.copy()
                    moved[i] += step
                    block[:, i] = (_position(moved, law, k, window) - y) / step
                block[:, at + 1] = 1.0
            else:
                y, jacobian = exact
                block = by_full_vector(jacobian, (theta.tau_s, theta.K_rad_s_V), x.size, at)
            residuals.append(y - window.y_rad)
            blocks.append(block)
        return np.concatenate(residuals), np.concatenate(blocks)

    def _solve(
        self,
        law: CandidateLaw,
        x0: Array,
        ranges: Sequence[tuple[float, float]] | None = None,
        given: bool = False,
    ) -> LawSolution:
        """Local solution from ``x0``, the law's own parameters within ``ranges``; with ``given`` these stay fixed."""
        free, mask = self._free(law, given), self._mask(law, given)
        anywhere = [(-math.inf, math.inf)] * len(law.parameters)
        low, high = (bound[mask] for bound in self._bounds(law, anywhere if ranges is None else ranges))
        full = x0.copy()

        def residual(part: Array) -> Array:
            full[mask] = part
            return self.problem.whiten(self._residual(full, law))

        def jacobian(part: Array) -> Array:
            full[mask] = part
            return self.problem.whiten(self._residual_and_jacobian(full, law, free)[1][:, mask])

        found = bounded_least_squares(residual, jacobian, x0[mask], (low, high), ACCURACY)
        full[mask] = found.x
        logarithms = _logarithms(law)
        scale = np.array([math.exp(value) if i in logarithms else 1.0 for i, value in enumerate(full)])[mask]
        covariance, _ = covariance_of(np.asarray(found.jac) / scale, found.fun)
        names = tuple(name for name, fitted in zip(_names(law), free, strict=True) if fitted)
        own = slice(0, len(names))
        return LawSolution(law, full.copy(), found.fun, names, covariance[own, own])


def _names(law: CandidateLaw) -> tuple[str, ...]:
    return (*PARAMETERS, *(parameter.name for parameter in law.parameters))


def _logarithms(law: CandidateLaw) -> tuple[int, ...]:
    """Indices of the vector's logarithms."""
    own = (SHARED + k for k, parameter in enumerate(law.parameters) if parameter.logarithmic)
    return (*LOGARITHMS, *own)


def _count(law: CandidateLaw) -> int:
    """Number of parameters in the vector, before the initial states."""
    return SHARED + len(law.parameters)


def _with_own(plain: Array, own: Sequence[float]) -> Array:
    """The vector of asymmetric Coulomb friction, with a law's ``own`` parameters inserted."""
    return np.concatenate((plain[:SHARED], own, plain[SHARED:]))


def _without(law: CandidateLaw, plain: LawSolution) -> LawSolution:
    """The fit without a law, in the form of a fit of it: its own parameters are 0, and not fitted."""
    return replace(plain, law=law, x=_with_own(plain.x, [0.0] * len(law.parameters)))


def _theta(x: Array, count: int, k: int) -> Theta:
    """``Theta`` of window ``k``: the motor, and the window's states after the ``count`` parameters of the vector."""
    fc, asym, delay = (float(value) for value in x[FC : DELAY + 1])
    v0, y0 = (float(value) for value in x[count + 2 * k : count + 2 * k + 2])
    return Theta(math.exp(x[0]), math.exp(x[1]), fc, asym, delay, v0, y0)


def _position(x: Array, law: CandidateLaw, k: int, window: Window) -> Array:
    """Positions of window ``k``, rad."""
    count = _count(law)
    return law.position(_theta(x, count, k), x[SHARED:count].tolist(), window)
