"""The summary of a campaign: errors against the bound and the truth, coverage of the intervals, verdicts.

Errors are estimate minus truth. *RMS/bound* is the RMS error over the RMS of the Cramer-Rao bounds. *RMS ratio* is the
RMS of each error over its own bound: every experiment has the same weight. Both are 1 for an estimator at the limit.
Coverage is the share of nominal 95 % intervals that hold the truth, with its binomial standard error. A parameter that
was known, such as a recorded delay, has no interval and no coverage.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from typing import NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from rig.campaign.results import Table
from rig.campaign.trial import FAILED
from rig.core.arrays import Array
from rig.identification.estimate import PARAMETERS

MAIN = PARAMETERS[:3]  # their errors are relative to the truth; the true value of the others may be zero
OFF = 0.05  # relative error that no verdict ok may have
FAR = 5.0  # times the bound: a larger error is not chance
MOST_NAMED = 20
VERDICTS = ("ok", "doubtful", "refused", FAILED)


class Seconds(TypedDict):
    """Worker time for one experiment, s."""

    median: float
    sum: float


class Spread(TypedDict):
    """A ratio over many experiments."""

    median: float
    p95: float
    max: float


class ParameterSums(TypedDict):
    """The errors of one parameter: relative to the truth for tau, K and f_c, else absolute."""

    rms_error: float
    rms_bound: float
    rms_over_bound: float
    rms_ratio: float
    coverage: float
    coverage_error: float
    standardised: float
    relative_median: NotRequired[float]
    relative_p95: NotRequired[float]
    relative_max: NotRequired[float]
    absolute_median: NotRequired[float]
    absolute_p95: NotRequired[float]
    absolute_max: NotRequired[float]


class Sums(TypedDict):
    """The number of experiments, and the sums of each parameter over them."""

    number: int
    parameters: dict[str, ParameterSums]


class SessionSpeed(TypedDict):
    """The speed of one session of the campaign: ``experiments`` in ``seconds``."""

    backend: str
    workers: str
    experiments: int
    seconds: float
    experiments_per_s: float | None


class TableSummary(TypedDict):
    """The sums of a campaign's rows; nan for a sum of nothing.

    number        experiments
    verdicts      verdict -> count
    reasons       [reason with # for its numbers, count], most frequent first
    ok            sums over the experiments called ok
    estimated     sums over all experiments that have an estimate
    ok_but_off    numbers of experiments called ok with an error above 5 % in tau, K or fc
    failed        numbers of experiments that an exception ended
    far           numbers of experiments with an error above 5 times its bound, whatever their verdict
    second        residual of the predicted second test over the residual of the true motor; absent without that test
    """

    number: int
    seconds: Seconds
    verdicts: dict[str, int]
    reasons: list[list[str | int]]
    ok: Sums
    estimated: Sums
    ok_but_off: list[int]
    failed: list[int]
    far: list[int]
    second: NotRequired[Spread]


class Summary(TableSummary):
    """summary.json: the sums, the campaign, the last session, and the command that repeats a failed experiment."""

    campaign: str
    session: SessionSpeed
    repeat: str | None


def summarise(table: Table) -> TableSummary:
    """The sums of a campaign."""
    ok = table["verdict"] == "ok"
    estimated = np.isfinite(table["tau_s"])
    seconds = table["seconds"]
    found: TableSummary = {
        "number": int(ok.size),
        "seconds": {"median": _quantile(seconds, 0.5), "sum": float(seconds.sum())},
        "verdicts": {verdict: int(np.count_nonzero(table["verdict"] == verdict)) for verdict in VERDICTS},
        "reasons": reasons(table),
        "ok": sums(table, ok & estimated),
        "estimated": sums(table, estimated),
        "ok_but_off": numbers(table, ok & np.any([relative_error(table, name) > OFF for name in MAIN], axis=0)),
        "failed": numbers(table, table["verdict"] == FAILED),
        "far": numbers(table, np.any([np.abs(over_bound(table, name)) > FAR for name in MAIN], axis=0)),
    }
    second = (table["second_rms_rad"] / table["second_own_rms_rad"])[ok]
    if np.isfinite(second).any():
        found["second"] = {"median": _quantile(second, 0.5), "p95": _quantile(second, 0.95), "max": float(max(second))}
    return found


def sums(table: Table, chosen: NDArray[np.bool_]) -> Sums:
    """The number of ``chosen`` experiments, and for each parameter its sums over them."""
    part = {name: column[chosen] for name, column in table.items()}
    return {"number": int(chosen.sum()), "parameters": {name: _parameter(part, name) for name in PARAMETERS}}


def error(table: Table, name: str) -> Array:
    """Estimate minus truth, in the parameter's unit; nan without an estimate."""
    return np.asarray(table[name] - table[f"true_{name}"])


def relative_error(table: Table, name: str) -> Array:
    """Absolute value of the error over the truth."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.abs(error(table, name) / table[f"true_{name}"]))


def over_bound(table: Table, name: str) -> Array:
    """Error over its Cramer-Rao bound; nan without a bound."""
    return np.asarray(error(table, name) / table[f"bound_{name}"])


def covered(table: Table, name: str) -> NDArray[np.bool_]:
    """Whether the nominal 95 % interval holds the truth. A missing interval does not."""
    truth = table[f"true_{name}"]
    return np.asarray((table[f"low_{name}"] <= truth) & (truth <= table[f"high_{name}"]))


def coverage(held: NDArray[np.bool_]) -> tuple[float, float]:
    """Share of true values in ``held``, and its binomial standard error; nan for an empty one.

    held  whether each interval holds the truth
    """
    if held.size == 0:
        return math.nan, math.nan
    share = float(held.mean())
    return share, math.sqrt(share * (1.0 - share) / held.size)


def rms(values: Array) -> float:
    """Root mean square of the finite ``values``; nan if there are none."""
    finite = values[np.isfinite(values)]
    return math.sqrt(float(np.mean(finite**2))) if finite.size else math.nan


def numbers(table: Table, chosen: NDArray[np.bool_]) -> list[int]:
    """The numbers of the chosen experiments."""
    return [int(number) for number in table["number"][chosen]]


def reasons(table: Table) -> list[list[str | int]]:
    """Why experiments were not called ok: each reason, with # for its numbers, and how often it occurs."""
    found = Counter(
        re.sub(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", "#", reason)
        for row in table["reasons"]
        for reason in row.split(" | ")
        if reason
    )
    return [[reason, count] for reason, count in found.most_common(MOST_NAMED)]


def _parameter(part: Table, name: str) -> ParameterSums:
    errors, bounds = error(part, name), part[f"bound_{name}"]
    share, scatter = coverage(covered(part, name)[part[f"se_{name}"] != 0.0])  # 0: known, not estimated
    found: ParameterSums = {
        "rms_error": rms(errors),
        "rms_bound": rms(bounds),
        "rms_over_bound": rms(errors) / rms(bounds),
        "rms_ratio": rms(over_bound(part, name)),
        "coverage": share,
        "coverage_error": scatter,
        "standardised": rms(errors / _positive(part[f"se_{name}"])),
    }
    sizes = relative_error(part, name) if name in MAIN else np.abs(errors)
    median, p95, largest = (_quantile(sizes, share) for share in (0.5, 0.95, 1.0))
    if name in MAIN:
        return {**found, "relative_median": median, "relative_p95": p95, "relative_max": largest}
    return {**found, "absolute_median": median, "absolute_p95": p95, "absolute_max": largest}


def _positive(values: Array) -> Array:
    return np.where(values > 0.0, values, np.nan)


def _quantile(values: Array, share: float) -> float:
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, share)) if finite.size else math.nan
