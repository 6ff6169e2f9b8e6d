"""What the shaft travels until it stands, and the room that there is for it: arithmetic on the config.

``e`` is the experiment throughout; positions count from 0 rad, the centre of travel.
"""

from __future__ import annotations

from math import ceil, log
from typing import NamedTuple

from rig.config.backend import is_plug_in, writes_first
from rig.config.link_budget import link_adapter_s
from rig.config.schema import Experiment

_REACTION_PERIODS = 3  # of the loop: one until the next tick, two by which the guard's velocity lags
_VELOCITY_LAG_S = 0.02  # by which it lags at least: half of its window
_BLOCK_AGE_PERIODS = 2  # of the loop: the rows of a device's block are older than a reply, by its length and its way


def reaction_periods(experiment: Experiment) -> int:
    """Periods of the loop until it can have reacted to what the shaft does."""
    return (
        _REACTION_PERIODS
        + (_BLOCK_AGE_PERIODS if experiment.relay.where == "device" else 0)
        + (1 if writes_first(experiment) else 0)
    )


def reaction_s(experiment: Experiment) -> float:
    """Time until the loop can have reacted to what the shaft does, s."""
    periods_s = reaction_periods(experiment) * experiment.period_s
    return periods_s + _further_lag_s(experiment) + link_adapter_s(experiment)


def _further_lag_s(e: Experiment) -> float:
    """Of the guard's velocity, beyond two periods, where the period is short."""
    return max(_VELOCITY_LAG_S - 2.0 * e.period_s, 0.0)


def device_watchdog_s(experiment: Experiment) -> float | None:
    """Silence of the host after which the device drives 0 V, s; None where it has no watchdog.

    Of a plug-in driver's device the config does not tell: what it is armed with, if it has one.
    """
    modbus = experiment.daq.modbus
    if modbus is None or modbus.registers.watchdog is not None:
        return experiment.daq.watchdog_s
    return modbus.device_watchdog_s


def known_reaction_s(experiment: Experiment) -> float:
    """``reaction_s``, one reply that never comes, and the device's watchdog where it has one, s."""
    return reaction_s(experiment) + experiment.daq.timeout_s + (device_watchdog_s(experiment) or 0.0)


def limits_are_ordered(e: Experiment) -> bool:
    """Whether the hard limits are outside the soft ones, and 0 rad within both."""
    (soft_low, soft_high), (hard_low, hard_high) = e.limits.soft_rad, e.limits.hard_rad
    return hard_low < soft_low < 0.0 < soft_high < hard_high


def room_rad(e: Experiment) -> float:
    """Distance from the centre of travel, about which the relay oscillates, to the nearer hard limit, rad."""
    return min(e.limits.hard_rad[1], -e.limits.hard_rad[0])


def reach_rad(e: Experiment) -> float:
    """Distance from the centre of travel to the nearer soft limit, rad."""
    return min(-e.limits.soft_rad[0], e.limits.soft_rad[1])


def stopping_terms(e: Experiment) -> tuple[tuple[str, float], ...]:
    """What the shaft travels from the largest speed if the host dies, term by term: words, rad.

    A device without a watchdog holds its last drive then, and nothing bounds the way: the sum is that of a host that
    lives, and ``stopping_sum`` says so.

    Coasting is at 0 V, terminals shorted, without the help of friction: speed times time constant. Each term is at the
    largest speed: the guard ends anything faster while the host lives. What the drive adds to it between the host's
    death and the device's watchdog depends on K and tau, which the experiment has yet to find: no sum over a config can
    count it, and the device's own hard limit is what ends such a drive.
    """
    v = e.limits.max_speed_rad_s
    lag_s, adapter_s = _further_lag_s(e), link_adapter_s(e)
    watchdog_s = device_watchdog_s(e)
    return (
        (f"{reaction_periods(e)} periods", v * reaction_periods(e) * e.period_s),
        *((("velocity window", v * lag_s),) if lag_s > 0.0 else ()),
        *((("USB adapter", v * adapter_s),) if adapter_s > 0.0 else ()),
        ("reply time-out", v * e.daq.timeout_s),
        *((("watchdog", v * watchdog_s),) if watchdog_s is not None else ()),
        ("coasting", v * e.limits.coast_tau_s),
    )


def stopping_sum(e: Experiment) -> str:
    """``stopping_terms`` and what they add up to, for people."""
    terms = stopping_terms(e)
    written = " + ".join(f"{rad:.3f} {words}" for words, rad in terms)
    total = f"at {e.limits.max_speed_rad_s:g} rad/s: {written} = {sum(rad for _, rad in terms):.3f} rad"
    if device_watchdog_s(e) is None:
        return f"{total} while the host lives; if it dies nothing bounds it: the device has no watchdog"
    if is_plug_in(e) and e.daq.accept_no_watchdog:
        return f"{total} if the plug-in driver's device has a watchdog; without one nothing bounds it if the host dies"
    return total


UNSEEN_RAD = 0.5  # the most that a shaft may turn in the breakaway check while the sensor does not show it
FRICTION_DIFFERS = 0.1  # by so much, at most, of its mean that of one way from the mean of both
_LONGEST_STROKE_S = 0.08
_LEAST_CYCLE_S = 0.16  # a stroke and the pause after it: what averages the noise, and keeps the pairs few
_LEAST_PAUSE_PERIODS = 4
_MOST_PAIRS = 10_000
_ROUNDING = 1e-9


class BreakawayStrokes(NamedTuple):
    """The strokes of the breakaway check.

    stroke_s, pause_s  lengths, whole periods
    step_V             by how much the level rises from pair to pair
    pairs              until breakaway.max_V
    unseen_rad         what the shaft turns at most, at any time in the check, if the sensor shows nothing of it
    """

    stroke_s: float
    pause_s: float
    step_V: float
    pairs: int
    unseen_rad: float


def breakaway_strokes(e: Experiment, max_V: float | None = None) -> BreakawayStrokes | None:
    """The longest strokes whose unseen travel is within ``UNSEEN_RAD``; None where those of one period exceed it.

    max_V  instead of the config's
    Raises ValueError where the config does not tell the motor's speed.

    A stroke of level u and length s moves a shaft of gain K from rest by K (u - f) s at most, whatever its time
    constant, and the stroke back takes that back. What n pairs leave is what friction f (1 +- d) makes of the
    difference, largest without inertia: 2 d f K s for each pair above f. With f = p max_V the sum is
    K max_V s (2 d n p (1 - p) + 1 - p (1 - d)), here at the worst p. K is no more than the no-load speed by the supply.
    """
    if e.motor is None:
        raise ValueError("the config does not say motor.no_load_speed_rad_s")
    max_V = e.breakaway.max_V if max_V is None else max_V
    top_rad_s = e.motor.no_load_speed_rad_s * max_V / e.drive.supply_V
    for periods in range(max(int(_LONGEST_STROKE_S / e.period_s + _ROUNDING), 1), 0, -1):
        cycle = max(2 * periods, periods + _LEAST_PAUSE_PERIODS, ceil(_LEAST_CYCLE_S / e.period_s - _ROUNDING))
        step_V = e.breakaway.ramp_V_s * cycle * e.period_s
        if max_V > _MOST_PAIRS * step_V:
            continue  # it would take hours
        pairs = max(ceil(max_V / step_V - _ROUNDING), 1)
        drift = 2.0 * FRICTION_DIFFERS * pairs
        p = max(0.5 * (1.0 - (1.0 - FRICTION_DIFFERS) / drift), 0.0)
        unseen_rad = top_rad_s * periods * e.period_s * (drift * p * (1.0 - p) + 1.0 - p * (1.0 - FRICTION_DIFFERS))
        if unseen_rad <= UNSEEN_RAD:
            return BreakawayStrokes(periods * e.period_s, (cycle - periods) * e.period_s, step_V, pairs, unseen_rad)
    return None


def peak_speed_rad_s(amplitude_rad: float, period_s: float) -> float:
    """Largest speed of a limit cycle, rad/s: of two parabolas, a little more than the true arcs reach."""
    return 8.0 * amplitude_rad / period_s


def predicted_stop_rad(e: Experiment, amplitude_rad: float, period_s: float) -> float:
    """Largest stop that the guard predicts within a cycle, rad.

    A cycle of constant accelerations, y = A (1 - s^2) with v = 8 A s/T at s = 0..1 from its top, is faster than the
    motor's; its largest y + v r is A (1 + (4 r/T)^2) within the arc, else 8 A r/T at the centre.
    """
    r = sum(rad for _, rad in stopping_terms(e)) / e.limits.max_speed_rad_s
    s = 4.0 * r / period_s
    return amplitude_rad * (1.0 + s * s if s < 1.0 else 2.0 * s)


def overshoot_terms(e: Experiment) -> tuple[tuple[str, float], ...]:
    """How far the shaft goes on, at most, once it is beyond the hysteresis: words, rad.

    From a speed v that drive d has given it, -d stops it within v tau (1 - ln 2), the more friction the sooner.
    """
    v = e.limits.max_speed_rad_s
    periods = 3 if writes_first(e) else 2
    return (
        (f"{periods} periods", periods * v * e.period_s),
        ("reversing", v * e.limits.coast_tau_s * (1.0 - log(2.0))),
    )
