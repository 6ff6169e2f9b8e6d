"""Whether to believe an estimate: ok, doubtful or refused, and what to record instead (docs/theory.md 7.7)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.identify import describing_function, sampled_data
from rig.identify.estimate import PARAMETERS, Estimate
from rig.identify.mean_cycle import Cycle
from rig.model.motor import State
from rig.model.sensitivity import Theta
from rig.recording.series import IdentifyError, Record

PROMISE = 0.05  # ok means that every parameter is at most this far off,
SURE = 2.0  # which 95 % intervals so many times narrower promise but for one record in ten thousand
TOO_WIDE = 0.5  # half width of an interval, relative to its parameter
NOISY, TOO_NOISY = 3.0, 8.0  # residual over the sensor's noise
REPEATED = 0.3  # share of the residual's power that comes again in each cycle
NEGLIGIBLE = 0.003  # residual over the spread of positions, below which it is no objection
POOR, TOO_POOR = 0.1, 0.4  # residual of a reference method over the spread of positions
SLIPPED = 0.3  # of a period, by which the drive seems to act beside its recorded times
TRANSFER = 1.5  # residual of a second test predicted by the first's model, over that of its own
STUCK = 0.3  # of the time
FINE_SAMPLING = 120.0  # samples a cycle below which averaging cycles that jitter costs the triple relay over 4 %
FEW_CYCLES = 5


def judge_sampled_data(estimate: Estimate, records: Sequence[Record], cycles: Sequence[Cycle]) -> Estimate:
    """The sampled-data estimate with its verdict: intervals, bounds, residual, row convention, sticking, transfer."""
    estimate = _intervals(estimate, records)
    estimate = _bounds(estimate, records)
    estimate = _residual(estimate, records)
    estimate = _enough(estimate, cycles)
    estimate = _asymmetry(estimate)
    if estimate.verdict == "refused":
        return estimate
    estimate = _row_convention(estimate, records)
    estimate = _sticking(estimate, records)
    return _transfer(estimate, records)


def judge_reference(estimate: Estimate, records: Sequence[Record], cycles: Sequence[Cycle]) -> Estimate:
    """A triple-relay or describing-function estimate with its residual on the records, and its verdict.

    The residual is that of the exact prediction under the recorded drive, with initial states, asymmetry and an
    unknown delay fitted.
    """
    if not (estimate.tau_s > 0.0 and estimate.K_rad_s_V > 0.0 and estimate.fc_V >= 0.0):
        return estimate.judged(
            "refused",
            f"no motor has tau = {estimate.tau_s:.3g} s, K = {estimate.K_rad_s_V:.3g} (rad/s)/V, "
            f"fc = {estimate.fc_V:.3g} V: record larger and slower cycles",
        )
    estimate = _enough(_intervals(estimate, records), cycles)
    free = ["asym_V"]
    bounds = None
    delay = 0.0
    if any(record.t_u_s is None for record in records):
        longest = max(record.longest_delay_s for record in records)
        free.append("delay_s")
        bounds, delay = (0.0, longest), 0.25 * longest
        if 0.0 < estimate.delay_s < longest:  # nan where the method knows nothing of it
            delay = estimate.delay_s
    theta = Theta(estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V, estimate.asym_V, delay)
    solution = sampled_data.refit(records, theta, free, bounds)
    rms = math.sqrt(solution.cost / solution.residual.size)
    estimate = replace(
        estimate,
        rms_rad=rms,
        residual_rad=-solution.residual,
        residual_t_s=np.concatenate(
            [sampled_data.Piece.of(r, max(0.0, bounds[1] if bounds else 0.0)).t_s for r in records]
        ),
    )
    estimate = _known_bias(estimate, records, cycles)
    share = rms / _spread(records)
    if share > POOR:
        return estimate.judged(
            "refused" if share > TOO_POOR else "doubtful",
            f"its model leaves {100 * share:.0f} % of the position unexplained: trust the sampled-data estimate; "
            "for this method record slower cycles, or sample faster",
        )
    return estimate


def _known_bias(estimate: Estimate, records: Sequence[Record], cycles: Sequence[Cycle]) -> Estimate:
    """Errors that the cycles' scatter, and so the interval, does not show (docs/theory.md 4.4 and 6.3)."""
    if estimate.method == describing_function.METHOD:
        return estimate.judged(
            "doubtful", "its interval shows the scatter of the cycles, not the error of assuming a sine"
        )
    tick_s = max(record.period_s for record in records)
    shortest_s = min((cycle.period_s for cycle in cycles), default=math.inf)
    if shortest_s < FINE_SAMPLING * tick_s:
        return estimate.judged(
            "doubtful",
            f"the relay decides every {1e3 * tick_s:.3g} ms, only {shortest_s / tick_s:.0f} times a cycle: its cycles "
            "differ by that, and their average is off by more than the interval shows: below "
            f"{FINE_SAMPLING:.0f} times trust the sampled-data estimate",
        )
    return estimate


def _spread(records: Sequence[Record]) -> float:
    return float(np.sqrt(np.mean([np.var(record.y_rad) for record in records])))


def _intervals(estimate: Estimate, records: Sequence[Record]) -> Estimate:
    sizes = {"tau_s": estimate.tau_s, "K_rad_s_V": estimate.K_rad_s_V}
    # a motor without friction has none to be known to a tenth: then the drive is the measure
    sizes["fc_V"] = max(abs(estimate.fc_V), 0.03 * max(float(np.abs(record.u_V).max()) for record in records))
    for name, size in sizes.items():
        if name not in estimate.ci95:
            continue
        low, high = estimate.ci95[name]
        share = 0.5 * (high - low) / abs(size)
        if not math.isfinite(share):
            return estimate.judged(
                "refused",
                f"the record cannot tell {name} from the others: record a drive that moves the motor both ways",
            )
        if SURE * share > PROMISE:
            estimate = estimate.judged(
                "refused" if share > TOO_WIDE else "doubtful",
                f"{name} is only known to {100 * share:.2g} % (95 % interval); ok asks for "
                f"{100 * PROMISE / SURE:.2g} %: record more cycles, or slower and larger ones",
            )
    return estimate


def _bounds(estimate: Estimate, records: Sequence[Record]) -> Estimate:
    period = max(record.period_s for record in records)
    duration = max(float(record.t_s[-1] - record.t_s[0]) for record in records)
    if estimate.tau_s < 0.5 * period:
        return estimate.judged(
            "refused", f"tau = {estimate.tau_s:.3g} s is too fast for samples every {period:.3g} s: sample faster"
        )
    if estimate.tau_s > 2.0 * duration:
        return estimate.judged(
            "refused", f"tau = {estimate.tau_s:.3g} s is longer than the record of {duration:.3g} s: record longer"
        )
    longest = max(record.longest_delay_s for record in records)
    if all(record.t_u_s is not None for record in records):
        return estimate
    if estimate.delay_s > 0.9995 * longest:
        return estimate.judged(
            "doubtful",
            f"the delay is at its bound, {1e3 * longest:.3g} ms: record the times at which the drive acts, t_u_s, or "
            "check that u of a row is the drive set after that row's y was read",
        )
    if estimate.ci95["delay_s"][1] < 0.0:
        return estimate.judged(
            "doubtful",
            f"the drive seems to act {-1e3 * estimate.delay_s:.2g} ms before its row: u of a row must be the drive set "
            "after that row's y was read; if it was set before, move u up by a row",
        )
    return estimate


def _residual(estimate: Estimate, records: Sequence[Record]) -> Estimate:
    noise = float(np.sqrt(np.mean([record.noise_rad() ** 2 for record in records])))
    share = estimate.rms_rad / _spread(records)
    if share > 0.5:
        return estimate.judged(
            "refused",
            f"the model leaves {100 * share:.0f} % of the position unexplained: check that u and y belong together, "
            "their signs and units",
        )
    if share > NEGLIGIBLE and estimate.repeated > REPEATED:
        estimate = estimate.judged(
            "doubtful",
            f"{100 * estimate.repeated:.0f} % of the residual ({1e3 * estimate.rms_rad:.2g} mrad) comes again in each "
            "cycle: the motor is not tau, K and Coulomb friction alone (Stribeck effect, backlash, stops?), or its "
            "sensor is too coarse for this amplitude",
        )
    if share > NEGLIGIBLE and estimate.rms_rad > NOISY * noise:
        ratio = estimate.rms_rad / noise if noise > 0.0 else math.inf
        return estimate.judged(
            "refused" if ratio > TOO_NOISY and share > 0.1 else "doubtful",
            f"the residual, {1e3 * estimate.rms_rad:.2g} mrad, is {ratio:.1f} times the sensor's noise: "
            "the motor is not tau, K and Coulomb friction alone (stops, backlash, loads?), or the times are wrong",
        )
    return estimate


def _enough(estimate: Estimate, cycles: Sequence[Cycle]) -> Estimate:
    few = [cycle.cycles for cycle in cycles if cycle.cycles < FEW_CYCLES]
    if few:
        return estimate.judged("doubtful", f"only {min(few)} settled cycles: record ten")
    return estimate


def _asymmetry(estimate: Estimate) -> Estimate:
    """The asymmetry is clearly beyond the friction: one direction would be driven by it, which no friction does."""
    beyond = abs(estimate.asym_V) - estimate.fc_V
    error = math.sqrt(max(0.0, float(estimate.covariance[2, 2] + estimate.covariance[3, 3])))
    if beyond > 3.0 * error and beyond > 0.01 * abs(estimate.asym_V):
        return estimate.judged(
            "doubtful",
            f"the asymmetry, {estimate.asym_V:+.3g} V, is larger than the friction, {estimate.fc_V:.3g} V: the shaft "
            "turns by itself at 0 V; look for a load that pulls one way, or an offset of the drive",
        )
    return estimate


def confounding(estimate: Estimate) -> str | None:
    """How much of tau's error is due to an unknown delay, in words; None where the delay was known."""
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


def _row_convention(estimate: Estimate, records: Sequence[Record]) -> Estimate:
    """With known t_u_s the drive must act then: a free delay has to come out as nothing.

    Nothing is also what the link's own times may be wrong by: a record without noise shows microseconds.
    """
    if any(record.t_u_s is None for record in records):
        return estimate
    period = max(record.period_s for record in records)
    reach = 2.5 * period
    theta = Theta(estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V, estimate.asym_V, 0.0)
    tried = (theta._replace(delay_s=rows * period) for rows in (-1.0, 0.0, 1.0))
    moved = min((sampled_data.refit(records, start, PARAMETERS, (-reach, reach)) for start in tried), key=_cost)
    slip = float(moved.x[4])
    gain = estimate.rms_rad**2 * moved.residual.size / moved.cost if moved.cost > 0.0 else math.inf
    if abs(slip) > SLIPPED * period and gain > 1.02:
        way = "later" if slip > 0.0 else "earlier"
        return estimate.judged(
            "refused" if abs(slip) > 2.0 * SLIPPED * period else "doubtful",
            f"the drive seems to act {1e3 * abs(slip):.1f} ms {way} than t_u_s says: check that u stands in its own "
            "row (y_k, then u_k, which acts from t_u_s of row k)",
        )
    if abs(slip) <= max(record.times_error_s for record in records):
        return estimate
    free = (math.exp(moved.x[0]), math.exp(moved.x[1]), float(moved.x[2]))
    shifted = [name for name, value in zip(PARAMETERS, free, strict=False) if not _holds(estimate, name, value)]
    if shifted and gain > 1.0 + max(0.02, 15.0 / moved.residual.size):
        return estimate.judged(
            "doubtful",
            f"with the drive {1e3 * abs(slip):.2g} ms {'later' if slip > 0.0 else 'earlier'} the fit is better and "
            f"{' and '.join(shifted)} out of the interval: t_u_s is not when the drive acted, or rows between these "
            "were left out; record every tick",
        )
    return estimate


def _holds(estimate: Estimate, name: str, value: float) -> bool:
    """Whether the estimate's interval of this parameter holds the value."""
    low, high = estimate.ci95[name]
    return low <= value <= high


def _cost(solution: sampled_data.Solution) -> float:
    return solution.cost


def _sticking(estimate: Estimate, records: Sequence[Record]) -> Estimate:
    motor = estimate.motor()
    share = 0.0
    for record in records:
        late = int(np.searchsorted(record.t_s, record.edge_s[0]))
        states = motor.response(State(y=float(record.y_rad[late])), record.t_s[late:], record.edge_s, record.u_V)
        share = max(share, float(np.mean(states[:, 0] == 0.0)))
    if share > STUCK:
        return estimate.judged(
            "doubtful", f"the motor stands still {100 * share:.0f} % of the time: record with more drive"
        )
    return estimate


def _transfer(estimate: Estimate, records: Sequence[Record]) -> Estimate:
    """Of several tests, the first one's model has to predict the others nearly as well as their own."""
    if len(records) < 2:
        return estimate
    theta = Theta(estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V, estimate.asym_V, estimate.delay_s)
    unknown = any(record.t_u_s is None for record in records)
    free = PARAMETERS if unknown else PARAMETERS[:4]
    bounds = (0.0, max(record.longest_delay_s for record in records)) if unknown else None
    theta = theta if unknown else theta._replace(delay_s=0.0)
    try:
        first = sampled_data.refit(records[:1], theta, free, bounds)
        model = Theta(math.exp(first.x[0]), math.exp(first.x[1]), *(float(x) for x in first.x[2:5]))
        ratios = []
        for record in records[1:]:
            own = sampled_data.refit([record], theta, free, bounds)
            given = sampled_data.refit([record], model)
            rms = math.sqrt(given.cost / given.residual.size)
            if rms > NEGLIGIBLE * _spread([record]):
                ratios.append(math.sqrt(given.cost / own.cost) if own.cost > 0.0 else math.inf)
    except IdentifyError:
        return estimate  # too short to be fitted alone
    if ratios and max(ratios) > TRANSFER:
        return estimate.judged(
            "doubtful",
            f"the first test's model predicts another with {max(ratios):.1f} times the residual of its own fit: "
            "friction or gain depend on speed, amplitude or temperature; record the tests nearer to the use",
        )
    return estimate
