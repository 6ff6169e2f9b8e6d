"""The triple-relay estimator (docs/theory.md 6.1 and 6.3): Theorem 2.1 turned round.

Friction is the third relay, so one steady cycle determines tau, K and fc: in the paper's form by three durations and
two positions, five equations (``solve``). A sampled relay switches late, so that its edges are no zero crossings. For a
recorded cycle (``solve_cycle``) its planes are therefore the positions measured at the edges, and the extremum follows
from the motor that is sought: one fit, to the averaged curve, of the steady motion under the recorded edges. Damped
Gauss-Newton from several starts in either case.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.identify import describing_function
from rig.identify.estimate import Estimate, student_intervals
from rig.identify.estimator import Estimator
from rig.identify.mean_cycle import Bins, Cycle, MeanHalf
from rig.identify.measurements import Measurements
from rig.identify.starts import Start, ridge_starts
from rig.identify.verdict import judge_reference, settled, unguarded
from rig.recording.errors import IdentifyError

Array = NDArray[np.float64]

METHOD = "triple-relay"
FINE_SAMPLING = 120.0  # samples a cycle below which averaging cycles that jitter costs over 4 %
MAX_ITERATIONS = 60
FARTHEST = 12.0  # of the logarithms of tau and K from the cycle's own
LEAST_FRICTION = -0.1  # in units of h2: a motor without friction may seem to have a little less
SAME = 1e-3  # relative difference in tau and K, and of fc to h2, of starts that lead to one solution
EXACT, ROUGH = 1e-9, 1e-4  # last step in log tau, log K, and the others relative to their size
FAR, NEAR = 1e-3, 1e-8  # first damping from a guess, and from a solution
FEW_SAMPLES = 60  # of each half: enough to tell which start leads to the best solution
LONGEST_DELAY = 2.0  # sampling periods, where t_u_s is not known


class TripleRelay(Estimator):
    """A reference: of several tests it takes the one whose cycles scatter least."""

    name = METHOD

    def applies(self, data: Measurements) -> IdentifyError | None:
        """From one settled cycle on."""
        if data.settled:
            return None
        nothing = IdentifyError("there is no relay test", "record one: `rig relay CONFIG`")
        return data.complaints[-1] if data.complaints else nothing

    def fit(self, data: Measurements) -> Estimate:
        """From the averaged curve; the describing function gives the first start where there are two tests."""
        cycles = data.settled
        first = None
        if describing_function.lacking(cycles) is None:
            sine = describing_function.fit(cycles)
            if sine.verdict != "refused":
                first = Start(sine.tau_s, sine.K_rad_s_V, sine.fc_V)
        estimates = [fit(cycle, first) for cycle in cycles]
        return min(estimates, key=lambda e: e.covariance[0, 0] / e.tau_s**2 if e.covariance[0, 0] >= 0.0 else np.inf)

    def judge(self, estimate: Estimate, data: Measurements, earlier: Mapping[str, Estimate]) -> Estimate:
        """Doubtful where the relay decides too seldom in a cycle."""
        bias = sampling_bias(estimate.cycles, max(test.period_s for test in data.tests))
        return unguarded(settled(judge_reference(estimate, data.tests, bias), data), data)


def sampling_bias(cycles: Sequence[Cycle], tick_s: float) -> str | None:
    """What averaging cycles that jitter costs, as a sentence; None where samples are fine enough (docs/theory.md 6.3).

    tick_s  between two decisions of the relay
    """
    shortest_s = min((cycle.period_s for cycle in cycles), default=math.inf)
    if shortest_s >= FINE_SAMPLING * tick_s:
        return None
    return (
        f"the relay decides every {1e3 * tick_s:.3g} ms, only {shortest_s / tick_s:.0f} times a cycle: its cycles "
        "differ by that, and their average is off by more than the interval shows: below "
        f"{FINE_SAMPLING:.0f} times trust the sampled-data estimate"
    )


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
    """A solution.

    theta     tau, s, K, (rad/s)/V, and fc, V
    cost      sum of squared residuals: of the five equations relative to the cycle's size, or of the curve, rad^2
    iterates  (n, 3): theta at each iteration from the start that won, the start first
    converged the last step was negligible
    asym_V    asymmetry of the drive
    delay_s   from the recorded edges to the drive's; nan if these are known to be the same
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
    from rig.model.compiled import steady_cycle as compiled

    values, jacobian = np.empty(5), np.empty((5, 3))
    compiled.switching_conditions(_logarithmic(theta), (h1_V, h2_V), features[:3], values, jacobian)
    measured, weight = _conditions(features)
    return np.asarray(weight * (values - measured))


def _logarithmic(theta: Start) -> Array:
    return np.array([math.log(theta.tau_s), math.log(theta.K_rad_s_V), theta.fc_V])


def _conditions(features: Features) -> tuple[Array, Array]:
    """What the five conditions have to be, and one over their size."""
    amplitude = abs(features.y_extremum_rad)
    omega = math.pi / sum(features[:3])
    measured = [features.z_rc_rad_s, 0.0, features.y_rb_rad, features.y_extremum_rad, features.y_rc_rad]
    return np.array(measured), np.array([omega, 1.0 / omega, 1.0, 1.0, 1.0]) / amplitude


def _reach(amplitude_rad: float, half_s: float, h2_V: float) -> tuple[Array, Array]:
    """Where log tau, log K and fc are looked for.

    Far below zero friction there is a minimum that is no motor's; from h2 on there is no cycle (Property 3.1).
    """
    omega = math.pi / half_s
    centre = np.array([-math.log(omega), math.log(amplitude_rad * omega / h2_V)])
    return np.array([*(centre - FARTHEST), LEAST_FRICTION * h2_V]), np.array([*(centre + FARTHEST), h2_V])


def solve(features: Features, h1_V: float, h2_V: float, starts: Sequence[Start]) -> Fit:
    """Best solution of the five equations (24)-(29) from the given starts, t1 being known.

    Raises IdentifyError if no start leads anywhere.
    """
    from rig.model.compiled import steady_cycle as compiled

    if min(features[:3]) <= 0.0:
        raise IdentifyError(
            "the relays' edges are not in the order RA, RB, RC",
            "record a settled cycle of the relay test: `rig relay CONFIG`",
        )
    measured, weight = _conditions(features)
    low, high = _reach(abs(features.y_extremum_rad), sum(features[:3]), h2_V)
    fits = []
    for start in starts:
        theta, iterates = _logarithmic(start), np.empty((MAX_ITERATIONS + 1, 3))
        count, cost = compiled.solve(
            theta,
            np.ones(3, dtype=bool),
            (h1_V, h2_V),
            np.array(features[:3]),
            (0, 0),
            np.empty(0),
            measured,
            weight,
            low,
            high,
            np.full(3, EXACT),
            FAR,
            iterates,
        )
        if math.isfinite(cost):
            fits.append(Fit(_natural(theta), cost, _all_natural(iterates[:count]), count <= MAX_ITERATIONS))
    return _best(fits, h2_V)


def solve_cycle(cycle: Cycle, starts: Sequence[Start], halves: tuple[MeanHalf, MeanHalf] | None = None) -> Fit:
    """The same for an averaged, recorded cycle: its curve under its edges, t1 following from v(t1) = 0.

    halves   what to fit in place of the cycle's own: averages over some of its waves
    Beside tau, K and fc it leaves free what the paper's symmetric cycle has not: the asymmetry of the drive, which
    makes the halves differ, an offset of position, and, without t_u_s, the delay of the drive. All samples weigh the
    same. A motor that stops before a late RC edge and waits for it is included.
    Raises IdentifyError if no start leads anywhere.
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
    """Solutions from each start, on every ``stride``-th sample; starts without a finite one are left out."""
    from rig.model.compiled import steady_cycle as compiled

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
    free = np.array([True, True, True, True, True, not cycle.drive_times_known])
    smallest = tolerance * np.array([1.0, 1.0, h2, h2, amplitude, tick])
    fits = []
    for start in starts:
        x, iterates = start.copy(), np.empty((MAX_ITERATIONS + 1, 6))
        count, cost = compiled.solve(
            x, free, (cycle.h1_V, h2), edges, counts, at_s, y_rad, weight, low, high, smallest, damping, iterates
        )
        if math.isfinite(cost):
            path = _all_natural(iterates[:count])
            delay = math.nan if cycle.drive_times_known else float(x[5])
            fit = Fit(_natural(x), cost, path, count <= MAX_ITERATIONS, float(x[3]), delay)
            fits.append((fit, x))
    return fits


def _natural(x: Array) -> Start:
    return Start(math.exp(x[0]), math.exp(x[1]), float(x[2]))


def _all_natural(iterates: Array) -> Array:
    return np.column_stack([np.exp(iterates[:, :2]), iterates[:, 2]])


def _best(fits: Sequence[Fit], h2_V: float) -> Fit:
    """The first that leads to the solution of least cost."""
    if not fits:
        raise IdentifyError(
            "no start of the triple-relay equations converges", "record a longer, settled relay test: relay.cycles"
        )
    best = min(fits, key=lambda fit: fit.cost).theta

    def near(theta: Start) -> bool:
        ratios = abs(math.log(theta.tau_s / best.tau_s)), abs(math.log(theta.K_rad_s_V / best.K_rad_s_V))
        return max(*ratios, abs(theta.fc_V - best.fc_V) / h2_V) <= SAME

    return next(fit for fit in fits if near(fit.theta))


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
    """Estimate tau, K and fc, and the asymmetry and an unknown delay, from one averaged cycle.

    start   a first guess, e.g. the describing function's: the two-stage method (Remark 3.3). It goes first, so that its
            iterates are reported if it leads where the others do
    Intervals are a jackknife over periods. rms_rad is left to the caller. Raises IdentifyError if nothing converges.
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
            "doubtful", f"it has not converged in {MAX_ITERATIONS} iterations: record more settled cycles"
        )
    if covariance is None:
        return estimate.judged(
            "doubtful", "its interval could not be had from the cycles: record at least ten settled ones"
        )
    return estimate


def _jackknife(cycle: Cycle, found: Fit) -> Array | None:
    """(5, 5) covariance over periods, each left out in turn; None if one of these does not converge."""
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
