"""Rules that the verdicts of all estimators share; the answer's own is in ``motor_law.reservations``.

Reasons say what to record instead (docs/theory.md 7.7).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.identification.departures.blocks import MOST_ERROR, HeldOut
from rig.identification.estimate import Estimate
from rig.identification.mean_cycle import Cycle
from rig.identification.measurements import Measurements
from rig.identification.output_error import refit
from rig.model.sensitivity import Theta
from rig.run_folder.recording.series import TimeSeries, joined_times_s

PROMISE = 0.05  # verdict ok promises that no relative error of a parameter is larger,
SURE = 2.0  # so a 95 % interval must be this many times narrower: then one recording in ten thousand breaks the promise
ASKED = PROMISE / SURE  # so much of u95 is ok, and of a 95 % interval, relative to the parameter
RISK = 0.01  # probability that laws which the tests do not exclude break the promise, that ok bears
SMALL_FRICTION = 0.03  # of the largest drive: the size that smaller friction counts as
TOO_WIDE = 0.5  # half width of an interval, relative to its parameter
POOR, TOO_POOR = 0.1, 0.4  # residual of a reference method over the spread of positions
FEW_CYCLES = 5
TELLS = 3.0  # residual over the sensor's noise, at most, of a motor that tells the whole tests
TITLES = {"tau_s": "tau", "K_rad_s_V": "K", "fc_V": "f_c"}  # in what people read
MORE_CYCLES = "record more cycles, or slower and larger ones"  # the cure of an interval that is too wide
ROW_UP = "if it was set before, move u up by a row (of a log: --drive-row -1)"


def judge_reference(estimate: Estimate, tests: Sequence[TimeSeries], known_bias: str | None = None) -> Estimate:
    """A triple-relay or describing-function estimate with its residual on the tests, and its verdict.

    The residual comes from the exact prediction under the recorded drive. Initial states, asymmetry and an unknown
    delay are fitted.

    known_bias  an error of the method that neither the scatter of the cycles nor the interval shows, as a sentence
    """
    if not (estimate.tau_s > 0.0 and estimate.K_rad_s_V > 0.0 and estimate.fc_V >= 0.0):
        return estimate.judged(
            "refused",
            f"no motor has tau = {estimate.tau_s:.3g} s, K = {estimate.K_rad_s_V:.3g} (rad/s)/V, "
            f"f_c = {estimate.fc_V:.3g} V: record larger and slower cycles",
        )
    estimate = enough_cycles(intervals(estimate, tests), estimate.cycles)
    free = ["asym_V"]
    bounds = None
    delay = 0.0
    if any(test.t_u_s is None for test in tests):
        longest = max(test.longest_delay_s for test in tests)
        free.append("delay_s")
        bounds, delay = (0.0, longest), 0.25 * longest
        if 0.0 < estimate.delay_s < longest:  # nan if the method does not estimate it
            delay = estimate.delay_s
    theta = Theta(estimate.tau_s, estimate.K_rad_s_V, estimate.fc_V, estimate.asym_V, delay)
    solution = refit(tests, theta, free, bounds)
    rms = solution.rms_rad
    estimate = replace(
        estimate,
        rms_rad=rms,
        residual_rad=-solution.residual,
        residual_t_s=joined_times_s(test.predictable(bounds[1] if bounds else 0.0) for test in tests),
    )
    if known_bias is not None:
        estimate = estimate.judged("doubtful", known_bias)
    share = rms / spread_rad(tests)
    if share > POOR:
        return estimate.judged(
            "refused" if share > TOO_POOR else "doubtful",
            f"its model leaves {in_percent(share)} of the position unexplained: trust the sampled-data estimate; "
            "for this method record slower cycles, or sample faster",
        )
    return estimate


def spread_rad(tests: Sequence[TimeSeries]) -> float:
    """Standard deviation of the positions, root mean square over the tests, rad."""
    return float(np.sqrt(np.mean([np.var(test.y_rad) for test in tests])))


def intervals(estimate: Estimate, tests: Sequence[TimeSeries]) -> Estimate:
    """Judge the estimate by the widths of its intervals."""
    for name, size in sizes_of(estimate, largest_drive_V(tests)).items():
        if name not in estimate.ci95:
            continue
        low, high = estimate.ci95[name]
        share = 0.5 * (high - low) / size
        if not math.isfinite(share):
            return estimate.judged(
                "refused",
                "the recording cannot separate tau, K and f_c: record drives of several sizes, both ways",
                spoiled=False,
            )
        if share > ASKED:
            estimate = estimate.judged(
                "refused" if share > TOO_WIDE else "doubtful",
                f"{known_to(name, share)}: {MORE_CYCLES}",
                spoiled=False,
            )
    return estimate


def reserved(estimate: Estimate, reservations: Sequence[str]) -> Estimate:
    """The estimate doubtful for what u95 says. What its interval alone says of a number is less, and stands no more."""
    if not reservations:
        return estimate
    kept = tuple(reason for reason in estimate.reasons if not reason.endswith(MORE_CYCLES))
    return replace(estimate, reasons=kept).judged("doubtful", *reservations)


def largest_drive_V(tests: Sequence[TimeSeries]) -> float:
    """The largest drive of the tests, V."""
    return max(float(np.abs(test.u_V).max()) for test in tests)


def sizes_of(estimate: Estimate, largest_V: float) -> dict[str, float]:
    """What an error of tau, K and friction is relative to, each in its unit, > 0.

    largest_V   largest drive of the tests, V: friction near zero has no useful relative error
    """
    sizes = {"tau_s": abs(estimate.tau_s), "K_rad_s_V": abs(estimate.K_rad_s_V)}
    sizes["fc_V"] = max(abs(estimate.fc_V), SMALL_FRICTION * largest_V)
    return sizes


def by_prediction(estimate: Estimate, predicts: HeldOut, noise_rad: float = 0.0) -> Estimate:
    """The estimate refused if it does not predict: much worse than nothing, or worse than a linear model.

    One that predicts is refused for nothing but what no fit mends. Bounds: ``HeldOut.is_useful``. Nor is one that tells
    the whole tests to the sensor's noise, ``noise_rad``, worse than a linear model: of a chirp, say, its first and
    largest swings were not seen, and the others say too little of a motor.
    """
    tells_all = estimate.rms_rad <= TELLS * noise_rad and predicts.error <= MOST_ERROR
    if not (predicts.is_useful or tells_all):
        return estimate.judged(
            "refused",
            f"it does not predict motion that it has not seen: its error is {in_percent(predicts.error)} of the "
            f"motion, a linear model's {in_percent(predicts.linear_error)}; see that drive and position belong "
            "together, and record larger motion without loads that change",
            spoiled=False,
        )
    return replace(estimate, verdict="doubtful") if estimate.verdict == "refused" and not estimate.spoiled else estimate


def beside(value: float, other: float) -> str:
    """``value`` with two digits, or as many as show that it is not ``other``."""
    known = (f"{value:.{digits}g}" for digits in range(2, 18))
    return next((text for text in known if text != f"{other:.2g}"), f"{other:.2g}")


def in_percent(share: float) -> str:
    """A share as ``12 %``; what is more than the whole is said in words: its number means nothing."""
    if not share <= 1.0:
        return "more than 100 %"
    return f"{100.0 * share:.0f} %" if share >= 0.1 else f"{100.0 * share:.2g} %"


def known_to(name: str, share: float) -> str:
    """How well a parameter is known, where that is not enough; ``share``: half width at 95 %, of the parameter."""
    if not share <= 1.0:
        return f"{TITLES[name]} is unknown: at 95 % it may be off by more than its own size"
    return (
        f"{TITLES[name]} is only known to {beside(100.0 * share, 100.0 * ASKED)} % (at 95 %); "
        f"ok asks for {100.0 * ASKED:.2g} %"
    )


def enough_cycles(estimate: Estimate, cycles: Sequence[Cycle]) -> Estimate:
    """Judge the estimate by the number of settled cycles."""
    few = [cycle.cycles for cycle in cycles if cycle.cycles < FEW_CYCLES]
    if few:
        return estimate.judged("doubtful", f"only {min(few)} settled cycles: record ten")
    return estimate


def settled(estimate: Estimate, data: Measurements) -> Estimate:
    """Refused if there are relay tests, but no settled cycle in any of them."""
    if not data.unsettled or data.settled:
        return estimate
    return estimate.judged(
        "refused", f"no settled cycle in {', '.join(data.unsettled)}: {FEW_CYCLES} are missing; record ten"
    )


def unguarded(estimate: Estimate, data: Measurements) -> Estimate:
    """Doubtful if the guard changed the relay's drive: for methods that need the relay's own cycle."""
    return estimate.judged("doubtful", *data.guarded) if data.guarded else estimate
