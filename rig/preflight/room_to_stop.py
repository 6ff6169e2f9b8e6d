"""How far the shaft travels until it stops, and the room for it: arithmetic on the config (docs/theory.md 10.1, 10.2).

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
    """Periods of the loop until it has reacted to a motion of the shaft, at most."""
    return (
        _REACTION_PERIODS
        + (_BLOCK_AGE_PERIODS if experiment.relay.where == "device" else 0)
        + (1 if backend_of(experiment).writes_first(experiment) else 0)
    )


def reaction_s(experiment: Experiment) -> float:
    """Time until the loop has reacted to a motion of the shaft, s, at most."""
    periods_s = reaction_periods(experiment) * experiment.period_s
    return periods_s + _further_lag_s(experiment) + backend_of(experiment).reply_delay_s(experiment)


def _further_lag_s(e: Experiment) -> float:
    """Lag of the guard's velocity beyond two periods, s; not 0 where the period is short."""
    return max(_VELOCITY_LAG_S - 2.0 * e.period_s, 0.0)


def device_watchdog_s(experiment: Experiment) -> float | None:
    """Silence of the host after which the device drives 0 V, s; None where it has no watchdog.

    If only the device can say whether it has one: the time that it would be armed with.
    """
    return backend_of(experiment).watchdog(experiment).time_s


def known_reaction_s(experiment: Experiment) -> float:
    """``reaction_s`` plus one lost reply plus the device's watchdog, where it has one, s."""
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
    """How far the shaft travels from the largest speed if the host dies, term by term: words, rad.

    A device without a watchdog then holds its last drive, and nothing bounds the travel. In that case the sum holds
    while the host lives, and ``stopping_sum`` says so.

    Coasting is at 0 V with the terminals shorted, and friction does not help: speed times time constant. Every term
    takes the largest speed, because the guard ends anything faster while the host lives. One part is not in the sum:
    what the drive adds between the host's death and the device's watchdog. It depends on K and tau, which are not known
    yet. The device's own hard limit ends such a drive.
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
    written = " + ".join(f"{rad:.3f} ({words})" for words, rad in terms)
    total = f"at {e.limits.max_speed_rad_s:g} rad/s: {written} = {sum(rad for _, rad in terms):.3f} rad"
    if device_watchdog_s(e) is None:
        return f"{total} while the host lives; if the host dies nothing bounds it: the device has no watchdog"
    if not backend_of(e).watchdog(e).certain and e.daq.accept_no_watchdog:
        return f"{total} if the plug-in driver's device has a watchdog; without one nothing bounds it if the host dies"
    return total


UNSEEN_RAD = 0.5  # farthest that a shaft may turn in the breakaway check while the sensor does not show it
FRICTION_DIFFERS = 0.1  # friction of one way differs from the mean of both ways by this share of it, at most
_LONGEST_STROKE_S = 0.08
_CYCLE_S = 0.16  # the longest stroke and the pause after it: averages the noise, and keeps the pairs few
_LEAST_PAUSE_PERIODS = 4
_MOST_PAIRS = 1_000
_CHECK_WATCHDOG_S = 0.04  # of the device in the breakaway check, unless that is less than two periods
_SHORTER_S = 0.005  # step to the next shorter watchdog time to try, where no stroke is short enough
_LEAST_WATCHDOG_PERIODS = 2
_CLEARLY = 2.0  # times breakaway.motion_rad
_FRICTION_STEPS = 24  # frictions at which the bound is computed
_FINEST = 12  # halvings
_ROUNDING = 1e-9


class BreakawayStrokes(NamedTuple):
    """The strokes of the breakaway check.

    strokes_s   lengths, whole periods: that of each pair, the weakest first
    pause_s     after each, whole periods
    step_V      by how much the level rises from pair to pair
    watchdog_s  watchdog time of the device in the check; where the device has none, or one that arming does not set,
                the longest delay of a tick that the bound allows
    unseen_rad  farthest that the shaft turns in the check if the sensor shows nothing
    """

    strokes_s: tuple[float, ...]
    pause_s: float
    step_V: float
    watchdog_s: float
    unseen_rad: float

    @property
    def pairs(self) -> int:
        """Number of pairs until breakaway.max_V."""
        return len(self.strokes_s)


def breakaway_strokes(e: Experiment, max_V: float | None = None) -> BreakawayStrokes | None:
    """Strokes whose unseen travel is within ``UNSEEN_RAD``; None where those of one period exceed it.

    max_V  instead of the config's
    Raises ValueError where the config does not tell the motor's speed.

    A stroke of level u and length s moves a shaft of gain K from rest by at most K (u - f) s, whatever its time
    constant. The stroke back reverses that. A pair leaves only what friction f (1 +- d) differs by: 2 d f K s. The
    largest travel is the sum over the pairs so far, plus one stroke that lasts longer by the device's watchdog time:
    its last tick comes late, or never because the host has died. The bound takes the worst friction from 0 to max_V,
    and K (supply - f) as the no-load speed.

    The strokes at low levels all have one length, the longest. At higher levels they are shorter: without friction none
    travels farther than a given distance. Of the possible longest strokes, the function takes the one that moves a
    reference motor farthest: friction half of max_V, time constant limits.coast_tau_s. A longer watchdog time tolerates
    a busier host; a shorter one allows longer strokes. The function takes the longest watchdog time with which the
    reference motor clearly moves, else the shortest.
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
    """Lengths to try, periods: each one, or steps of a fifth where they are many."""
    periods = longest
    while periods >= 1:
        yield periods
        periods = min(periods - 1, int(0.8 * periods) if periods > 10 else periods)


def _moved_rad(e: Experiment, strokes: BreakawayStrokes, max_V: float) -> float:
    """Rough travel of the slow reference motor by all strokes of one way, rad.

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
    """Watchdog times to try for the breakaway check, s, the longest first.

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
    """Levels of the pairs, relative to max_V."""
    return [min((k + 1) * step_V / max_V, 1.0) for k in range(pairs)]


def _strokes_up_to(periods: int, e: Experiment, max_V: float, watchdog_s: float) -> BreakawayStrokes | None:
    """Strokes of at most so many periods, shorter at higher levels; None where nothing is within the bound."""
    cycle = max(2 * periods, periods + _LEAST_PAUSE_PERIODS, ceil(_CYCLE_S / e.period_s - _ROUNDING))
    step_V = e.breakaway.ramp_V_s * cycle * e.period_s
    if max_V > _MOST_PAIRS * step_V or min(max_V, step_V) <= 0.0:
        return None  # it would take too long, or the voltage is too small to divide
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

    Returns the first value above ``UNSEEN_RAD`` where there is one.

    levels  of the pairs, relative to max_V
    Lengthened strokes are reversed too, and the check ends when they add up to ``late_s``: what they leave is added.
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
    """Largest speed of a limit cycle, rad/s: that of two parabolas, a little above the true one."""
    return 8.0 * amplitude_rad / period_s


def predicted_stop_rad(e: Experiment, amplitude_rad: float, period_s: float) -> float:
    """Farthest stopping position that the guard predicts within a cycle, rad.

    A cycle of constant accelerations, y = A (1 - s^2) with v = 8 A s/T at s = 0..1 from its top, is faster than the
    motor's; its largest y + v r is A (1 + (4 r/T)^2) within the arc, else 8 A r/T at the centre.
    """
    r = sum(rad for _, rad in stopping_terms(e)) / e.limits.max_speed_rad_s
    s = 4.0 * r / period_s
    return amplitude_rad * (1.0 + s * s if s < 1.0 else 2.0 * s)


def overshoot_terms(e: Experiment) -> tuple[tuple[str, float], ...]:
    """How far the shaft overshoots the hysteresis, at most, term by term: words, rad.

    From a speed v reached under drive d, -d stops the shaft within v tau (1 - ln 2); friction stops it sooner.
    """
    v = e.limits.max_speed_rad_s
    periods = 3 if backend_of(e).writes_first(e) else 2
    return (
        (f"{periods} periods", periods * v * e.period_s),
        ("reversing", v * e.limits.coast_tau_s * (1.0 - log(2.0))),
    )
