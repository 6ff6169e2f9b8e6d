"""The triple-relay estimator (docs/theory.md 6.1 and 6.3): the inverse of Theorem 2.1.

Friction is the third relay, so one steady cycle determines tau, K and fc. The paper's form has five equations, for
three durations and two positions (``solve``). A sampled relay switches late, so its edges are not zero crossings. For a
recorded cycle (``solve_cycle``) the switching planes are the positions measured at the edges, and the extremum follows
from the motor: the steady motion under the recorded edges is fitted to the mean curve. Both use damped Gauss-Newton
from several starts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rig.core.arrays import Array
from rig.identification import describing_function
from rig.identification.descent import Damping, Point, descend
from rig.identification.estimate import Estimate, student_intervals
from rig.identification.estimator import Estimator
from rig.identification.mean_cycle import Bins, Cycle, MeanHalf
from rig.identification.measurements import Measurements
from rig.identification.starts import Start, ridge_starts
from rig.identification.verdict import judge_reference, settled, unguarded
from rig.model.compiled import steady_cycle as compiled
from rig.run_folder.recording.errors import IdentifyError

METHOD = "triple-relay"
FINE_SAMPLING = 120.0  # samples in a cycle: with fewer, averaging cycles that jitter costs more than 4 %
MAX_ITERATIONS = 60
DELAY = 5  # its place among the unknowns of the curve
FARTHEST = 12.0  # largest distance of log tau and log K from the cycle's own
LEAST_FRICTION = -0.1  # in units of h2: a motor without friction may seem to have a little less than none
SAME = 1e-3  # largest difference between equal solutions: relative in tau and K, of fc in units of h2
EXACT, ROUGH = 1e-9, 1e-4  # last step of log tau and log K, and of the others relative to their size
FAR, NEAR = 1e-3, 1e-8  # first damping, from a guess and from a solution
FEW_SAMPLES = 60  # of each half: enough to see which start leads to the best solution
LONGEST_DELAY = 2.0  # sampling periods, if t_u_s is not known


class TripleRelay(Estimator):
    """A reference estimator. Of several tests it takes the one whose cycles scatter least."""

    name = METHOD

    def applies(self, data: Measurements) -> IdentifyError | None:
        """It needs one settled cycle."""
        if data.settled:
            return None
        nothing = IdentifyError("there is no relay test", "record one: `rig relay CONFIG`")
        return data.complaints[-1] if data.complaints else nothing

    def fit(self, data: Measurements) -> Estimate:
        """Fit the mean curve. With two tests the describing function gives the first start."""
        cycles = data.settled
        first = None
        if describing_function.lacking(cycles) is None:
            sine = describing_function.fit(cycles)
            if sine.verdict != "refused":
                first = Start(sine.tau_s, sine.K_rad_s_V, sine.fc_V)
        estimates = [fit(cycle, first) for cycle in cycles]
        return min(estimates, key=lambda e: e.covariance[0, 0] / e.tau_s**2 if e.covariance[0, 0] >= 0.0 else np.inf)

    def judge(self, estimate: Estimate, data: Measurements, earlier: Mapping[str, Estimate]) -> Estimate:
        """Doubtful if the relay decides too seldom in a cycle."""
        bias = sampling_bias(estimate.cycles, max(test.period_s for test in data.tests))
        return unguarded(settled(judge_reference(estimate, data.tests, bias), data), data)


def sampling_bias(cycles: Sequence[Cycle], tick_s: float) -> str | None:
    """The cost of averaging cycles that jitter, as a sentence; None for fine enough samples (docs/theory.md 6.3).

    tick_s  time between two decisions of the relay
    """
    shortest_s = min((cycle.period_s for cycle in cycles), default=math.inf)
    if shortest_s >= FINE_SAMPLING * tick_s:
        return None
    return (
        f"the relay decides every {1e3 * tick_s:.3g} ms, only {shortest_s / tick_s:.0f} times a cycle, so its "
        "cycles differ, and their average is off by more than the interval shows; "
        f"below {FINE_SAMPLING:.0f} times a cycle trust the sampled-data estimate"
    )


class Features(NamedTuple):
    """Features of a cycle; t = 0 where the drive steps to +(h1 + h2).

    t1_s, t2_s, t3_s   durations of the stages, s
    y_extremum_rad     position at t1, rad
    y_rc_rad           position at t = 0, rad
    y_rb_rad, z_rc_rad_s   position at the RB edge, rad, and integral at the RC edge, rad s: zero for an ideal relay;
                       measured at the edge for a sampled relay, which switches late
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
    """A solution.

    theta     tau, s, K, (rad/s)/V, and fc, V
    cost      sum of squared residuals: of the five equations relative to the cycle's size, or of the curve, rad^2
    iterates  (n, 3): theta at each iteration from the best start; the start is first
    converged whether the last step was negligible
    asym_V    asymmetry of the drive, V
    delay_s   time from the recorded edges to those of the drive, s; nan if they are known to be equal
    """

    theta: Start
    cost: float
    iterates: Array
    converged: bool
    asym_V: float = 0.0
    delay_s: float = math.nan


def residuals(theta: Start, features: Features, h1_V: float, h2_V: float) -> Array:
    """The conditions of the three switching planes and the two positions, each relative to the cycle's size.

    In this order: z at RC, v at RA, y at RB, y at the extremum, y at RC.
    """
    values, _ = compiled.switching_conditions(_logarithmic(theta), (h1_V, h2_V), features[:3])
    measured, weight = _conditions(features)
    return np.asarray(weight * (values - measured))


def _logarithmic(theta: Start) -> Array:
    return np.array([math.log(theta.tau_s), math.log(theta.K_rad_s_V), theta.fc_V])


def _conditions(features: Features) -> tuple[Array, Array]:
    """Targets of the five conditions, and one over their size."""
    amplitude = abs(features.y_extremum_rad)
    omega = math.pi / sum(features[:3])
    measured = [features.z_rc_rad_s, 0.0, features.y_rb_rad, features.y_extremum_rad, features.y_rc_rad]
    return np.array(measured), np.array([omega, 1.0 / omega, 1.0, 1.0, 1.0]) / amplitude


def _reach(amplitude_rad: float, half_s: float, h2_V: float) -> tuple[Array, Array]:
    """Range of log tau, log K and fc in the search.

    Far below zero friction there is a minimum that is not a motor. From h2 upwards there is no cycle (Property 3.1).
    """
    omega = math.pi / half_s
    centre = np.array([-math.log(omega), math.log(amplitude_rad * omega / h2_V)])
    return np.array([*(centre - FARTHEST), LEAST_FRICTION * h2_V]), np.array([*(centre + FARTHEST), h2_V])


def solve(features: Features, h1_V: float, h2_V: float, starts: Sequence[Start]) -> Fit:
    """Best solution of the five equations (24)-(29) from the given starts, for a known t1.

    Raises IdentifyError if no start leads to a solution.
    """
    if min(features[:3]) <= 0.0:
        raise IdentifyError(
            "the relays' edges are not in the order RA, RB, RC",
            "record a settled cycle of the relay test: `rig relay CONFIG`",
        )
    measured, weight = _conditions(features)
    data = compiled.Data((h1_V, h2_V), np.array(features[:3]), (0, 0), np.empty(0), measured, weight)
    reach = _reach(abs(features.y_extremum_rad), sum(features[:3]), h2_V)
    fits = []
    for start in starts:
        found, path, converged = _searched(_logarithmic(start), (True,) * 3, data, reach, np.full(3, EXACT), FAR)
        if math.isfinite(found.cost):
            fits.append(Fit(_natural(found.x), found.cost, path, converged))
    return _best(fits, h2_V)


def _searched(
    start: Array, free: Sequence[bool], data: compiled.Data, reach: tuple[Array, Array], enough: Array, damping: float
) -> tuple[Point, Array, bool]:
    """Where the descent ends, tau, K and fc at each of its places, and whether it has arrived.

    reach   range of the numbers. The delay, the last of six, goes up to its bounds and stays there
    enough  steps that end the search
    """
    low, high = reach
    path = [start]

    def linearised(at: Point) -> Callable[[float], Point] | None:
        uphill = at.jacobian.T @ at.residual
        moving = np.array(free)
        moving[DELAY:] &= ~(((at.x <= low) & (uphill > 0.0)) | ((at.x >= high) & (uphill < 0.0)))[DELAY:]

        def moved(share: float) -> Point:
            x = at.x + at.step(moving, share)
            x[DELAY:] = np.clip(x, low, high)[DELAY:]
            inside = np.all((low < x) & (x < high), where=np.arange(x.size) < DELAY)
            return Point.of(x, lambda x: compiled.rows(x, data)) if inside else at._replace(cost=math.inf)

        return moved if math.isfinite(at.cost) else None

    def is_enough(before: Point, after: Point) -> bool:
        path.append(after.x)
        return bool(np.all(np.abs(after.x - before.x) <= enough))

    begun = Point.of(start, lambda x: compiled.rows(x, data))
    found, arrived = descend(begun, linearised, is_enough, MAX_ITERATIONS, Damping(damping, 10.0, 0.1, 1e-10, 20))
    return found, _all_natural(np.array(path)), arrived


def solve_cycle(cycle: Cycle, starts: Sequence[Start], halves: tuple[MeanHalf, MeanHalf] | None = None) -> Fit:
    """Best fit to the mean curve of a recorded cycle, under its edges. t1 follows from v(t1) = 0.

    halves   mean halves over some of its waves, to fit in place of the cycle's own
    Beside tau, K and fc it fits what the paper's symmetric cycle does not have: the asymmetry of the drive, which makes
    the halves differ; an offset of position; and, without t_u_s, the delay of the drive. All samples have equal weight.
    The motor may stop before a late RC edge and wait for it.
    Raises IdentifyError if no start leads to a solution.
    """
    halves = halves or cycle.halves
    few = max(1, *(half.at_s.size // FEW_SAMPLES for half in halves))
    found = _descend(cycle, halves, [_full(start, cycle) for start in starts], few, ROUGH, FAR)
    rough = _best([fit for fit, _ in found], cycle.h2_V)
    arrived = next(x for fit, x in found if fit is rough)
    fine = _best([fit for fit, _ in _descend(cycle, halves, [arrived], 1, EXACT, NEAR)], cycle.h2_V)
    return replace(fine, iterates=np.concatenate([rough.iterates, fine.iterates[1:]]))


def _full(start: Start, cycle: Cycle) -> Array:
    """Unknowns of the curve: log tau, log K, fc, asym, position at the RC edge, delay."""
    delay = 0.0 if cycle.drive_times_known else 0.25 * LONGEST_DELAY * cycle.period_sampling_s
    return np.array([*_logarithmic(start), 0.0, cycle.y_rc_rad, delay])


def _descend(
    cycle: Cycle,
    halves: tuple[MeanHalf, MeanHalf],
    starts: Sequence[Array],
    stride: int,
    tolerance: float,
    damping: float,
) -> list[tuple[Fit, Array]]:
    """The solution from each start, on every ``stride``-th sample, without those that are not finite."""
    up, down = halves
    at_s = np.concatenate([up.at_s[::stride], down.at_s[::stride]])
    y_rad = np.concatenate([up.y_rad[::stride], down.y_rad[::stride]])
    weight = np.ones(y_rad.size)
    counts = up.at_s[::stride].size, down.at_s[::stride].size
    edges = np.array([up.inner_s, up.length_s, down.inner_s, down.length_s])
    h2, amplitude, tick = cycle.h2_V, cycle.amplitude_rad, cycle.period_sampling_s
    low, high = _reach(amplitude, 0.5 * cycle.period_s, h2)
    low = np.array([*low, -h2, -math.inf, 0.0])
    high = np.array([*high, h2, math.inf, LONGEST_DELAY * tick])
    free = (True,) * 5 + (not cycle.drive_times_known,)
    data = compiled.Data((cycle.h1_V, h2), edges, counts, at_s, y_rad, weight)
    enough = tolerance * np.array([1.0, 1.0, h2, h2, amplitude, tick])
    fits = []
    for start in starts:
        found, path, converged = _searched(start, free, data, (low, high), enough, damping)
        if math.isfinite(found.cost):
            delay = math.nan if cycle.drive_times_known else float(found.x[DELAY])
            fit = Fit(_natural(found.x), found.cost, path, converged, float(found.x[3]), delay)
            fits.append((fit, found.x))
    return fits


def _natural(x: Array) -> Start:
    return Start(math.exp(x[0]), math.exp(x[1]), float(x[2]))


def _all_natural(iterates: Array) -> Array:
    return np.column_stack([np.exp(iterates[:, :2]), iterates[:, 2]])


def _best(fits: Sequence[Fit], h2_V: float) -> Fit:
    """The first fit that has the solution of least cost."""
    if not fits:
        raise IdentifyError(
            "no start of the triple-relay equations converges", "record a longer, settled relay test: relay.cycles"
        )
    best = min(fits, key=lambda fit: fit.cost).theta

    def near(theta: Start) -> bool:
        ratios = abs(math.log(theta.tau_s / best.tau_s)), abs(math.log(theta.K_rad_s_V / best.K_rad_s_V))
        return max(*ratios, abs(theta.fc_V - best.fc_V) / h2_V) <= SAME

    return next(fit for fit in fits if near(fit.theta))


def fit(cycle: Cycle, start: Start | None = None) -> Estimate:
    """Estimate tau, K and fc, and the asymmetry and an unknown delay, from one averaged cycle.

    start   a first guess, e.g. from the describing function: the two-stage method (Remark 3.3). It is tried first, so
            its iterates are reported if it leads to the best solution
    Intervals come from a jackknife over periods. The caller sets rms_rad. Raises IdentifyError if no start converges.
    """
    starts = ridge_starts(cycle.omega_rad_s, cycle.amplitude_rad, cycle.h1_V, cycle.h2_V)
    found = solve_cycle(cycle, ([start] if start is not None else []) + starts)
    covariance = _jackknife(cycle, found)
    intervals: dict[str, tuple[float, float]] = {}
    if covariance is not None:
        intervals = student_intervals(found.theta, covariance[:3, :3], cycle.cycles - 1)
    estimate = Estimate(
        METHOD,
        *found.theta,
        asym_V=found.asym_V,
        delay_s=found.delay_s,
        ci95=intervals,
        covariance=np.full((5, 5), np.nan) if covariance is None else covariance,
        iterations=len(found.iterates) - 1,
        rows=cycle.rows,
        iterates=found.iterates,
        cycles=(cycle,),
    )
    if not found.converged:
        estimate = estimate.judged(
            "doubtful", f"the fit has not converged in {MAX_ITERATIONS} iterations: record more settled cycles"
        )
    if covariance is None:
        return estimate.judged("doubtful", "these cycles give no interval: record at least ten settled ones")
    return estimate


def _jackknife(cycle: Cycle, found: Fit) -> Array | None:
    """(5, 5) covariance from fits that leave out each period in turn; None if one of them does not converge."""
    bins = Bins.of(cycle.waves, cycle.period_sampling_s)
    n = cycle.cycles
    solutions = np.empty((n, 5))
    for k in range(n):
        try:
            part = solve_cycle(cycle, [found.theta], bins.halves(without=k))
        except IdentifyError:
            return None
        solutions[k] = (*part.theta, part.asym_V, part.delay_s)
    deviation = solutions - solutions.mean(axis=0)
    return np.asarray((n - 1) / n * deviation.T @ deviation)
