"""Static friction in both directions, from the breakaway ramps and the identified motor (docs/theory.md 7.3, 8.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rig.identification.estimate import Estimate
from rig.model.friction import Friction
from rig.model.motor import Motor, State
from rig.run_folder.recording.series import TimeSeries
from rig.run_folder.results import StaticFrictionResult

SETTLE_S = 0.3  # time after the last drive of a ramp that still belongs to it
CHANCE = 3.84  # chi-squared of one degree, 95 %
ROUGH = 0.05  # of a level: so much more than its interval says, a standard deviation, a ramp is off on emulated benches
NEEDED = 0.1  # largest relative standard error with which friction and bias are split


@dataclass(frozen=True)
class Ramp:
    """Drive at which the motor breaks away in one direction, V (> 0), and its interval."""

    static_V: float
    low_V: float
    high_V: float

    @property
    def error_V(self) -> float:
        """Standard error, V: a quarter of the interval's width."""
        return 0.25 * (self.high_V - self.low_V)


@dataclass(frozen=True)
class StaticFriction:
    """Static friction from breakaway ramps.

    plus, minus   towards rising and falling positions; None if the ramp does not show it
    friction_V    (fc_plus, fc_minus, bias), V; None unless static friction is clearly above moving friction
    reason        why something is None, or what was assumed, as a sentence
    """

    plus: Ramp | None
    minus: Ramp | None
    friction_V: tuple[float, float, float] | None
    reason: str

    @property
    def level_V(self) -> tuple[float, float] | None:
        """Friction at rest, the mean of both directions, and its standard error, V; None unless both show it.

        The error is larger than the intervals say (docs/theory.md 8.4): noise hides how a shaft creeps away just above
        the level. Under Stribeck friction a ramp shows too much, for its fit takes friction for that in motion.
        """
        if self.plus is None or self.minus is None:
            return None
        level_V = 0.5 * (self.plus.static_V + self.minus.static_V)
        return level_V, math.hypot(self.plus.error_V, self.minus.error_V, ROUGH * level_V)

    def as_result(self) -> StaticFrictionResult:
        """As result.json holds it: the drives at break-away, their intervals, and the reason."""
        return StaticFrictionResult(
            static_plus_V=None if self.plus is None else self.plus.static_V,
            static_minus_V=None if self.minus is None else self.minus.static_V,
            static_plus_range_V=None if self.plus is None else (self.plus.low_V, self.plus.high_V),
            static_minus_range_V=None if self.minus is None else (self.minus.low_V, self.minus.high_V),
            reason=self.reason,
        )


def breakaway(series: TimeSeries, estimate: Estimate, noise_rad: float) -> StaticFriction:
    """Static friction from slow ramps of the drive in both directions, one after the other or alternating.

    noise_rad  standard deviation of the noise on the positions, rad
    The exact simulation is compared with the recorded positions; the drive at break-away is the mean of the likelihood.
    It includes bias: towards rising positions it is static friction minus bias, towards falling ones plus bias.
    """
    plus = _ramp(series, estimate, 1.0, noise_rad)
    minus = _ramp(series, estimate, -1.0, noise_rad)
    if plus is not None and minus is not None and _alternates(series):
        # Strokes in the other direction move the shaft, too. So far the fit took their level for equal.
        plus = _ramp(series, estimate, 1.0, noise_rad, minus.static_V)
        minus = minus if plus is None else _ramp(series, estimate, -1.0, noise_rad, plus.static_V)
    if plus is None or minus is None:
        which = (
            "either way" if plus is None and minus is None else "towards " + ("rising" if plus is None else "falling")
        )
        return StaticFriction(plus, minus, None, f"the breakaway ramps show no motion {which}: ramp higher")
    friction, reason = split(plus, minus, estimate)
    return StaticFriction(plus, minus, friction, reason)


def _alternates(series: TimeSeries) -> bool:
    """Whether strokes in one direction lie between strokes in the other."""
    signs = np.sign(series.u_V[series.u_V != 0.0])
    return int(np.count_nonzero(np.diff(signs))) > 1


def _ramp(
    series: TimeSeries, estimate: Estimate, sign: float, noise_rad: float, other_V: float | None = None
) -> Ramp | None:
    """Scan the drives of one direction for the level that explains the positions best.

    other_V  static level of the other direction; None: the level that is tried
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
    # All levels between two drives of the ramp give one motion: one trial for each gap, and one above all drives.
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
    # Costs are flat where noise hides the first motion, so take the mean of the likelihood, not the lowest cost.
    weights = np.diff(np.concatenate((lows[:1], levels))) * np.exp(-0.5 * (costs[:-1] - costs[best]) / variance)
    return Ramp(float(weights @ np.array(trials[:-1]) / weights.sum()), float(low), float(high))


def split(plus: Ramp, minus: Ramp, estimate: Estimate) -> tuple[tuple[float, float, float] | None, str]:
    """(fc_plus, fc_minus, bias), V, or None; and the reason as a sentence.

    If static and moving friction are equal, nothing separates bias from the direction of friction: motion shows only
    fc_plus - bias and fc_minus + bias, and so does the band in which the motor sticks. If static friction is r > 1
    times moving friction, with one ratio in both directions, the ramps also show (r - 1) fc_plus and (r - 1) fc_minus.
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
            f"static friction is not clearly above moving friction (ratio {ratio:.3f}), so bias and "
            "direction of friction cannot be told apart"
        )
    if error / excess > NEEDED * estimate.fc_V:
        return None, (
            f"static friction is {ratio:.3f} times moving friction, too little to tell bias from direction of friction "
            f"(their error would be {error / excess:.2g} V)"
        )
    fc_plus, fc_minus = (plus.static_V - moving[0]) / excess, (minus.static_V - moving[1]) / excess
    return (fc_plus, fc_minus, fc_plus - moving[0]), (
        f"fc_plus, fc_minus and bias assume one ratio of static to moving friction in both directions ({ratio:.3f})"
    )
