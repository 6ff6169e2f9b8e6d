"""Least squares of one friction law: Coulomb, asymmetric, with a static level, Stribeck (docs/theory.md 8.1 and 8.4).

Stribeck friction hardly differs from another tau, K and fc, and its static level from its velocity: a fit from afar
ends anywhere. So it starts at the fit without it, in the direction in which a little of it lowers the squares most
(all other parameters adjusting, to first order), tried for a few velocities.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rig.identify import sampled_data
from rig.identify.estimate import PARAMETERS, Estimate
from rig.identify.sampled_data import Piece, Problem, covariance_of
from rig.model.sensitivity import StribeckTheta, Theta, position, position_and_jacobian, stribeck_response

Array = NDArray[np.float64]
Law = Literal["coulomb", "asymmetric", "static", "stribeck"]

LAWS: tuple[Law, ...] = ("coulomb", "asymmetric", "static", "stribeck")
NAMES = (*PARAMETERS, "excess_V", "stribeck_rad_s")  # of the full vector, in which tau, K and vs are logarithms
LOGARITHMS = (0, 1, 6)
FC, ASYM, DELAY, EXCESS, SPEED = range(2, 7)
SHARED = len(NAMES)
STEPS = (1e-5, 1e-5, 1e-5, 1e-6, 1e-6, 1e-5, 1e-4)  # of forward differences, in the vector's units
STATE_STEP = 1e-5  # the same, of an initial velocity, rad/s

SPEEDS = (0.01, 0.03, 0.1, 0.3)  # trials of the Stribeck velocity, over the largest speed
SPEED_RANGE = (0.003, 1.0)
STARTS = 2  # of them that are iterated
STATIC_TRIALS = 24  # of a static level,
STATIC_RANGE = 2.0  # up to so many times the moving one,
STATIC_STARTS = 4  # of them that are iterated
MAX_ITERATIONS = 40
VISIBLE = 1.0  # change of the sum of squares, over the noise's variance, that shows
ROUNDING = 1e-7  # residual over the spread of positions that is rounding


@dataclass(frozen=True)
class Fit:
    """One law fitted.

    x         full vector: log tau, log K, fc, asym, delay, fs - fc, log vs, then v0 and y0 of each test
    residual  whitened, of the records alone, rad
    fitted    names of the parameters that are fitted, of ``NAMES``
    errors    standard errors of these, in their units; of fs_V too where that is fitted
    seen      whether the tests depend on what the law adds
    """

    law: Law
    x: Array
    residual: Array
    fitted: tuple[str, ...]
    errors: dict[str, float]
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
        """One of ``NAMES``, in its unit."""
        at = NAMES.index(name)
        return math.exp(self.x[at]) if at in LOGARITHMS else float(self.x[at])


@dataclass(frozen=True)
class Tests:
    """The tests that laws are fitted to.

    problem   their pieces, bounds and noise; its fifth entry of ``free`` says whether the delay is fitted
    fs_V      static level as a breakaway record shows it, V; None without one
    """

    problem: Problem
    fs_V: float | None = None

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """What is predicted of each test."""
        return self.problem.pieces

    @cached_property
    def largest_V(self) -> float:
        """Largest drive, V."""
        return max(float(np.abs(piece.drive.u_V).max()) for piece in self.pieces)

    @cached_property
    def spread_rad(self) -> float:
        """Standard deviation of the positions about their means, rad."""
        return float(np.std(np.concatenate([piece.y_rad - piece.y_rad.mean() for piece in self.pieces])))

    def start(self, estimate: Estimate) -> Array:
        """The full vector of a sampled-data estimate: asymmetric Coulomb friction, initial states by eye."""
        delay = estimate.delay_s if self.problem.free[DELAY] else 0.0
        shared = [math.log(estimate.tau_s), math.log(estimate.K_rad_s_V), estimate.fc_V, estimate.asym_V, delay]
        return self.with_states(np.array([*shared, 0.0, 0.0]))

    def with_states(self, x: Array) -> Array:
        """The shared part of ``x`` with initial states by eye."""
        states = [value for piece in self.pieces for value in sampled_data.initial_state(piece)]
        return np.concatenate((x[:SHARED], states))

    def fit(self, start: Array) -> dict[Law, Fit]:
        """All laws, from the vector ``start`` of an asymmetric Coulomb motor."""
        asymmetric = self._solve("asymmetric", start)
        symmetric = asymmetric.x.copy()
        symmetric[ASYM] = 0.0
        coulomb = self._solve("coulomb", symmetric)
        return {
            "coulomb": coulomb,
            "asymmetric": asymmetric,
            "static": self._static(asymmetric),
            "stribeck": self._stribeck(asymmetric),
        }

    def predict(self, fit: Fit) -> Fit:
        """What a law fitted elsewhere makes of these tests: only initial states, and an unknown delay, are fitted."""
        return self._solve(fit.law, self.with_states(fit.x), given=True)

    def _static(self, asymmetric: Fit) -> Fit:
        """The static level that a breakaway record gives, or else that explains the motion best."""
        x = asymmetric.x.copy()
        if self.fs_V is not None:
            x[EXCESS] = max(0.0, self.fs_V - x[FC])
            return self._solve("static", x)
        # between two drives that occur, nothing depends on the level
        levels = np.unique(np.abs(np.concatenate([piece.drive.u_V for piece in self.pieces]) + x[ASYM]))
        levels = levels[levels > x[FC]]
        trials = 0.5 * (np.concatenate((x[FC : FC + 1], levels[:-1])) + levels) - x[FC]
        trials = trials[trials < (STATIC_RANGE - 1.0) * x[FC]]
        if trials.size > STATIC_TRIALS:
            trials = np.quantile(trials, np.linspace(0.0, 1.0, STATIC_TRIALS))
        found: list[tuple[float, float]] = []
        for trial in trials.tolist():
            x[EXCESS] = trial
            residual = self.problem.whiten(self._residual(x, "static"))
            squares = float(residual @ residual)
            if abs(squares - asymmetric.squares) > VISIBLE * asymmetric.rms_rad**2:
                found.append((squares, trial))
        plain = replace(asymmetric, law="static", seen=bool(found))
        fits = []
        for _, trial in sorted(found)[:STATIC_STARTS]:
            x[EXCESS] = trial
            fits.append(self._solve("static", x))
        return min([plain, *fits], key=lambda fit: fit.squares)

    def _stribeck(self, asymmetric: Fit) -> Fit:
        """The best of a few starts; the fit without Stribeck friction where a little of it makes all of them worse."""
        x = asymmetric.x
        plain, jacobian = self._residual_and_jacobian(x, "asymmetric", self._free("asymmetric"))
        top_rad_s = max(float(np.abs(np.diff(y) / np.diff(piece.t_s)).max()) for piece, y in self._positions(x))
        fitted = np.flatnonzero(self._mask("asymmetric"))
        found: list[tuple[float, Array]] = []
        for share in SPEEDS if top_rad_s > 0.0 else ():
            trial = x.copy()
            trial[SPEED] = math.log(share * top_rad_s)
            trial[EXCESS] = STEPS[EXCESS]
            by_excess = (self._residual(trial, "stribeck") - plain) / STEPS[EXCESS]
            columns = self.problem.whiten(np.column_stack((jacobian[:, fitted], by_excess)))
            sizes = np.linalg.norm(columns, axis=0)
            sizes[sizes == 0.0] = 1.0
            step = -np.linalg.lstsq(columns / sizes, asymmetric.residual, rcond=1e-12)[0] / sizes
            left = asymmetric.residual + columns @ step
            if step[-1] > 0.0:
                trial[fitted] += step[:-1]
                trial[EXCESS] = step[-1]
                found.append((float(left @ left), trial))
        found.sort(key=lambda entry: entry[0])
        fits = [self._solve("stribeck", trial, top_rad_s=top_rad_s) for _, trial in found[:STARTS]]
        return min([*fits, replace(asymmetric, law="stribeck")], key=lambda fit: fit.squares)

    def _positions(self, x: Array) -> list[tuple[Piece, Array]]:
        return [(piece, position(_theta(x, k), piece.drive, piece.t_s)) for k, piece in enumerate(self.pieces)]

    def _free(self, law: Law, given: bool = False) -> tuple[bool, ...]:
        delay = self.problem.free[DELAY]
        if given:
            return (False, False, False, False, delay, False, False)
        stribeck = law == "stribeck"
        return (True, True, True, law != "coulomb", delay, stribeck, stribeck)

    def _mask(self, law: Law, given: bool = False) -> NDArray[np.bool_]:
        return np.array([*self._free(law, given), *([True] * (2 * len(self.pieces)))])

    def _bounds(self, top_rad_s: float) -> tuple[Array, Array]:
        low, high = self.problem.bounds()
        speeds = [math.log(share * top_rad_s) for share in SPEED_RANGE]
        at = [DELAY + 1, DELAY + 1]
        return np.insert(low, at, [0.0, speeds[0]]), np.insert(high, at, [self.largest_V, speeds[1]])

    def _residual(self, x: Array, law: Law) -> Array:
        """Predicted less recorded positions, rad."""
        return np.concatenate([_position(x, k, piece, law) - piece.y_rad for k, piece in enumerate(self.pieces)])

    def _residual_and_jacobian(self, x: Array, law: Law, free: Sequence[bool]) -> tuple[Array, Array]:
        """The residual and its derivatives by the full vector, as far as that is ``free``."""
        residuals, blocks = [], []
        for k, piece in enumerate(self.pieces):
            block = np.zeros((piece.t_s.size, x.size))
            at = SHARED + 2 * k
            if law == "stribeck":
                y = _position(x, k, piece, law)
                steps = [(i, STEPS[i]) for i in range(SHARED) if free[i]]
                for i, step in [*steps, (at, STATE_STEP)]:
                    moved = x.copy()
                    moved[i] += step
                    block[:, i] = (_position(moved, k, piece, law) - y) / step
                block[:, at + 1] = 1.0
            else:
                theta = _theta(x, k)
                y, jacobian = position_and_jacobian(theta, piece.drive, piece.t_s, theta.fc_V + x[EXCESS])
                block[:, : DELAY + 1] = jacobian[:, : DELAY + 1]
                block[:, 0] *= theta.tau_s
                block[:, 1] *= theta.K_rad_s_V
                block[:, at : at + 2] = jacobian[:, DELAY + 1 :]
            residuals.append(y - piece.y_rad)
            blocks.append(block)
        return np.concatenate(residuals), np.concatenate(blocks)

    def _solve(self, law: Law, x0: Array, given: bool = False, top_rad_s: float = 1.0) -> Fit:
        """Local solution from ``x0``; with ``given`` the law's parameters stay. ``top_rad_s`` bounds vs."""
        free, mask = self._free(law, given), self._mask(law, given)
        low, high = (bound[mask] for bound in self._bounds(top_rad_s))
        margin = 1e-9 * np.where(np.isfinite(high - low), high - low, 0.0)
        full = x0.copy()

        def residual(part: Array) -> Array:
            full[mask] = part
            return self.problem.whiten(self._residual(full, law))

        def jacobian(part: Array) -> Array:
            full[mask] = part
            return self.problem.whiten(self._residual_and_jacobian(full, law, free)[1][:, mask])

        found = least_squares(
            residual,
            np.clip(x0[mask], low + margin, high - margin),
            jac=jacobian,
            bounds=(low, high),
            x_scale="jac",
            xtol=1e-6,
            ftol=1e-6,
            gtol=1e-14,
            max_nfev=MAX_ITERATIONS,
        )
        full[mask] = found.x
        scale = np.array([math.exp(value) if i in LOGARITHMS else 1.0 for i, value in enumerate(full)])[mask]
        covariance, _ = covariance_of(np.asarray(found.jac) / scale, found.fun)
        names = tuple(name for name, fitted in zip(NAMES, free, strict=True) if fitted)
        errors = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=False))
        if "excess_V" in names:
            both = [names.index("fc_V"), names.index("excess_V")]
            errors["fs_V"] = math.sqrt(max(0.0, float(covariance[np.ix_(both, both)].sum())))
        return Fit(law, full.copy(), found.fun, names, errors)


def _theta(x: Array, k: int) -> Theta:
    """Test ``k`` under the moving level alone."""
    fc, asym, delay = (float(value) for value in x[FC : DELAY + 1])
    v0, y0 = (float(value) for value in x[SHARED + 2 * k : SHARED + 2 * k + 2])
    return Theta(math.exp(x[0]), math.exp(x[1]), fc, asym, delay, v0, y0)


def _position(x: Array, k: int, piece: Piece, law: Law) -> Array:
    """Positions of test ``k``, rad."""
    theta, excess = _theta(x, k), float(x[EXCESS])
    if law == "stribeck" and excess > 0.0:
        return stribeck_response(StribeckTheta(*theta, theta.fc_V + excess, math.exp(x[SPEED])), piece.drive, piece.t_s)
    return position(theta, piece.drive, piece.t_s, theta.fc_V + excess)
