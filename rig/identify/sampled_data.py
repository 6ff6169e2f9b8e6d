"""The sampled-data estimator (docs/theory.md 7.2, 7.4 and 7.6): predict the recorded position under the recorded drive.

The commanded voltage is known exactly at every sample, so nothing has to be read off the curve: the exact motor under
the recorded drive is fitted to the recorded positions by least squares. Any drive that moves the motor both ways
will do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import stdtrit

from rig.identify.estimate import PARAMETERS, Estimate
from rig.identify.noise import WHITE, Noise, noise_of
from rig.model.sensitivity import Drive, Theta, position, position_and_jacobian
from rig.recording.series import IdentifyError, Record

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

METHOD = "sampled-data"
SHARED = 5  # tau, K, fc, asym, delay: what all records have in common
POLISHED = 3  # starts that are iterated
FIRST_CYCLES = 2.5  # length of the part of the record on which they compete, in cycles
MAX_ITERATIONS = 100
NOISE_ROUNDS = 3  # times that the noise is estimated from the residual, and the fit repeated
EXACT = 1e-7  # residual over the spread of positions that is rounding
LARGEST_LOG_K = 40.0  # keeps exp(log K) finite
SINGULAR = 1e10  # condition of the scaled Jacobian beyond which parameters cannot be told apart


class Start(NamedTuple):
    """A first guess: time constant, s, gain, (rad/s)/V, Coulomb friction, V."""

    tau_s: float
    K_rad_s_V: float
    fc_V: float


@dataclass(frozen=True)
class Piece:
    """The part of a record whose motion is predicted: samples from the first one whose drive is known."""

    t_s: Array
    y_rad: Array
    drive: Drive
    period_s: float
    rows: tuple[int, int]

    @classmethod
    def of(cls, record: Record, longest_delay_s: float) -> Piece:
        """Samples of ``record`` from the first that comes after its first drive took effect."""
        edges = record.edge_s
        first = int(np.searchsorted(record.t_s, edges[0] + longest_delay_s))
        if record.t_s.size - first < 20:
            raise IdentifyError(
                f"{record.name}: {record.t_s.size} rows are too few to fit",
                "record at least three cycles, better ten: relay.cycles",
            )
        return cls(
            record.t_s[first:],
            record.y_rad[first:],
            Drive.from_arrays(edges, record.u_V),
            record.period_s,
            (record.first_row + first, record.first_row + record.t_s.size - 1),
        )

    def until(self, length_s: float) -> Piece:
        """The first part of it, of this length, s, and of 60 samples at least."""
        stop = max(60, int(np.searchsorted(self.t_s, self.t_s[0] + length_s, side="right")))
        if stop >= self.t_s.size:
            return self
        return replace(self, t_s=self.t_s[:stop], y_rad=self.y_rad[:stop], rows=(self.rows[0], self.rows[0] + stop - 1))


@dataclass(frozen=True)
class Problem:
    """Least squares over pieces with tau, K, fc, asym and delay in common, and a v0 and y0 for each piece.

    Internally tau and K are logarithms. ``free`` says which of the shared five are fitted; the others keep the value of
    the start. ``noise`` is that of the residual, whose whitened squares are minimised.
    """

    pieces: tuple[Piece, ...]
    delay_bounds_s: tuple[float, float]
    free: tuple[bool, bool, bool, bool, bool]
    noise: Noise = WHITE

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the full vector."""
        period = min(piece.period_s for piece in self.pieces)
        duration = max(float(piece.t_s[-1] - piece.t_s[0]) for piece in self.pieces)
        largest = max(float(np.abs(piece.drive.u_V).max()) for piece in self.pieces)
        low = [math.log(0.2 * period), -LARGEST_LOG_K, 0.0, -largest, self.delay_bounds_s[0]]
        high = [math.log(10.0 * duration), LARGEST_LOG_K, largest, largest, self.delay_bounds_s[1]]
        nuisance = 2 * len(self.pieces)
        return np.array(low + [-math.inf] * nuisance), np.array(high + [math.inf] * nuisance)

    def lengths(self) -> list[int]:
        """Number of rows of each piece."""
        return [piece.t_s.size for piece in self.pieces]

    def whiten(self, rows: Array) -> Array:
        """Rows of all pieces, filtered so that the noise on them is white."""
        t_s = np.concatenate([piece.t_s for piece in self.pieces])
        return self.noise.whiten(rows, t_s, self.lengths())

    def mask(self) -> NDArray[np.bool_]:
        """Which entries of the full vector are fitted."""
        return np.array([*self.free, *([True] * (2 * len(self.pieces)))])

    def residual_and_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Predicted minus recorded positions of all pieces, rad, and the Jacobian by the full vector."""
        residuals, blocks = [], []
        tau, K = math.exp(x[0]), math.exp(x[1])
        for k, piece in enumerate(self.pieces):
            v0, y0 = x[SHARED + 2 * k], x[SHARED + 2 * k + 1]
            y, jacobian = position_and_jacobian(Theta(tau, K, x[2], x[3], x[4], v0, y0), piece.drive, piece.t_s)
            residuals.append(y - piece.y_rad)
            block = np.zeros((y.size, x.size))
            block[:, :SHARED] = jacobian[:, :SHARED]
            block[:, 0] *= tau
            block[:, 1] *= K
            block[:, SHARED + 2 * k : SHARED + 2 * k + 2] = jacobian[:, SHARED:]
            blocks.append(block)
        return np.concatenate(residuals), np.concatenate(blocks)

    def solve(self, x0: Array) -> Solution:
        """Local least-squares solution from the full vector ``x0`` (trust region, analytic Jacobian)."""
        mask = self.mask()
        low, high = (bound[mask] for bound in self.bounds())
        margin = 1e-9 * np.where(np.isfinite(high - low), high - low, 0.0)
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

        found = least_squares(
            residual,
            np.clip(x0[mask], low + margin, high - margin),
            jac=jacobian,
            bounds=(low, high),
            x_scale="jac",
            xtol=1e-11,
            ftol=1e-13,
            gtol=1e-14,
            max_nfev=MAX_ITERATIONS,
        )
        full[mask] = found.x
        left, full_jacobian = self.residual_and_jacobian(full)
        arrived = found.status > 0 or _arrived(np.asarray(found.jac), found.fun)
        return Solution(full.copy(), left, full_jacobian, np.array(iterates), arrived)


def _arrived(jacobian: Array, residual: Array) -> bool:
    """Whether the next Gauss-Newton step is small beside the standard errors, though the iterations ran out."""
    step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
    covariance, _ = covariance_of(jacobian, residual)
    return bool(np.all(np.abs(step) < 0.05 * np.sqrt(np.diag(covariance))))


@dataclass(frozen=True)
class Solution:
    """A local solution: full vector, residual, Jacobian (in logarithms of tau and K), iterates, converged or not."""

    x: Array
    residual: Array
    jacobian: Array
    iterates: Array
    converged: bool

    @property
    def cost(self) -> float:
        """Sum of squared residuals, rad^2."""
        return float(self.residual @ self.residual)


def fit(
    records: Sequence[Record],
    starts: Sequence[Start] | None = None,
    *,
    free_delay: bool | None = None,
    periods_s: Sequence[float | None] | None = None,
) -> Estimate:
    """Fit one motor to all records.

    The noise is first taken for white; where the residual wanders, it is fitted again by the noise found in it.

    records     each with its own initial state
    starts      first guesses; default: a coarse grid scored by simulation
    free_delay  fit a constant delay, between -1 period and `Record.longest_delay_s`; default: only where a record has
                no t_u_s
    periods_s   for each record the period of its limit cycle, s, or None where it has none; default: that of its drive
    Returns an ``Estimate`` with verdict "ok" unless the fit itself failed; judging it is `verdict.py`'s part.
    Raises IdentifyError if there is nothing to fit.
    """
    free = any(record.t_u_s is None for record in records) if free_delay is None else free_delay
    # a drive that acts at once must not lie at a bound, and a slipped row shows as a negative delay
    earliest = -max(record.period_s for record in records)
    bounds = (earliest, max(record.longest_delay_s for record in records)) if free else (0.0, 0.0)
    pieces = tuple(Piece.of(record, bounds[1]) for record in records)
    for record, piece in zip(records, pieces, strict=True):
        if np.ptp(piece.y_rad) == 0.0 or piece.drive.u_V.size < 2:
            still = "the position never changes" if np.ptp(piece.y_rad) == 0.0 else "the drive never changes"
            raise IdentifyError(
                f"{record.name}: {still}",
                "record a relay test (`rig relay CONFIG`), or any drive that moves the motor both ways",
            )
    problem = Problem(pieces, bounds, (True, True, True, True, free))
    guesses = list(starts) if starts else grid_starts(pieces)
    candidates = sorted((_score(pieces, guess, 0.5 * bounds[1]) for guess in guesses), key=lambda c: c[0])
    durations = [float(piece.t_s[-1] - piece.t_s[0]) for piece in pieces]
    given = periods_s or [None] * len(pieces)
    periods = [record.drive_period_s() if p is None else p for record, p in zip(records, given, strict=True)]
    first_s = FIRST_CYCLES * max((period for period in periods if period is not None), default=0.1 * max(durations))
    best = _extended(problem, [x0 for _, x0 in candidates], first_s, max(durations))
    for _ in range(NOISE_ROUNDS):
        if _exact(best, pieces):
            break
        noise = noise_of(best.residual, np.concatenate([piece.t_s for piece in pieces]), problem.lengths())
        if noise.white:
            break
        problem = replace(problem, noise=noise)
        again = problem.solve(best.x)
        best = replace(again, iterates=np.concatenate((best.iterates, again.iterates)))
    return _estimate(problem, best, records, periods)


def _extended(problem: Problem, candidates: Sequence[Array], first_s: float, last_s: float) -> Solution:
    """Solution on the whole record by way of ever longer parts of it.

    A small error of asymmetry or friction runs away over a long record, which makes false minima. Over a few cycles it
    does not: the starts compete there, and the winner stays near the minimum while the record grows.
    """
    horizon_s = first_s
    best: Solution | None = None
    while True:
        whole = horizon_s >= last_s
        pieces = problem.pieces if whole else tuple(piece.until(horizon_s) for piece in problem.pieces)
        part = replace(problem, pieces=pieces)
        x0s = candidates[:POLISHED] if best is None else [best.x]
        found = min((part.solve(x0) for x0 in x0s), key=lambda solution: solution.cost)
        if best is not None:
            found = replace(found, iterates=np.concatenate((best.iterates, found.iterates)))
        if whole:
            return found
        best = found
        horizon_s *= 2.0


def _exact(solution: Solution, pieces: Sequence[Piece]) -> bool:
    """Whether what is left is rounding."""
    spread = float(np.std(np.concatenate([piece.y_rad - piece.y_rad.mean() for piece in pieces])))
    return math.sqrt(solution.cost / solution.residual.size) < EXACT * spread


def refit(
    records: Sequence[Record],
    theta: Theta,
    free: Sequence[str] = (),
    delay_bounds_s: tuple[float, float] | None = None,
) -> Solution:
    """Prediction of the records by a given motor: initial states are fitted, and the parameters named in ``free``.

    theta           the motor, where the others start or stay; its v0 and y0 are not used
    free            names of ``PARAMETERS``
    delay_bounds_s  bounds of the delay if that is free, s; may be negative
    """
    reach = delay_bounds_s or (theta.delay_s, theta.delay_s)
    pieces = tuple(Piece.of(record, max(0.0, reach[1])) for record in records)
    tau, K, fc, asym, delay = (name in free for name in PARAMETERS)
    problem = Problem(pieces, reach, (tau, K, fc, asym, delay))
    shared = [math.log(theta.tau_s), math.log(theta.K_rad_s_V), theta.fc_V, theta.asym_V, theta.delay_s]
    return problem.solve(np.array(shared + [value for piece in pieces for value in initial_state(piece)]))


def ridge_starts(omega_rad_s: float, amplitude_rad: float, h1_V: float, h2_V: float) -> list[Start]:
    """Starts along the ridge of the describing function (docs/theory.md 4.1): fc a fraction of h2, then tau and K."""
    starts = []
    for fraction in (0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8):
        beyond = h2_V * (1.0 - fraction)
        starts.append(
            Start(
                h1_V / (omega_rad_s * beyond), math.pi * amplitude_rad * omega_rad_s / (4.0 * beyond), fraction * h2_V
            )
        )
    return starts


def grid_starts(pieces: Sequence[Piece]) -> list[Start]:
    """A coarse grid over tau and fc for any drive; K is left to the linear part of the score."""
    largest = max(float(np.abs(piece.drive.u_V).max()) for piece in pieces)
    period = min(piece.period_s for piece in pieces)
    duration = max(float(piece.t_s[-1] - piece.t_s[0]) for piece in pieces)
    taus = np.geomspace(2.0 * period, min(0.3 * duration, 200.0 * period), 7)
    return [
        Start(float(tau), math.nan, fraction * largest)
        for tau in taus
        for fraction in (0.02, 0.15, 0.3, 0.45, 0.6, 0.8)
    ]


def initial_state(piece: Piece) -> tuple[float, float]:
    """Velocity and position at the first sample, from a line through the first few."""
    n = 4
    slope, offset = np.polyfit(piece.t_s[:n] - piece.t_s[0], piece.y_rad[:n], 1)
    return float(slope), float(offset)


def _score(pieces: Sequence[Piece], start: Start, delay_s: float) -> tuple[float, Array]:
    """Sum of squares of a start after its linear part (gain, offset, drift) is solved, and the full vector it gives."""
    gain = start.K_rad_s_V
    states = [initial_state(piece) for piece in pieces]
    cost = math.inf
    asym = 0.0
    for _ in range(1 if math.isfinite(gain) else 3):
        shapes, targets = [], []
        for piece, (v0, _y0) in zip(pieces, states, strict=True):
            w0 = v0 / gain if math.isfinite(gain) else 0.0
            shape = position(Theta(start.tau_s, 1.0, start.fc_V, 0.0, delay_s, w0, 0.0), piece.drive, piece.t_s)
            shapes.append(_without_line(piece.t_s, shape))
            targets.append(_without_line(piece.t_s, piece.y_rad))
        shape, target = np.concatenate(shapes), np.concatenate(targets)
        power = float(shape @ shape)
        if power <= 0.0 or (fitted := float(shape @ target) / power) <= 0.0:
            break
        gain = fitted
        residual = target - gain * shape
        cost = float(residual @ residual)
    if not math.isfinite(gain):
        gain = 1.0
    # What is left of a drift over the record is asymmetry.
    drifts = []
    for piece, (v0, y0) in zip(pieces, states, strict=True):
        y = position(Theta(start.tau_s, gain, start.fc_V, 0.0, delay_s, v0, y0), piece.drive, piece.t_s)
        drifts.append(float(np.polyfit(piece.t_s - piece.t_s[0], piece.y_rad - y, 1)[0]))
    asym = float(np.mean(drifts)) / gain
    shared = [math.log(start.tau_s), math.log(gain), start.fc_V, asym, delay_s]
    return cost, np.array(shared + [value for state in states for value in state])


def _without_line(t_s: Array, y: Array) -> Array:
    x = t_s - t_s.mean()
    return np.asarray(y - y.mean() - x * (x @ y) / (x @ x))


def _estimate(
    problem: Problem, best: Solution, records: Sequence[Record], periods_s: Sequence[float | None]
) -> Estimate:
    mask = problem.mask()
    scale = np.ones(mask.size)
    tau, K = math.exp(best.x[0]), math.exp(best.x[1])
    scale[:2] = tau, K
    jacobian = problem.whiten(best.jacobian[:, mask] / scale[mask])
    residual = problem.whiten(best.residual)
    covariance, freedom = covariance_of(jacobian, residual)
    pairs = repetitions(problem.pieces, periods_s)
    share = repeated_share(residual, pairs)
    covariance = with_repetition(covariance, jacobian, pairs, share)
    full = np.zeros((mask.size, mask.size))
    full[np.ix_(mask, mask)] = covariance
    shared = full[:SHARED, :SHARED]
    delay, delay_error = best.x[4], math.sqrt(shared[4, 4])
    if not problem.free[4]:
        latency = np.concatenate([r.t_u_s - r.t_s for r in records if r.t_u_s is not None])
        delay = float(latency.mean())
        delay_error = float(latency.std() / math.sqrt(latency.size))
    values = (tau, K, float(best.x[2]), float(best.x[3]), float(delay))
    quantile = float(stdtrit(freedom, 0.975))
    errors = [*np.sqrt(np.diag(shared))[:4].tolist(), delay_error]
    estimate = Estimate(
        METHOD,
        *values,
        ci95={
            name: (value - quantile * error, value + quantile * error)
            for name, value, error in zip(PARAMETERS, values, errors, strict=True)
        },
        covariance=shared,
        rms_rad=math.sqrt(best.cost / best.residual.size),
        iterations=len(best.iterates),
        rows=(min(p.rows[0] for p in problem.pieces), max(p.rows[1] for p in problem.pieces)),
        iterates=best.iterates,
        residual_rad=-best.residual,
        residual_t_s=np.concatenate([piece.t_s for piece in problem.pieces]),
        repeated=share,
        wander=None if problem.noise.white else (problem.noise.memory_s, math.sqrt(problem.noise.ratio)),
    )
    if not best.converged:
        return estimate.judged("refused", "the fit did not converge: record more cycles, or with less noise")
    return estimate


def covariance_of(jacobian: Array, residual: Array) -> tuple[Array, float]:
    """Covariance of a least-squares solution, (J^T J)^-1 s^2, and the degrees of freedom behind it.

    jacobian, residual  (n, p) and (n,), whitened. Infinite where parameters cannot be told apart.
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


def repetitions(pieces: Sequence[Piece], periods_s: Sequence[float | None]) -> list[tuple[Rows, Rows]]:
    """Pairs of rows one, two, ... whole cycles apart, as far as the pieces go; none where there is no cycle."""
    pairs = []
    at = 0
    for piece, period in zip(pieces, periods_s, strict=True):
        n = piece.t_s.size
        lag = 0.0 if period is None else period
        count = int((piece.t_s[-1] - piece.t_s[0]) / lag) if lag > 2.0 * piece.period_s else 0
        for cycles in range(1, count + 1):
            later = np.searchsorted(piece.t_s, piece.t_s + cycles * lag - 0.5 * piece.period_s)
            first = np.flatnonzero(later < n)
            pairs.append((at + first, at + later[first]))
        at += n
    return pairs


def repeated_share(residual: Array, pairs: Sequence[tuple[Rows, Rows]]) -> float:
    """Share of a residual's power that comes again in each cycle, 0 to 1; 0 where chance explains it.

    What repeats does not average out over the cycles: the steps of a coarse sensor, or what the model leaves out.
    """
    power = float(residual @ residual) / residual.size
    count = sum(first.size for first, _ in pairs)
    if power == 0.0 or count == 0:
        return 0.0
    share = sum(float(residual[first] @ residual[later]) for first, later in pairs) / (count * power)
    return min(1.0, max(0.0, share))


def with_repetition(covariance: Array, jacobian: Array, pairs: Sequence[tuple[Rows, Rows]], share: float) -> Array:
    """The covariance of a fit of which ``share`` of the residual's power repeats in each cycle.

    jacobian   (n, p), whitened. Standard errors grow, correlations stay.
    """
    if share == 0.0 or not np.all(np.isfinite(covariance)):
        return covariance
    influence = covariance @ jacobian.T  # (p, n), up to the variance of the residual
    own = np.sum(influence * influence, axis=1)
    again = sum(
        (2.0 * np.sum(influence[:, first] * influence[:, later], axis=1) for first, later in pairs), np.zeros_like(own)
    )
    grow = np.sqrt(np.maximum(1.0, 1.0 + share * again / np.where(own > 0.0, own, 1.0)))
    return np.asarray(covariance * np.outer(grow, grow))
