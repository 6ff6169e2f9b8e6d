"""What the shaft travels until it stands, and the room for it: arithmetic on the config (docs/theory.md 10.1, 10.2).

``e`` is the experiment throughout; positions count from 0 rad, the centre of travel.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, log
from typing import NamedTuple

from rig.backends.registry import backend_of
from rig.config.schema import Experiment

_REACTION_PERIODS = 3  # of the loop: one until the next tick, two by which the guard's velocity lags
_VELOCITY_LAG_S = 0.02  # by which it lags at least: half of its window
_BLOCK_AGE_PERIODS = 2  # of the loop: the rows of a device's block are older than a reply, by its length and its way


def reaction_periods(experiment: Experiment) -> int:
    """Periods of the loop until it can have reacted to what the shaft does."""
    return (
        _REACTION_PERIODS
        + (_BLOCK_AGE_PERIODS if experiment.relay.where == "device" else 0)
        + (1 if backend_of(experiment).writes_first(experiment) else 0)
    )


def reaction_s(experiment: Experiment) -> float:
    """Time until the loop can have reacted to what the shaft does, s."""
    periods_s = reaction_periods(experiment) * experiment.period_s
    return periods_s + _further_lag_s(experiment) + backend_of(experiment).reply_delay_s(experiment)


def _further_lag_s(e: Experiment) -> float:
    """Of the guard's velocity, beyond two periods, where the period is short."""
    return max(_VELOCITY_LAG_S - 2.0 * e.period_s, 0.0)


def device_watchdog_s(experiment: Experiment) -> float | None:
    """Silence of the host after which the device drives 0 V, s; None where it has no watchdog.

    Where only the device can tell whether it has one: what that is armed with.
    """
    return backend_of(experiment).watchdog(experiment).time_s


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
    lag_s, adapter_s = _further_lag_s(e), backend_of(e).reply_delay_s(e)
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
    if not backend_of(e).watchdog(e).certain and e.daq.accept_no_watchdog:
        return f"{total} if the plug-in driver's device has a watchdog; without one nothing bounds it if the host dies"
    return total


UNSEEN_RAD = 0.5  # the most that a shaft may turn in the breakaway check while the sensor does not show it
FRICTION_DIFFERS = 0.1  # by so much, at most, of its mean that of one way from the mean of both
_LONGEST_STROKE_S = 0.08
_CYCLE_S = 0.16  # a stroke of the longest and the pause after it: what averages the noise, and keeps the pairs few
_LEAST_PAUSE_PERIODS = 4
_MOST_PAIRS = 1_000
_CHECK_WATCHDOG_S = 0.04  # of the device in the breakaway check, where that is not less than two periods
_SHORTER_S = 0.005  # by which it is tried shorter where no stroke is short enough
_LEAST_WATCHDOG_PERIODS = 2
_CLEARLY = 2.0  # times breakaway.motion_rad
_FRICTION_STEPS = 24  # at which the bound is looked for
_FINEST = 12  # halvings
_ROUNDING = 1e-9


class BreakawayStrokes(NamedTuple):
    """The strokes of the breakaway check.

    strokes_s   lengths, whole periods: that of each pair, the weakest first
    pause_s     after each, whole periods
    step_V      by how much the level rises from pair to pair
    watchdog_s  what the device's watchdog is armed with for the check; where the device has none, or one of its own
                that cannot be told, the longest delay of a tick that the bound reckons with
    unseen_rad  what the shaft turns at most, at any time in the check, if the sensor shows nothing of it
    """

    strokes_s: tuple[float, ...]
    pause_s: float
    step_V: float
    watchdog_s: float
    unseen_rad: float

    @property
    def pairs(self) -> int:
        """Until breakaway.max_V."""
        return len(self.strokes_s)


def breakaway_strokes(e: Experiment, max_V: float | None = None) -> BreakawayStrokes | None:
    """Strokes whose unseen travel is within ``UNSEEN_RAD``; None where those of one period exceed it.

    max_V  instead of the config's
    Raises ValueError where the config does not tell the motor's speed.

    A stroke of level u and length s moves a shaft of gain K from rest by K (u - f) s at most, whatever its time
    constant, and the stroke back takes that back. What a pair leaves is what friction f (1 +- d) makes of the
    difference, 2 d f K s. The largest travel is that of the pairs so far and of one stroke that lasts longer by the
    device's watchdog time: its last tick comes late, or never, since the host has died. Friction is the worst one of
    0 to max_V, and K (supply - f) the no-load speed.

    The strokes are as long as may be at low levels, up to a length, and shorter at higher ones: no travel farther than
    a given one without friction. Of the lengths up to which, that is taken which moves a motor of half max_V's
    friction and the time constant limits.coast_tau_s farthest. A longer watchdog time leaves more to a busy host, a
    shorter one to the strokes: the longest is taken with which that motor is clearly seen to move, else the shortest.
    """
    if e.motor is None:
        raise ValueError("the config does not say motor.no_load_speed_rad_s")
    max_V = e.breakaway.max_V if max_V is None else max_V
    best: BreakawayStrokes | None = None
    farthest_rad = 0.0
    for watchdog_s in _check_watchdogs_s(e):
        for periods in _lengths(max(int(_LONGEST_STROKE_S / e.period_s + _ROUNDING), 1)):
            strokes = _strokes_up_to(periods, e, max_V, watchdog_s)
            if strokes is None:
                continue
            moved_rad = _moved_rad(e, strokes, max_V)
            if best is None or moved_rad > farthest_rad:
                best, farthest_rad = strokes, moved_rad
        if farthest_rad > _CLEARLY * e.breakaway.motion_rad:
            break
    return best


def _lengths(longest: int) -> Iterator[int]:
    """Lengths to be tried, periods: each, or a fifth apart where they are many."""
    periods = longest
    while periods >= 1:
        yield periods
        periods = min(periods - 1, int(0.8 * periods) if periods > 10 else periods)


def _moved_rad(e: Experiment, strokes: BreakawayStrokes, max_V: float) -> float:
    """What all strokes of one way together move a slow motor of much friction by, about, rad.

    From rest it speeds up evenly by K (u - f) / tau, and slows down by K f / tau after the stroke.
    """
    assert e.motor is not None
    levels = _levels(strokes.pairs, strokes.step_V, max_V)
    driven = sum(
        2.0 * (level - 0.5) * level * stroke_s**2
        for level, stroke_s in zip(levels, strokes.strokes_s, strict=True)
        if level > 0.5
    )
    return 0.5 * e.motor.no_load_speed_rad_s * max_V / e.drive.supply_V / e.limits.coast_tau_s * driven


def _check_watchdogs_s(e: Experiment) -> tuple[float, ...]:
    """Watchdog times to be tried for the breakaway check, s, the longest first.

    A device whose watchdog cannot be set has one time. The host asks each period: less than two would end each check.
    """
    watchdog = backend_of(e).watchdog(e)
    if watchdog.unit_s is None and watchdog.time_s is not None:
        return (watchdog.time_s,)
    unit_s = 0.001 if watchdog.unit_s is None else watchdog.unit_s
    least_s = _LEAST_WATCHDOG_PERIODS * e.period_s
    tried_s = min(max(_CHECK_WATCHDOG_S, least_s), e.daq.watchdog_s)
    times_s: list[float] = []
    while tried_s > least_s * (1.0 - _ROUNDING) or not times_s:
        # whole units of its register: down, where the device would round, or up to the least
        units = max(int(tried_s / unit_s + _ROUNDING), ceil(least_s / unit_s - _ROUNDING))
        if units * unit_s <= e.daq.watchdog_s * (1.0 + _ROUNDING) and units * unit_s not in times_s:
            times_s.append(units * unit_s)
        tried_s -= _SHORTER_S
        if tried_s <= 0.0:
            break
    return tuple(times_s) or (e.daq.watchdog_s,)


def _levels(pairs: int, step_V: float, max_V: float) -> list[float]:
    """Of the pairs, relative to max_V."""
    return [min((k + 1) * step_V / max_V, 1.0) for k in range(pairs)]


def _strokes_up_to(periods: int, e: Experiment, max_V: float, watchdog_s: float) -> BreakawayStrokes | None:
    """Strokes of at most so many periods, shorter at higher levels; None where nothing is within the bound."""
    cycle = max(2 * periods, periods + _LEAST_PAUSE_PERIODS, ceil(_CYCLE_S / e.period_s - _ROUNDING))
    step_V = e.breakaway.ramp_V_s * cycle * e.period_s
    if max_V > _MOST_PAIRS * step_V or min(max_V, step_V) <= 0.0:
        return None  # it would take too long, or there is nothing left of a voltage that is hardly any
    pairs = max(ceil(max_V / step_V - _ROUNDING), 1)
    levels = _levels(pairs, step_V, max_V)

    def shaped_s(top_s: float) -> tuple[float, ...]:
        wanted = (int((top_s / level - watchdog_s) / e.period_s + _ROUNDING) for level in levels)
        return tuple(e.period_s * min(max(n, 1), periods) for n in wanted)

    def strokes(strokes_s: tuple[float, ...]) -> BreakawayStrokes:
        unseen_rad = _unseen_rad(e, max_V, levels, strokes_s, watchdog_s)
        return BreakawayStrokes(strokes_s, (cycle - periods) * e.period_s, step_V, watchdog_s, unseen_rad)

    low, high = 0.0, (periods * e.period_s + watchdog_s) * (1.0 + _ROUNDING)
    longest = strokes(shaped_s(high))
    if longest.unseen_rad <= UNSEEN_RAD:
        return longest
    shortest = strokes(shaped_s(low))
    if not shortest.unseen_rad <= UNSEEN_RAD:
        return None
    for _ in range(_FINEST):
        middle = 0.5 * (low + high)
        tried = strokes(shaped_s(middle))
        if tried.unseen_rad <= UNSEEN_RAD:
            low, shortest = middle, tried
        else:
            high = middle
    return shortest


def _unseen_rad(e: Experiment, max_V: float, levels: list[float], strokes_s: tuple[float, ...], late_s: float) -> float:
    """The largest unseen travel of these strokes, one of which is longer by ``late_s``, for any friction, rad.

    Where that is more than ``UNSEEN_RAD``, what is found first of it.

    levels  of the pairs, relative to max_V
    Lengthened strokes are taken back as well, and beyond ``late_s`` in all the check ends: what they leave is added.
    """
    assert e.motor is not None
    worst_rad = 0.0
    for step in reversed(range(_FRICTION_STEPS)):
        friction = step / _FRICTION_STEPS
        low, high = friction * (1.0 - FRICTION_DIFFERS), friction * (1.0 + FRICTION_DIFFERS)
        top_rad_s = e.motor.no_load_speed_rad_s / max(e.drive.supply_V / max_V - friction, _ROUNDING)
        left_s = 0.0
        for level, stroke_s in zip(levels, strokes_s, strict=True):
            if level <= low:
                continue
            difference = min(level, high) - low
            worst_rad = max(worst_rad, top_rad_s * (left_s + (level - low) * (stroke_s + late_s) + difference * late_s))
            left_s += difference * stroke_s
        if worst_rad > UNSEEN_RAD:
            break
    return worst_rad


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
    periods = 3 if backend_of(e).writes_first(e) else 2
    return (
        (f"{periods} periods", periods * v * e.period_s),
        ("reversing", v * e.limits.coast_tau_s * (1.0 - log(2.0))),
    )
