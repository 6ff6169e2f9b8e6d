"""The verdict on a sampled-data estimate: its intervals, bounds and residual, and checks of the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from rig.identification.estimate import PARAMETERS, Estimate
from rig.identification.output_error import Solution, covariance_of, refit
from rig.identification.plausibility import hole_rows
from rig.identification.verdict import ROW_UP, in_percent, intervals, spread_rad
from rig.model.motor import State
from rig.model.sensitivity import Theta
from rig.run_folder.recording.errors import IdentifyError
from rig.run_folder.recording.series import TimeSeries

NOISY, TOO_NOISY = 3.0, 8.0  # residual over the sensor's noise
REPEATED = 0.3  # share of the residual's power that repeats in each cycle
FREE_RUN, FREE_RUN_FAILS = 0.05, 0.3  # residual of tests predicted whole, over the spread of positions
EARLY = 0.3  # of a period: drives that seem to act so much before their rows are noise and small laws, not a wrong row
NEGLIGIBLE = 0.003  # residual over the spread of positions, below which it does not matter
SLIPPED = 0.3  # of a period: largest difference between the recorded times of the drive and those that fit best
AT_BOUND = 0.9995  # of the longest delay that is looked for
REACH_PERIODS = 2.5  # periods: differences that are looked for
TRANSFER = 1.5  # residual of a test predicted by the first test's model, over the residual of its own fit
VAGUE = 4.0  # times the scatter of a prediction: two standard deviations
STUCK = 0.3  # share of the time in which the motor stands still under a drive


def judge(estimate: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    """The sampled-data estimate with its verdict: intervals, bounds, residual, row convention, sticking, transfer.

    It needs no settled cycle: whether the motion is enough, intervals and budget say.
    """
    estimate = intervals(estimate, tests)
    estimate = _bounds(estimate, tests)
    estimate = _residual(estimate, tests)
    estimate = _asymmetry(estimate)
    if estimate.verdict == "refused":
        return estimate
    estimate = _row_convention(estimate, tests)
    estimate = _sticking(estimate, tests)
    return _transfer(estimate, tests)


def judge_with_laws(estimate: Estimate, tests: Sequence[TimeSeries], growth: Sequence[tuple[float, float]]) -> Estimate:
    """An estimate with laws beyond the plain one, with its verdict: intervals, bounds, residual, free run, asymmetry.

    growth   length of the pieces, s, and their RMS residual, rad; the last one is of all tests, each predicted whole

    What a plain motor alone can be held to, as whether one test predicts another, is part of the choice of laws. Cycles
    that a law changes need not be alike: whether they are enough, their interval and the budget say. Nor must the
    residual be as small as the sensor's noise: a motor's friction wanders. But a free run must hold.
    """
    estimate = _bounds(intervals(estimate, tests), tests)
    return _asymmetry(_free_run(_unexplained(estimate, tests), tests, growth))


def _free_run(estimate: Estimate, tests: Sequence[TimeSeries], growth: Sequence[tuple[float, float]]) -> Estimate:
    (piece_s, piece_rad), (length_s, rms_rad) = growth[0], growth[-1]
    spread = spread_rad(tests)
    share = rms_rad / spread
    if share <= FREE_RUN:
        return estimate
    off = (
        f"predicted over {length_s:.3g} s, the position is {in_percent(share)} of its motion off; ok asks for "
        f"{100 * FREE_RUN:.2g} %: "
    )
    cause = "something that no law here describes moves the motor, or the times are wrong"
    if piece_rad <= NEGLIGIBLE * spread:
        cause = (
            f"over {piece_s:.2g} s it is not, so a small difference grows: as where a load nearly balances the drive, "
            "or where something that no law here describes moves the motor slowly"
        )
    return estimate.judged("refused" if share > FREE_RUN_FAILS else "doubtful", off + cause, spoiled=False)


def _bounds(estimate: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    period = max(test.period_s for test in tests)
    duration = max(float(test.t_s[-1] - test.t_s[0]) for test in tests)
    if estimate.tau_s < 0.5 * period:
        return estimate.judged(
            "refused", f"tau = {estimate.tau_s:.3g} s is too short for samples every {period:.3g} s: sample faster"
        )
    if estimate.tau_s > 2.0 * duration:
        reason = f"tau = {estimate.tau_s:.3g} s is longer than the recording, {duration:.3g} s: record longer"
        return estimate.judged("refused", reason, spoiled=False)  # its drive and position may belong together
    longest = max(test.longest_delay_s for test in tests)
    if all(test.t_u_s is not None for test in tests):
        return estimate
    if estimate.delay_s > AT_BOUND * longest:
        return estimate.judged(
            "doubtful",
            f"the delay is at its bound, {1e3 * longest:.3g} ms: record the times at which the drive acts, t_u_s, or "
            "check that u of a row is the drive set after that row's y was read",
        )
    gaps = any(hole_rows(test).size for test in tests)  # an unknown drive in a gap looks like an early one, too
    if estimate.ci95["delay_s"][1] < -EARLY * period and not gaps:
        rows = math.ceil(-estimate.delay_s / period - EARLY)
        rows_up = ROW_UP.replace("a row", f"{rows} rows").replace("-1", f"-{rows}") if rows > 1 else ROW_UP
        return estimate.judged(
            "doubtful",
            f"the drive seems to act {-1e3 * estimate.delay_s:.2g} ms before its row: u of a row must be the drive set "
            f"after that row's y was read; {rows_up}",
        )
    return estimate


def _unexplained(estimate: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    added_up = sum(test.strays_rad(len(test)) ** 2 for test in tests) / len(tests)
    share = math.sqrt(max(estimate.rms_rad**2 - added_up, 0.0)) / spread_rad(tests)
    if share > 0.5:
        return estimate.judged(
            "refused",
            f"the model leaves {in_percent(share)} of the position unexplained: check that u and y belong together, "
            "their signs and units",
            spoiled=False,
        )
    if share > NEGLIGIBLE and estimate.repeated > REPEATED:
        estimate = estimate.judged(
            "doubtful",
            f"{100 * estimate.repeated:.0f} % of the residual ({1e3 * estimate.rms_rad:.2g} mrad) repeats in each "
            "cycle: the motor is more than tau, K and Coulomb friction (Stribeck effect, backlash, stops?), or its "
            "sensor is too coarse for this amplitude",
        )
    return estimate


def _residual(estimate: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    estimate = _unexplained(estimate, tests)
    noise = math.sqrt(sum(test.noise_over_rad(len(test)) ** 2 for test in tests) / len(tests))
    share = estimate.rms_rad / spread_rad(tests)
    if share <= 0.5 and share > NEGLIGIBLE and estimate.rms_rad > NOISY * noise:
        ratio = estimate.rms_rad / noise if noise > 0.0 else math.inf
        return estimate.judged(
            "refused" if ratio > TOO_NOISY and share > 0.1 else "doubtful",
            f"the residual, {1e3 * estimate.rms_rad:.2g} mrad, is {ratio:.1f} times the sensor's noise: "
            "the motor is more than tau, K and Coulomb friction (stops, backlash, loads, a bridge "
            "that lets it run free at 0 V?), or the times are wrong",
            spoiled=False,
        )
    return estimate


def _asymmetry(estimate: Estimate) -> Estimate:
    """Doubtful if the asymmetry is clearly larger than the friction: it would drive the motor, and friction cannot."""
    beyond = abs(estimate.asym_V) - estimate.fc_V
    error = math.sqrt(max(0.0, float(estimate.covariance[2, 2] + estimate.covariance[3, 3])))
    if beyond > 3.0 * error and beyond > 0.01 * abs(estimate.asym_V):
        return estimate.judged(
            "doubtful",
            f"the asymmetry, {estimate.asym_V:+.3g} V, is larger than the friction, {estimate.fc_V:.3g} V: the shaft "
            "turns by itself at 0 V; look for a load that pulls one way, or an offset of the drive (is its middle its "
            "zero? subtract it)",
        )
    return estimate


def confounding(estimate: Estimate) -> str | None:
    """How much of tau's error comes from an unknown delay, as a sentence; None for a known delay."""
    shared = float(estimate.correlation[0, 4])
    if not math.isfinite(shared):
        return None
    gain = 1.0 / math.sqrt(max(1e-12, 1.0 - shared * shared))
    if gain < 1.1:
        return None
    return (
        f"the unknown delay and tau are correlated by {shared:+.2f}: with the times at which the drive acts "
        f"(t_u_s) tau would be known {gain:.1f} times better"
    )


def slipped_rms_rad(estimate: Estimate, tests: Sequence[TimeSeries]) -> float:
    """RMS residual of the plain motor if the drive acted at other times than t_u_s, rad; inf without t_u_s.

    Wrong times look like a lag, or like a motor with laws of its own. If other times explain the tests, they are wrong.
    Also inf for times within a third of a period: no row is so little off, and the lag of a winding is.
    """
    if not _say_when(tests):
        return math.inf
    moved = _moved(estimate, tests)
    if abs(float(moved.x[4])) <= SLIPPED * max(test.period_s for test in tests):
        return math.inf
    return moved.rms_rad


def late_s(estimate: Estimate, tests: Sequence[TimeSeries]) -> float:
    """How much later than the tests say the drive acts, s: at least a third of a period; 0.0 if it does not.

    Without t_u_s: the longest delay that was looked for, if the estimate has that delay.
    """
    if all(test.t_u_s is None for test in tests):
        longest_s = max(test.longest_delay_s for test in tests)
        return longest_s if estimate.delay_s > AT_BOUND * longest_s else 0.0
    if not _say_when(tests):
        return 0.0
    slip_s = float(_moved(estimate, tests).x[4])
    return slip_s if slip_s > SLIPPED * max(test.period_s for test in tests) else 0.0


def is_early(estimate: Estimate, tests: Sequence[TimeSeries]) -> bool:
    """Whether the drive acts as early as was looked for, in tests that do not say when it acts."""
    earliest_s = min(test.earliest_delay_s for test in tests)
    return all(test.t_u_s is None for test in tests) and estimate.delay_s < AT_BOUND * earliest_s < 0.0


def _say_when(tests: Sequence[TimeSeries]) -> bool:
    """Whether the tests say when their drives act, and one shows it: a drive that never changes does not."""
    return all(test.t_u_s is not None for test in tests) and any(test.steps.u_V.size > 1 for test in tests)


def _moved(estimate: Estimate, tests: Sequence[TimeSeries]) -> Solution:
    """The plain motor with a free delay against t_u_s."""
    theta = Theta(estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V, estimate.asym_V, 0.0)
    return _with_free_delay(theta, tuple(tests))


@lru_cache(maxsize=1)  # each question about the times of one identification asks for the same fit
def _with_free_delay(theta: Theta, tests: tuple[TimeSeries, ...]) -> Solution:
    period = max(test.period_s for test in tests)
    tried = (theta._replace(delay_s=rows * period) for rows in (-1.0, 0.0, 1.0))
    reach = REACH_PERIODS * period
    return min((refit(tests, start, PARAMETERS, (-reach, reach)) for start in tried), key=_rms_rad)


def _row_convention(estimate: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    """With a known t_u_s the drive must act at that time, so a free delay must come out as zero.

    The error of the link's times counts as zero, too: a recording without noise shows microseconds.
    """
    if not _say_when(tests):
        return estimate
    period = max(test.period_s for test in tests)
    moved = _moved(estimate, tests)
    slip = float(moved.x[4])
    gain = (estimate.rms_rad / moved.rms_rad) ** 2 if moved.rms_rad > 0.0 else math.inf
    if abs(slip) > SLIPPED * period and gain > 1.02:
        way = "later" if slip > 0.0 else "earlier"
        return estimate.judged(
            "refused" if abs(slip) > 2.0 * SLIPPED * period else "doubtful",
            f"the drive seems to act {1e3 * abs(slip):.1f} ms {way} than t_u_s says: check that u stands in its own "
            "row (y_k, then u_k, which acts from t_u_s of row k)",
        )
    if abs(slip) <= max(test.times_error_s for test in tests):
        return estimate
    free = (math.exp(moved.x[0]), math.exp(moved.x[1]), float(moved.x[2]))
    shifted = [name for name, value in zip(PARAMETERS, free, strict=False) if not _holds(estimate, name, value)]
    if shifted and gain > 1.0 + max(0.02, 15.0 / moved.residual.size):
        return estimate.judged(
            "doubtful",
            f"with the drive {1e3 * abs(slip):.2g} ms {'later' if slip > 0.0 else 'earlier'} the fit is better, and "
            f"{' and '.join(shifted)} {'is' if len(shifted) == 1 else 'are'} outside the interval: t_u_s is not when "
            "the drive acted, or rows are missing; record every tick",
        )
    return estimate


def _holds(estimate: Estimate, name: str, value: float) -> bool:
    """Whether the estimate's interval of this parameter holds the value."""
    low, high = estimate.ci95[name]
    return low <= value <= high


def _rms_rad(solution: Solution) -> float:
    return solution.rms_rad


def _sticking(estimate: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    motor = estimate.motor()
    share = 0.0
    for test in tests:
        late = int(np.searchsorted(test.t_s, test.edge_s[0]))
        states = motor.response(State(y=float(test.y_rad[late])), test.t_s[late:], test.edge_s, test.u_V)
        driven = test.u_V[late:] != 0.0  # a rest at 0 V says nothing of the drive
        share = max(share, float(np.mean((states[:, 0] == 0.0) & driven)))
    if share > STUCK:
        return estimate.judged(
            "doubtful",
            f"the motor stands still under its drive {100 * share:.0f} % of the time: record with more drive",
        )
    return estimate


def _transfer(estimate: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    """The model of the first test must predict the other tests nearly as well as their own models do.

    A short test knows its model badly, and predicts badly for that reason: so much more is no objection.
    """
    if len(tests) < 2:
        return estimate
    theta = Theta(estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V, estimate.asym_V, estimate.delay_s)
    unknown = any(test.t_u_s is None for test in tests)
    free = PARAMETERS if unknown else PARAMETERS[:4]
    bounds = (0.0, max(test.longest_delay_s for test in tests)) if unknown else None
    theta = theta if unknown else theta._replace(delay_s=0.0)
    try:
        # a fit of one test alone may lose its way; the estimate is where it began
        first = min((refit(tests[:1], theta, free, bounds), refit(tests[:1], theta)), key=_rms_rad)
        first_free = [*(PARAMETERS.index(name) for name in free), len(PARAMETERS), len(PARAMETERS) + 1]
        model = Theta(math.exp(first.x[0]), math.exp(first.x[1]), *(float(x) for x in first.x[2:5]))
        scatter, _ = covariance_of(*map(first.counting, (first.jacobian[:, first_free], first.residual)))
        ratios = []
        for test in tests[1:]:
            own = refit([test], theta, free, bounds)
            given = refit([test], model)
            by_model = given.counting(given.jacobian[:, first_free[:-2]])
            vague = float(np.einsum("ni,ij,nj", by_model, scatter[: len(by_model.T), : len(by_model.T)], by_model))
            if given.rms_rad > NEGLIGIBLE * spread_rad([test]):
                expected = own.rms_rad**2 + (VAGUE * vague / len(by_model) if math.isfinite(vague) else math.inf)
                ratios.append(given.rms_rad / math.sqrt(expected) if expected > 0.0 else math.inf)
    except IdentifyError:
        return estimate  # a test is too short for a fit of its own
    if ratios and max(ratios) > TRANSFER:
        return estimate.judged(
            "doubtful",
            f"the first test's model predicts another with {max(ratios):.1f} times the residual of its own fit: "
            "friction or gain depend on speed, amplitude or temperature; record tests like the motion of the later use",
        )
    return estimate
