"""The strokes of the breakaway check, short enough that a shaft which the sensor does not show hardly turns.

Arithmetic on the config (docs/theory.md 10.1). ``e`` is the experiment throughout.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from math import ceil

from rig.backends.registry import backend_of
from rig.config.schema import DeviceSetup, Experiment
from rig.control.breakaway import StrokePlan

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
_MOST_FURTHER = 20  # pairs at max_V that nothing need have shown between
_FEW_LEVELS = 100  # more take too long to search through
_MOST_IN_ALL = 30  # further pairs: the longest check that was seen took 45 s
_FEW_FURTHER = 4  # where the reference motor clearly moves without
_REPEATS = range(17)  # numbers of planned pairs at max_V to try, beside the first one there
_TOP_PAUSE_S = 0.5  # after each stroke of a pair that repeats max_V: their means are less noisy
_FRICTION_STEPS = 24  # frictions at which the bound is computed
_FINEST = 12  # halvings
_LARGER = 1.05  # from one max_V to try to the next
_ROUNDING = 1e-9


def breakaway_strokes(e: Experiment, max_V: float | None = None) -> StrokePlan | None:
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

    Where it does not clearly move further pairs may follow. If the strokes at max_V have one period only the bench is
    fast, and max_V is little above friction. Then planned pairs repeat max_V within the same bound, with longer pauses
    for the noise, at the cost of shorter strokes at lower levels; that choice is for a motor with three quarters of
    max_V as its friction.
    """
    if e.motor is None:
        raise ValueError("the config does not say motor.no_load_speed_rad_s")
    max_V = e.breakaway.max_V if max_V is None else max_V
    best: StrokePlan | None = None
    tried: list[StrokePlan] = []
    longest = max(int(_LONGEST_STROKE_S / e.period_s + _ROUNDING), 1)
    for watchdog_s in _check_watchdogs_s(e.device):
        found = [_strokes_up_to(periods, e, max_V, watchdog_s) for periods in _lengths(longest)]
        tried += (strokes for strokes in found if strokes is not None)
        best = max(tried, key=lambda one: _moved_rad(e, one, max_V), default=None)
        if best is not None and _moved_rad(e, best, max_V) > _CLEARLY * e.breakaway.motion_rad:
            few = min(_further(e, best, max_V), _FEW_FURTHER)
            return best._replace(further=few, in_all=few)
    if best is None:
        return None
    if best.strokes_s[-1] > 1.5 * e.period_s:
        best = max(tried, key=lambda one: _moved_rad(e, one, max_V, beyond_noise=True))
        pairs = _further(e, best, max_V)
        return best._replace(further=pairs, in_all=pairs)
    tried += (
        strokes
        for periods, more in product(_lengths(longest), _REPEATS[1:] if best.pairs <= _FEW_LEVELS else ())
        if (strokes := _strokes_up_to(periods, e, max_V, _check_watchdogs_s(e.device)[-1], more)) is not None
    )
    tried = [one._replace(top_pause_s=max(_TOP_PAUSE_S, one.pause_s)) for one in tried]
    best = max(tried, key=lambda one: _moved_rad(e, one, max_V, friction=0.75, beyond_noise=True))
    pairs = _further(e, best, max_V)
    return best._replace(further=pairs, in_all=_MOST_IN_ALL if pairs else 0)


def has_strokes(e: Experiment, max_V: float) -> bool:
    """Whether ``breakaway_strokes`` finds some, without choosing among them."""
    longest = max(int(_LONGEST_STROKE_S / e.period_s + _ROUNDING), 1)
    return any(
        _strokes_up_to(periods, e, max_V, watchdog_s) is not None
        for watchdog_s, periods in product(_check_watchdogs_s(e.device), _lengths(longest))
    )


def fitting_max_V(e: Experiment, least_V: float) -> float:
    """breakaway.max_V of a new config, V: its own, or less where that turns a fast shaft too far, ``least_V`` at least.

    More, up to drive.max_V, where the longest strokes hardly move a slow one.
    """
    max_V = e.breakaway.max_V
    while max_V > least_V and not has_strokes(e, max_V):
        max_V = max(max_V / _LARGER, least_V)
    while max_V < e.drive.max_V and (strokes := breakaway_strokes(e, max_V)) is not None:
        if (
            _moved_rad(e, strokes, max_V) > _CLEARLY * e.breakaway.motion_rad
            or strokes.strokes_s[-1] < _LONGEST_STROKE_S - 0.5 * e.period_s
        ):
            break
        max_V = min(max_V * _LARGER, e.drive.max_V)
    return round(max_V - 0.005, 2) if max_V < e.breakaway.max_V else round(max_V, 2)


def _further(e: Experiment, strokes: StrokePlan, max_V: float) -> int:
    """How many pairs at max_V are within the bound by themselves."""
    for pairs in range(1, _MOST_FURTHER + 1):
        strokes_s = pairs * strokes.strokes_s[-1:]
        if _unseen_rad(*_sheet(e.device), max_V, (1.0,) * pairs, strokes_s, strokes.watchdog_s) > UNSEEN_RAD:
            return pairs - 1
    return _MOST_FURTHER


def _lengths(longest: int) -> Iterator[int]:
    """Lengths to try, periods: each one, or steps of a fifth where they are many."""
    periods = longest
    while periods >= 1:
        yield periods
        periods = min(periods - 1, int(0.8 * periods) if periods > 10 else periods)


def _moved_rad(
    e: Experiment, strokes: StrokePlan, max_V: float, *, friction: float = 0.5, beyond_noise: bool = False
) -> float:
    """Rough travel of a slow reference motor by all strokes of one way, rad.

    From rest it speeds up evenly by K (u - f) / tau, and slows down by K f / tau after the stroke.

    friction      of the motor, as a share of max_V
    beyond_noise  less what the check takes off each stroke for a noise of a sixth of breakaway.motion_rad
    """
    assert e.motor is not None
    first_at_top = strokes.levels(max_V)
    levels = _levels(strokes.pairs, strokes.step_V, max_V)
    driven_rad_s2 = 0.5 / friction * e.motor.no_load_speed_rad_s * max_V / e.drive.supply_V / e.limits.coast_tau_s
    noise_rad = e.breakaway.motion_rad / 6.0

    def off_rad(pair: int) -> float:
        pause_s = strokes.pause_s if pair < first_at_top else strokes.top_pause_s
        samples = max(2.0 * pause_s / e.period_s / 3.0, 1.0)  # that the check takes the mean of
        return 12.0 * noise_rad**2 / samples / e.breakaway.motion_rad if beyond_noise else 0.0

    return sum(
        max(driven_rad_s2 * (level - friction) * level * stroke_s**2 - off_rad(pair), 0.0)
        for pair, (level, stroke_s) in enumerate(zip(levels, strokes.strokes_s, strict=True))
        if level > friction
    )


def _check_watchdogs_s(d: DeviceSetup) -> tuple[float, ...]:
    """Watchdog times to try for the breakaway check, s, the longest first.

    A device whose watchdog cannot be set has one time. The host asks each period: less than two would end each check.
    """
    watchdog = backend_of(d).watchdog(d)
    if watchdog.unit_s is None and watchdog.time_s is not None:
        return (watchdog.time_s,)
    unit_s = 0.001 if watchdog.unit_s is None else watchdog.unit_s
    least_s = _LEAST_WATCHDOG_PERIODS * d.period_s
    tried_s = min(max(_CHECK_WATCHDOG_S, least_s), d.daq.watchdog_s)
    times_s: list[float] = []
    while tried_s > least_s * (1.0 - _ROUNDING) or not times_s:
        # whole units of its register: down, where the device would round, or up to the least
        units = max(int(tried_s / unit_s + _ROUNDING), ceil(least_s / unit_s - _ROUNDING))
        if units * unit_s <= d.daq.watchdog_s * (1.0 + _ROUNDING) and units * unit_s not in times_s:
            times_s.append(units * unit_s)
        tried_s -= _SHORTER_S
        if tried_s <= 0.0:
            break
    return tuple(times_s) or (d.daq.watchdog_s,)


def _levels(pairs: int, step_V: float, max_V: float) -> list[float]:
    """Levels of the pairs, relative to max_V."""
    return [min((k + 1) * step_V / max_V, 1.0) for k in range(pairs)]


def _strokes_up_to(periods: int, e: Experiment, max_V: float, watchdog_s: float, repeats: int = 0) -> StrokePlan | None:
    """Strokes of at most so many periods, shorter at higher levels; None where nothing is within the bound.

    repeats  further planned pairs at max_V
    """
    cycle = max(2 * periods, periods + _LEAST_PAUSE_PERIODS, ceil(_CYCLE_S / e.period_s - _ROUNDING))
    step_V = e.breakaway.ramp_V_s * cycle * e.period_s
    if max_V > _MOST_PAIRS * step_V or min(max_V, step_V) <= 0.0:
        return None  # it would take too long, or the voltage is too small to divide
    pairs = max(ceil(max_V / step_V - _ROUNDING), 1) + repeats
    levels = _levels(pairs, step_V, max_V)

    def shaped_s(top_s: float) -> tuple[float, ...]:
        wanted = (int((top_s / level - watchdog_s) / e.period_s + _ROUNDING) for level in levels)
        return tuple(e.period_s * min(max(n, 1), periods) for n in wanted)

    def strokes(strokes_s: tuple[float, ...]) -> StrokePlan:
        unseen_rad = _unseen_rad(*_sheet(e.device), max_V, tuple(levels), strokes_s, watchdog_s)
        pause_s = (cycle - periods) * e.period_s
        return StrokePlan(strokes_s, pause_s, pause_s, step_V, watchdog_s, unseen_rad)

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


def _sheet(d: DeviceSetup) -> tuple[float, float]:
    """No-load speed, rad/s, and the supply that it is of, V."""
    assert d.motor is not None
    return d.motor.no_load_speed_rad_s, d.drive.supply_V


@lru_cache(maxsize=10_000)  # one command asks for the strokes of its config again and again
def _unseen_rad(
    no_load_rad_s: float,
    supply_V: float,
    max_V: float,
    levels: tuple[float, ...],
    strokes_s: tuple[float, ...],
    late_s: float,
) -> float:
    """The largest unseen travel of these strokes, one of which is longer by ``late_s``, for any friction, rad.

    Returns the first value above ``UNSEEN_RAD`` where there is one.

    levels  of the pairs, relative to max_V
    Lengthened strokes are reversed too, and the check ends when they add up to ``late_s``: what they leave is added.
    """
    worst_rad = 0.0
    for step in reversed(range(_FRICTION_STEPS)):
        friction = step / _FRICTION_STEPS
        low, high = friction * (1.0 - FRICTION_DIFFERS), friction * (1.0 + FRICTION_DIFFERS)
        top_rad_s = no_load_rad_s / max(supply_V / max_V - friction, _ROUNDING)
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
