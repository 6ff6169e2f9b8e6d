"""Static friction both ways, from the breakaway strokes and the identified motor (docs/theory.md 7.3, 8.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.identify.estimate import Estimate
from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.recording.series import TimeSeries
from rig.results import StaticFrictionResult

Array = NDArray[np.float64]

SETTLE_S = 0.3  # after the last drive of a ramp
CHANCE = 3.84  # chi-squared of one degree, 95 %
NEEDED = 0.1  # relative standard error up to which a split of friction and bias is told


@dataclass(frozen=True)
class Ramp:
    """Drive at which the motor breaks away one way, V (> 0), and the interval that the record leaves."""

    static_V: float
    low_V: float
    high_V: float

    @property
    def error_V(self) -> float:
        """Standard error: that of the interval taken as two standard errors each way."""
        return 0.25 * (self.high_V - self.low_V)


@dataclass(frozen=True)
class StaticFriction:
    """What the ramps show.

    plus, minus   towards rising and falling positions; None where the ramp does not tell
    friction_V    (fc_plus, fc_minus, bias), V; None unless static friction is clearly above moving friction
    reason        in words: why something is None, or what was assumed
    """

    plus: Ramp | None
    minus: Ramp | None
    friction_V: tuple[float, float, float] | None
    reason: str

    def as_result(self) -> StaticFrictionResult:
        """As result.json holds it: the drives at break-away, their intervals, and the reason."""
        return StaticFrictionResult(
            static_plus_V=None if self.plus is None else self.plus.static_V,
            static_minus_V=None if self.minus is None else self.minus.static_V,
            static_plus_range_V=None if self.plus is None else (self.plus.low_V, self.plus.high_V),
            static_minus_range_V=None if self.minus is None else (self.minus.low_V, self.minus.high_V),
            reason=self.reason,
        )


class Ramps(NamedTuple):
    """Static level from ramps both ways, V; its standard error, V; and whether each way alone shows one (95 %).

    They take friction for fc as soon as the motor moves: with Stribeck friction it seems to break away later.
    """

    fs_V: float
    error_V: float
    shown: tuple[bool, bool]

    @classmethod
    def of(cls, breakaway: StaticFriction | None, estimate: Estimate) -> Ramps | None:
        """From a breakaway record, beside the friction in motion; None where it does not show both ways."""
        if breakaway is None or breakaway.plus is None or breakaway.minus is None:
            return None
        plus, minus = breakaway.plus, breakaway.minus
        moving = estimate.fc_V - estimate.asym_V, estimate.fc_V + estimate.asym_V
        return cls(
            0.5 * (plus.static_V + minus.static_V),
            0.5 * math.hypot(plus.error_V, minus.error_V),
            (plus.low_V > moving[0], minus.low_V > moving[1]),
        )


def breakaway(series: TimeSeries, estimate: Estimate, noise_rad: float) -> StaticFriction:
    """Static friction from the record of a slow ramp each way, in strokes one after the other or to and fro.

    The drive at break-away is that for which the exact simulation reproduces the recorded positions (their likelihood's
    mean). It includes bias: towards rising positions it is static friction less bias, towards falling ones static
    friction plus bias.
    """
    plus = _ramp(series, estimate, 1.0, noise_rad)
    minus = _ramp(series, estimate, -1.0, noise_rad)
    if plus is not None and minus is not None and _alternates(series):
        # strokes the other way move the shaft, too: their level was taken for equal so far
        plus = _ramp(series, estimate, 1.0, noise_rad, minus.static_V)
        minus = minus if plus is None else _ramp(series, estimate, -1.0, noise_rad, plus.static_V)
    if plus is None or minus is None:
        which = (
            "either way" if plus is None and minus is None else "towards " + ("rising" if plus is None else "falling")
        )
        return StaticFriction(plus, minus, None, f"no motion was seen in the breakaway record {which}: ramp higher")
    friction, reason = split(plus, minus, estimate)
    return StaticFriction(plus, minus, friction, reason)


def _alternates(series: TimeSeries) -> bool:
    """Whether strokes one way lie between those of the other."""
    signs = np.sign(series.u_V[series.u_V != 0.0])
    return int(np.count_nonzero(np.diff(signs))) > 1


def _ramp(
    series: TimeSeries, estimate: Estimate, sign: float, noise_rad: float, other_V: float | None = None
) -> Ramp | None:
    """Scan the drives of one way for the level that explains the positions best.

    other_V  static level of the other way; without it, as the one that is tried
    """
    driven = np.flatnonzero(sign * series.u_V > 0.0)
    if driven.size < 5:
        return None
    acts = series.edge_s + (
        0.0 if series.t_u_s is not None or not math.isfinite(estimate.delay_s) else estimate.delay_s
    )
    first, last = max(int(driven[0]) - 1, 0), int(driven[-1])
    stop = int(np.searchsorted(series.t_s, series.t_s[last] + SETTLE_S))
    other = np.flatnonzero(sign * series.u_V[last:stop] < 0.0)
    stop = last + int(other[0]) if other.size else stop
    start = int(np.searchsorted(series.t_s, acts[first]))
    t_s, y_rad = series.t_s[start:stop], series.y_rad[start:stop]
    edges, drive = acts[first:stop], series.u_V[first:stop]
    moving_plus, moving_minus = estimate.fc_V - estimate.asym_V, estimate.fc_V + estimate.asym_V
    if t_s.size < 10 or min(moving_plus, moving_minus) < 0.0:
        return None
    moving = moving_plus if sign > 0.0 else moving_minus
    levels = np.unique(sign * series.u_V[driven])
    levels = levels[levels > moving]
    if levels.size == 0:
        return None
    # Between two levels that the ramp visits nothing changes: one trial for each gap, and one above all levels.
    lows = np.concatenate(([moving], levels))
    trials = [*(0.5 * (a + b) for a, b in zip(lows[:-1], levels, strict=True)), 2.0 * levels[-1]]
    costs = np.empty(len(trials))
    for k, static in enumerate(trials):
        opposite = static if other_V is None else other_V
        friction = (
            Friction(moving_plus, moving_minus, static, max(moving_minus, opposite))
            if sign > 0.0
            else Friction(moving_plus, moving_minus, max(moving_plus, opposite), static)
        )
        motor = Motor(estimate.tau_s, estimate.K_rad_s_V, friction)
        residual = y_rad - motor.response(State(), t_s, edges, drive)[:, 1]
        residual -= residual.mean()
        costs[k] = float(residual @ residual)
    best = int(np.argmin(costs))
    if best == len(trials) - 1:
        return None
    variance = max(costs[best] / t_s.size, noise_rad**2)
    near = np.flatnonzero(costs <= costs[best] + CHANCE * variance)
    low, high = lows[int(near[0])], levels[min(int(near[-1]), levels.size - 1)]
    # Costs are flat where the noise hides the first motion: the mean over what they leave, not their lowest point.
    weights = np.diff(np.concatenate((lows[:1], levels))) * np.exp(-0.5 * (costs[:-1] - costs[best]) / variance)
    return Ramp(float(weights @ np.array(trials[:-1]) / weights.sum()), float(low), float(high))


def split(plus: Ramp, minus: Ramp, estimate: Estimate) -> tuple[tuple[float, float, float] | None, str]:
    """(fc_plus, fc_minus, bias), V, or None; and the reason in words.

    With static and moving friction equal, bias and direction never separate: moving shows fc_plus - bias and
    fc_minus + bias, and so does the band in which the motor sticks. If static friction is r > 1 times the moving one,
    with one ratio both ways, then (r - 1) fc_plus and (r - 1) fc_minus show beside them.
    """
    moving = (estimate.fc_V - estimate.asym_V, estimate.fc_V + estimate.asym_V)
    ratio = (plus.static_V + minus.static_V) / (2.0 * estimate.fc_V) if estimate.fc_V > 0.0 else math.inf
    if not math.isfinite(ratio):
        return None, "there is no friction to split"
    variance = 2.0 * float(estimate.covariance[2, 2] + estimate.covariance[3, 3])
    error = math.sqrt(max(plus.error_V, minus.error_V) ** 2 + (variance if math.isfinite(variance) else 0.0))
    excess = ratio - 1.0
    if excess <= 3.0 * error / estimate.fc_V:
        return None, (
            f"static friction is not clearly above moving friction (ratio {ratio:.3f}), and without that bias and "
            "direction of friction cannot be told apart by any record"
        )
    if error / excess > NEEDED * estimate.fc_V:
        return None, (
            f"static friction is {ratio:.3f} times moving friction, too little to tell bias from direction of friction "
            f"(it would be good to {error / excess:.2g} V)"
        )
    fc_plus, fc_minus = (plus.static_V - moving[0]) / excess, (minus.static_V - moving[1]) / excess
    return (fc_plus, fc_minus, fc_plus - moving[0]), (
        f"fc_plus, fc_minus and bias assume one ratio of static to moving friction both ways ({ratio:.3f})"
    )
