"""The sampled-data estimator (docs/theory.md 7.2, 7.4 and 7.6): predict the recorded position under the recorded drive.

The voltage is known exactly at every sample. So the exact motor under the recorded drive can be fitted to the recorded
positions by least squares; the curve needs no features such as edges or extrema. Any drive that moves the motor in both
directions will do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rig.core.arrays import Array
from rig.identification.chance import student_975
from rig.identification.departures.fit import Enough
from rig.identification.driven import together
from rig.identification.estimate import Estimate, intervals
from rig.identification.estimator import Estimator
from rig.identification.in_pieces import MOST_ROWS, error_of, fit_in_pieces, is_reversed, of_pieces
from rig.identification.measurements import Measurements
from rig.identification.output_error import (
    ENOUGH,
    SHARED,
    OutputErrorProblem,
    Solution,
    covariance_of,
    initial_state,
    rests_once,
)
from rig.identification.plausibility import DID_IT_TURN, one_way
from rig.identification.repetition import repeated_share, repetitions, with_repetition
from rig.identification.sampled_data_verdict import NEGLIGIBLE, confounding, judge
from rig.identification.side_by_side import side_by_side
from rig.identification.starts import Start, grid_starts, ridge_starts
from rig.identification.thinning import of_one_step, thinned
from rig.identification.verdict import spread_rad as test_spread_rad
from rig.model.real_motor import Frame, RealMotor, readings_of, windows_of
from rig.model.sensitivity import Theta, position
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import (
    TimeSeries,
    Window,
    delays_of_all_s,
    joined_times_s,
    noise_of_all_rad,
    spread_rad,
)
from rig.run_folder.recording.stage import StageKind

METHOD = "sampled-data"
POLISHED = 3  # number of starts that are iterated
FIRST_CYCLES = 2.5  # length of the first part of the recording, in cycles: the starts are compared there
NEAR_PERIODS = 4.0  # periods between two delays to start from
NOISE_ROUNDS = 3  # rounds of estimating the noise from the residual and repeating the fit
PIECES_FROM = 3.0  # residual over the sensor's noise from which on pieces of the tests are tried
BETTER = 0.9  # error of what the pieces' motor predicts of blocks over that of the whole tests' motor: then it counts
ROWS_OF_TAU = 5.0  # rows taken as one in a time constant, at least
ROWS_OF_STEPS = 8000  # of a coarse sensor, at least
ROUGHLY = Enough(0.0, 1e-6)  # of a fit that another one follows
FAR_FROM_NOISE, FAR = 8.0, Enough(0.0, 1e-4)  # residual over noise of a fit whose last digits mean nothing
COMPARED = 30  # iterations of a part, at most: a start that needs more has lost its way
SAME = 1e-5  # difference of squares of two fits that ended in the same place
ROUNDS_OF_GAIN = 3
SCORED_ROWS = 600  # of all tests: by so many starts are compared
EXACT = 1e-7  # residual over the spread of positions that is only rounding


class SampledData(Estimator):
    """The estimator to use. It takes any drive, as it acted: the guard may have changed it."""

    name = METHOD

    def fit(self, data: Measurements) -> Estimate:
        """From everything driven. Start along the ridge of the first cycle; without a cycle, from a coarse grid."""
        starts = None
        if data.settled:
            first = data.settled[0]
            starts = ridge_starts(first.omega_rad_s, first.amplitude_rad, first.h1_V, first.h2_V)
        searches = [test for test in data.tests if test.stage is not None and test.stage.kind is StageKind.SEARCH]
        tests, beside, periods_s = data.tests, data.beside, data.periods_s
        if 0 < len(searches) < len(tests):  # the others tell too little alone
            tests, beside, periods_s = searches, [*tests[len(searches) :], *beside], [None] * len(searches)
        of_tests = nearest(tests, starts, periods_s)
        found = together(of_tests, tests, beside)
        estimate = replace(found.estimate, remarks=found.remarks)
        # a search that stands for tests does not speak for those that it contradicts
        replaced = tuple(f"{test.name}: " for test in data.tests[len(searches) :]) if tests is searches else ()
        objections = [*found.objections, *(remark for remark in found.remarks if remark.startswith(replaced))]
        return estimate.judged("doubtful", *objections) if objections else estimate

    def judge(self, estimate: Estimate, data: Measurements, earlier: Mapping[str, Estimate]) -> Estimate:
        """Judge it by the motion in every sample."""
        return judge(estimate, data.tests)

    def notes(self, estimate: Estimate, data: Measurements) -> list[str]:
        """Records left out, the cost of an unknown delay, and changes of the drive by the guard."""
        return [*estimate.remarks, *filter(None, [confounding(estimate)]), *data.guarded]


def fit(
    tests: Sequence[TimeSeries],
    starts: Sequence[Start] | None = None,
    *,
    free_delay: bool | None = None,
    periods_s: Sequence[float | None] | None = None,
) -> Estimate:
    """Fit one motor to all tests.

    The first fit takes the noise for white. If its residual is coloured, the fit is repeated with that noise.

    tests       each has its own initial state
    starts      first guesses; default: a coarse grid, scored by simulation
    free_delay  whether to fit a constant delay, between -1 period and `TimeSeries.longest_delay_s`; default: only if a
                test has no t_u_s
    periods_s   for each test the period of its limit cycle, s, or None without a cycle; default: the drive's period
    Returns an ``Estimate`` with verdict "ok" unless the fit itself failed; `SampledData.judge` judges it.
    Raises IdentifyError if there is nothing to fit.
    """
    return _white_fit(tests, starts, free_delay=free_delay, periods_s=periods_s).estimate


@dataclass(frozen=True, eq=False)
class _WhiteFit:
    """A fit of these tests that takes the noise for white.

    rows   first and last row of the recordings, where the fit has several as one; None: those of the problem
    thin   the solution of fewer rows that it comes from; None: it comes from none
    """

    problem: OutputErrorProblem
    best: Solution
    tests: Sequence[TimeSeries]
    periods_s: Sequence[float | None]
    rows: tuple[int, int] | None = None
    thin: Solution | None = None

    @property
    def rms_rad(self) -> float:
        """RMS residual, rad."""
        return math.sqrt(self.best.cost / self.best.residual.size)

    @cached_property
    def estimate(self) -> Estimate:
        """The estimate, fitted again with the noise that its residual shows."""
        found = _estimate(*_with_noise(*rests_once(self.problem, self.best)), self.tests, self.periods_s)
        return found if self.rows is None else replace(found, rows=self.rows)


def _white_fit(
    tests: Sequence[TimeSeries],
    starts: Sequence[Start] | None,
    *,
    free_delay: bool | None = None,
    periods_s: Sequence[float | None] | None = None,
    earlier: _WhiteFit | None = None,
) -> _WhiteFit:
    """As ``fit``, with white noise; ``earlier``: from other starts, which is taken where fewer rows lead there, too."""
    free = any(test.t_u_s is None for test in tests) if free_delay is None else free_delay
    given = periods_s or [None] * len(tests)
    periods = [test.drive_period_s() if p is None else p for test, p in zip(tests, given, strict=True)]
    of_step = min(sum(map(len, tests)) // ROWS_OF_STEPS, *map(of_one_step, tests))
    if of_step > 1:  # a coarse sensor
        found = _fitted([thinned(test, of_step) for test in tests], starts, periods, _delays_s(tests, free), earlier)
        if math.exp(found.best.x[0]) >= ROWS_OF_TAU * of_step * max(test.period_s for test in tests):
            first, last = min(test.first_row for test in tests), max(test.first_row + len(test) for test in tests)
            return replace(found, rows=(first, last - 1))
    return _fitted(tests, starts, periods, _delays_s(tests, free), earlier)


def _fitted(
    tests: Sequence[TimeSeries],
    starts: Sequence[Start] | None,
    periods_s: Sequence[float | None],
    delay_s: tuple[float, float] | None,
    earlier: _WhiteFit | None = None,
) -> _WhiteFit:
    """``_white_fit`` to these rows; ``delay_s``: bounds of the delay, s; None: it is known."""
    problem = _problem(tests, delay_s)
    guesses = list(starts) if starts else grid_starts(problem.windows)
    cycles_s = [period for period in periods_s if period is not None]
    thin = _of_fewer_rows(problem, tests, guesses, cycles_s)
    if thin is None:
        return _WhiteFit(problem, _extended(problem, _candidates(problem, guesses), cycles_s), tests, periods_s)
    if earlier is not None and earlier.thin is not None and math.isclose(earlier.thin.cost, thin.cost, rel_tol=SAME):
        return earlier
    states = [value for window in problem.windows for value in initial_state(window)]
    noise_rad = noise_of_all_rad(tests)
    enough = ENOUGH if thin.rms_rad < FAR_FROM_NOISE * noise_rad else FAR
    best = problem.solve(np.concatenate((thin.x[:SHARED], states)), enough).after(thin)
    return _WhiteFit(problem, best, tests, periods_s, thin=thin)


def _delays_s(tests: Sequence[TimeSeries], free_delay: bool) -> tuple[float, float] | None:
    """Bounds of a delay that is fitted, s. 0 must not lie at one: a column that is off by a row is a negative delay."""
    if not free_delay:
        return None
    return delays_of_all_s(tests)


def _of_fewer_rows(
    problem: OutputErrorProblem, tests: Sequence[TimeSeries], starts: Sequence[Start], periods_s: Sequence[float]
) -> Solution | None:
    """The solution of fewer rows of long tests; None where the tests are short, or tau is for those rows."""
    rows = math.ceil(sum(len(test) for test in tests) / MOST_ROWS)
    if rows < 2:
        return None
    try:
        thin = _problem([thinned(test, rows) for test in tests], problem.delay_bounds_s if problem.free[4] else None)
    except IdentifyError:
        return None
    first = _extended(thin, _candidates(thin, starts), periods_s)
    if math.exp(first.x[0]) < ROWS_OF_TAU * max(window.period_s for window in thin.windows):
        return None
    return first


def nearest(tests: Sequence[TimeSeries], starts: Sequence[Start] | None, periods_s: Sequence[float | None]) -> Estimate:
    """``fit``, or a motor from pieces of the tests where it leaves more than noise, and that predicts better.

    Over the whole tests a fit may end anywhere. So it is tried again from the motor of the pieces; and where the tests
    do not bear a plain motor over their whole length, the pieces' own motor is the estimate. Of two fits the better one
    is fitted again with its noise; the other one needs none.
    """
    white = _white_fit(tests, starts, periods_s=periods_s)
    noise = noise_of_all_rad(tests)
    most_rad = max(PIECES_FROM * noise, NEGLIGIBLE * test_spread_rad(tests))
    if white.rms_rad <= most_rad:
        found = white.estimate
        if found.converged and found.rms_rad <= most_rad:
            return found
    free = any(test.t_u_s is None for test in tests)
    rows = math.ceil(sum(len(test) for test in tests) / MOST_ROWS)
    thin = [thinned(test, rows) for test in tests]
    try:
        if is_reversed(thin):
            return white.estimate  # no pieces mend it
        pieces, blocks = fit_in_pieces(thin, free_delay=free)
    except IdentifyError:
        return white.estimate  # too short for pieces
    motor = pieces.motor
    start = Start(motor.tau_s, motor.K_rad_s_V, motor.fc_V)
    again = _white_fit(tests, [start], free_delay=free, periods_s=periods_s, earlier=white)
    if again.best.converged and (not white.best.converged or again.rms_rad < white.rms_rad):
        white = again
    found = white.estimate
    if found.converged and not found.rms_rad > PIECES_FROM * noise:
        return found  # of noise that adds up there is more
    delay_s = found.delay_s if free else 0.0
    of_whole = RealMotor(found.tau_s, found.K_rad_s_V, max(found.fc_V, 0.0), found.asym_V, delay_s)
    pieces_error, whole_error = (error_of(one, pieces.problem, blocks) for one in (motor, of_whole))
    if found.converged and pieces_error > BETTER * whole_error:
        return found
    return of_pieces(pieces, found, tests)


def _problem(tests: Sequence[TimeSeries], delay_s: tuple[float, float] | None) -> OutputErrorProblem:
    """The fit as a problem of least squares with white noise, with ``delay_s`` as ``_fitted``.

    Raises IdentifyError if a test's position never changes, or all drives are the same.
    """
    bounds = delay_s or (0.0, 0.0)
    windows = tuple(test.predictable(bounds[1]) for test in tests)
    drives_V = {float(u_V) for window in windows for u_V in window.steps.u_V}
    for test, window in zip(tests, windows, strict=True):
        still = "position" if np.ptp(window.y_rad) == 0.0 else "drive" if len(drives_V) < 2 else None
        if still is not None:
            cause = f"{test.name}: the {still} never changes"
            cure = (
                "record a relay test (`rig relay CONFIG`), or any drive that moves the motor both ways; or give runs "
            )
            cure += "of other drives with it"
            if still == "position":
                cause += f", under drives up to {np.abs(test.u_V).max():.3g} V"
                cure = f"{DID_IT_TURN}; {cure}"
            raise IdentifyError(cause, cure)
    return OutputErrorProblem(windows, bounds, (True, True, True, not one_way(tests), delay_s is not None))


def _candidates(problem: OutputErrorProblem, starts: Sequence[Start]) -> list[Array]:
    """The full vectors of the starts that promise most, the best first."""
    windows = problem.windows
    states = [initial_state(window) for window in windows]
    shapes = _Shapes(windows, np.array([v0 for v0, _y0 in states]))
    scored = []
    for one in starts:
        gain, rounds = one.K_rad_s_V, 1 if math.isfinite(one.K_rad_s_V) else ROUNDS_OF_GAIN
        for delay_s in _first_delays(problem):
            cost, found = shapes.score(one._replace(K_rad_s_V=gain), delay_s, rounds)
            scored.append((cost, one._replace(K_rad_s_V=found), delay_s))
            if not math.isfinite(one.K_rad_s_V) and math.isfinite(cost):  # at the next delay it is nearly the same
                gain, rounds = found, 1
    best = sorted(scored, key=lambda candidate: candidate[0])[:POLISHED]
    return [_full_vector(windows, states, one, delay_s, free_asym=problem.free[3]) for _, one, delay_s in best]


def _first_delays(problem: OutputErrorProblem) -> list[float]:
    """Delays to start from, s: the middle of what is possible; where that is many periods wide, several."""
    low_s, high_s = problem.delay_bounds_s
    period_s = max(window.period_s for window in problem.windows)
    if all(window.series.delay_s is None for window in problem.windows):
        return [0.5 * high_s]
    apart = max(1, round((high_s - low_s) / (NEAR_PERIODS * period_s)))
    return [low_s + (high_s - low_s) * (k + 0.5) / apart for k in range(apart)]


def _with_noise(problem: OutputErrorProblem, best: Solution) -> tuple[OutputErrorProblem, Solution]:
    """The problem with the noise that the residual shows, and its solution; both as they are if the noise is white."""
    for _ in range(NOISE_ROUNDS):
        if best.rms_rad < EXACT * spread_rad(problem.windows):  # only rounding is left
            break
        noise = best.fit.problem.cut.noise_of(best.residual)
        if noise.white:
            break
        problem = replace(problem, noise=noise)
        best = problem.solve(best.x).after(best)
    return problem, best


def _extended(problem: OutputErrorProblem, candidates: Sequence[Array], periods_s: Sequence[float]) -> Solution:
    """Solution on the whole recording, by way of ever longer parts of it; ``periods_s``: of the cycles, if any.

    Over a long test a small error of asymmetry or friction grows, and makes false minima. Over a few cycles it does
    not. So the starts are compared there, and the best one stays near the minimum while the part grows.
    """
    last_s = max(window.duration_s for window in problem.windows)
    horizon_s = FIRST_CYCLES * max(periods_s, default=0.1 * last_s)
    best: Solution | None = None
    while True:
        whole = horizon_s >= last_s
        windows = problem.windows if whole else tuple(window.until(horizon_s) for window in problem.windows)
        part = replace(problem, windows=windows)
        x0s = candidates if best is None else [best.x]
        rows = sum(window.t_s.size for window in windows)
        tried = side_by_side(lambda x0, part=part: part.solve(x0, ROUGHLY, COMPARED), x0s, rows)  # type: ignore[misc]
        found = min(tried, key=lambda solution: solution.cost)
        if best is not None:
            found = found.after(best)
        if whole:
            return part.solve(found.x).after(found)
        best = found
        horizon_s *= 2.0


class _Shapes:
    """Positions of windows without their lines, for starts to be compared by; of long windows some rows are enough.

    v0_rad_s   speed that each window begins with
    """

    def __init__(self, windows: Sequence[Window], v0_rad_s: Array) -> None:
        every = max(1, sum(window.t_s.size for window in windows) // SCORED_ROWS)
        t_s = [window.t_s[::every] for window in windows]
        one = np.zeros(1, dtype=np.int64)
        self._records = windows_of(
            [(Frame(), window.steps, rows, one) for window, rows in zip(windows, t_s, strict=True)]
        )
        self._v0_rad_s = v0_rad_s
        self._first = np.cumsum([0, *(rows.size for rows in t_s[:-1])])
        self._count = np.array([rows.size for rows in t_s])
        self._window = np.repeat(np.arange(len(t_s)), self._count)
        since_s = np.concatenate([rows - rows.mean() for rows in t_s])
        self._slope = since_s / np.add.reduceat(since_s**2, self._first)[self._window]
        self._since_s = since_s
        self._target = self._without_line(np.concatenate([window.y_rad[::every] for window in windows]))

    def score(self, start: Start, delay_s: float, rounds: int) -> tuple[float, float]:
        """Sum of squares of a start whose linear part (gain, offset, drift) is solved in so many rounds, and its gain.

        The gain says what drive stands for the speed at the begin. Where it is not known, that is none in the first
        round.
        """
        gain, cost = start.K_rad_s_V, math.inf
        motor = RealMotor(start.tau_s, 1.0, start.fc_V, 0.0, delay_s)
        begins = np.zeros((self._count.size, 4))
        for _ in range(rounds):
            begins[:, 0] = self._v0_rad_s / gain if math.isfinite(gain) else 0.0
            shape = self._without_line(readings_of(motor, self._records, begins).y_rad)
            power = float(shape @ shape)
            if power <= 0.0 or (fitted := float(shape @ self._target) / power) <= 0.0:
                break
            gain = fitted
            residual = self._target - gain * shape
            cost = float(residual @ residual)
        return cost, gain if math.isfinite(gain) else 1.0

    def _without_line(self, y_rad: Array) -> Array:
        slopes = np.add.reduceat(self._slope * y_rad, self._first)
        means = np.add.reduceat(y_rad, self._first) / self._count
        return np.asarray(y_rad - means[self._window] - slopes[self._window] * self._since_s)


def _full_vector(
    windows: Sequence[Window], states: Sequence[tuple[float, float]], start: Start, delay_s: float, *, free_asym: bool
) -> Array:
    """The vector that a fit starts from. A drift that remains over the recording is asymmetry."""
    tau, gain, fc = start.tau_s, start.K_rad_s_V, start.fc_V
    asym = 0.0
    if free_asym:
        drifts = []
        for window, (v0, y0) in zip(windows, states, strict=True):
            y = position(Theta(tau, gain, fc, 0.0, delay_s, v0, y0), *window.steps, window.t_s)
            drifts.append(float(np.polyfit(window.t_s - window.t_s[0], window.y_rad - y, 1)[0]))
        asym = float(np.mean(drifts)) / gain
    shared = [math.log(tau), math.log(gain), fc, asym, delay_s]
    return np.array(shared + [value for state in states for value in state])


def _estimate(
    problem: OutputErrorProblem, best: Solution, tests: Sequence[TimeSeries], periods_s: Sequence[float | None]
) -> Estimate:
    mask = problem.mask()
    scale = np.ones(mask.size)
    tau, K = math.exp(best.x[0]), math.exp(best.x[1])
    scale[:2] = tau, K
    whitened = best.fit.problem.whitened
    jacobian, residual = whitened(best.jacobian[:, mask] / scale[mask]), whitened(best.residual)
    fitted = np.flatnonzero(mask)
    # a window that begins at a standstill shows no velocity there: nothing else depends on it
    acts = (fitted < SHARED) | np.any(jacobian != 0.0, axis=0)
    jacobian, fitted = jacobian[:, acts], fitted[acts]
    covariance, freedom = covariance_of(best.counting(jacobian), best.counting(residual))
    pairs = repetitions(problem.windows, periods_s)
    share = repeated_share(residual, pairs)
    covariance = with_repetition(covariance, jacobian, pairs, share)
    full = np.zeros((mask.size, mask.size))
    full[np.ix_(fitted, fitted)] = covariance
    shared = full[:SHARED, :SHARED]
    delay, delay_error = best.x[4], math.sqrt(shared[4, 4])
    if not problem.free[4]:
        latency = np.concatenate([r.t_u_s - r.t_s for r in tests if r.t_u_s is not None])
        delay = float(latency.mean())
        delay_error = float(latency.std() / math.sqrt(latency.size))
    values = (tau, K, float(best.x[2]), float(best.x[3]), float(delay))
    quantile = student_975(freedom)
    errors = [*np.sqrt(np.diag(shared))[:4].tolist(), delay_error]
    if not problem.free[3]:
        errors[3] = math.inf  # one way only: fc_V is what friction and asymmetry take that way
    estimate = Estimate(
        METHOD,
        *values,
        ci95=intervals(values, errors, quantile),
        covariance=shared,
        rms_rad=best.rms_rad,
        iterations=len(best.iterates),
        rows=(min(p.rows[0] for p in problem.windows), max(p.rows[1] for p in problem.windows)),
        iterates=best.iterates,
        residual_rad=-best.residual,
        residual_t_s=joined_times_s(problem.windows),
        repeated=share,
        coloured=None if problem.noise.white else (problem.noise.memory_s, math.sqrt(problem.noise.ratio)),
    )
    if not best.converged:
        lost = replace(estimate, converged=False)
        return lost.judged("refused", "the fit did not converge: record more cycles, or with less noise", spoiled=False)
    return estimate
