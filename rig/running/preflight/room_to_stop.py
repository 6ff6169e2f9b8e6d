"""How far the shaft travels until it stops, and the room for it: arithmetic on the config (docs/theory.md 10.2, 13.2).

The guard counts on the same sums: ``guard_settings_of``.

``d`` is the setup of a device, ``e`` an experiment throughout; positions count from 0 rad, the centre of travel.
"""

from __future__ import annotations

import math

from rig.backends.registry import backend_of
from rig.config.schema import DeviceSetup, Experiment
from rig.control.guard import GuardSettings
from rig.control.sweep_plan import COUNTS_1_S, Room, SweepPlan, fastest_loop_1_s, sweep_plan
from rig.core.signals import BenchDelay

_REACTION_PERIODS = 3  # of the loop: one until the next tick, two by which the guard's velocity lags
_VELOCITY_LAG_S = 0.02  # by which it lags at least: half of its window
_ONE_TURN_RAD = 2.0 * math.pi
LONGEST_WATCHDOG_S = 0.5  # that is proposed: a longer silence is no stall of a host that lives
_LEFT_FOR_DELAY_S = 0.02  # of the room, for a drive that acts later than its own tick
_WHOLE_S = 0.01  # proposals are whole multiples
_ROUNDING = 1e-9
_BLOCK_AGE_PERIODS = 2  # of the loop: the rows of a device's block are older than a reply, by its length and its way


def reaction_periods(d: DeviceSetup) -> int:
    """Periods of the loop until it has reacted to a motion of the shaft, at most."""
    return _REACTION_PERIODS + (_BLOCK_AGE_PERIODS if d.runs_relay else 0) + (1 if backend_of(d).writes_first(d) else 0)


def reaction_s(d: DeviceSetup) -> float:
    """Time until the loop has reacted to a motion of the shaft, s, at most."""
    periods_s = reaction_periods(d) * d.period_s
    return periods_s + _further_lag_s(d) + backend_of(d).reply_delay_s(d)


def _further_lag_s(d: DeviceSetup) -> float:
    """Lag of the guard's velocity beyond two periods, s; not 0 where the period is short."""
    return max(_VELOCITY_LAG_S - 2.0 * d.period_s, 0.0)


def known_reaction_s(d: DeviceSetup) -> float:
    """``reaction_s`` plus one lost reply plus the device's watchdog, where it has one, s."""
    own = backend_of(d)
    return reaction_s(d) + own.lost_reply_s(d) + (own.watchdog(d).time_s or 0.0)


def limits_are_ordered(d: DeviceSetup) -> bool:
    """Whether the hard limits are outside the soft ones, and 0 rad within both; or there are none."""
    if d.limits.is_endless:
        return True
    (soft_low, soft_high), (hard_low, hard_high) = d.limits.soft_rad, d.limits.hard_rad
    return hard_low < soft_low < 0.0 < soft_high < hard_high


def room_rad(d: DeviceSetup) -> float:
    """Distance from the centre of travel, about which the relay oscillates, to the nearer hard limit, rad."""
    return min(d.limits.hard_rad[1], -d.limits.hard_rad[0])


def reach_rad(d: DeviceSetup) -> float:
    """Distance from the centre of travel to the nearer soft limit, rad."""
    return min(-d.limits.soft_rad[0], d.limits.soft_rad[1])


def swing_rad(d: DeviceSetup) -> float:
    """How far from the centre of travel a test may swing, rad: to the nearer soft limit; without limits, one turn."""
    return _ONE_TURN_RAD if d.limits.is_endless else reach_rad(d)


def stopping_terms(d: DeviceSetup) -> tuple[tuple[str, float], ...]:
    """How far the shaft travels from the largest speed if the host dies, term by term: words, rad.

    A device without a watchdog then holds its last drive, and nothing bounds the travel. In that case the sum holds
    while the host lives, and ``stopping_sum`` says so.

    Coasting is at 0 V with the terminals shorted, and friction does not help: speed times time constant. Every term
    takes the largest speed, because the guard ends anything faster while the host lives. One part is not in the sum:
    what the drive adds between the host's death and the device's watchdog. It depends on K and tau, which are not known
    yet. The device's own hard limit ends such a drive.
    """
    v = d.limits.max_speed_rad_s
    lag_s, adapter_s = _further_lag_s(d), backend_of(d).reply_delay_s(d)
    watchdog_s, lost_s = backend_of(d).watchdog(d).time_s, backend_of(d).lost_reply_s(d)
    return (
        (f"{reaction_periods(d)} periods", v * reaction_periods(d) * d.period_s),
        *((("velocity window", v * lag_s),) if lag_s > 0.0 else ()),
        *((("USB adapter", v * adapter_s),) if adapter_s > 0.0 else ()),
        ("reply time-out" if lost_s == d.daq.timeout_s else "lost reply", v * lost_s),
        *((("watchdog", v * watchdog_s),) if watchdog_s is not None else ()),
        ("coasting", v * d.limits.coast_tau_s),
    )


def stopping_rad(d: DeviceSetup) -> float:
    """What ``stopping_terms`` add up to, rad."""
    return sum(rad for _, rad in stopping_terms(d))


def counted_delay_s(d: DeviceSetup, delay: BenchDelay) -> float:
    """The part of a bench's delay that ``stopping_terms`` leave out, s, at most: what is beyond a drive's own tick.

    In order write_first a drive's own tick is the next one.
    """
    return _waiting_s(d, delay) + delay.shown_s[2]


def expected_delay_s(d: DeviceSetup, delay: BenchDelay) -> float:
    """As ``counted_delay_s``, but the most likely, s."""
    return _waiting_s(d, delay) + delay.shown_s[1]


def _waiting_s(d: DeviceSetup, delay: BenchDelay) -> float:
    own_s = d.period_s * (2.0 if backend_of(d).writes_first(d) else 1.0)
    return max(delay.reported_s - own_s, 0.0)


def room_for_delay_s(e: Experiment) -> float:
    """Longest delay beyond a drive's own tick with which the shaft stops in time, s; negative without room to stop.

    It stops from the largest speed at the centre of travel. In a limit cycle of the wanted size the guard does not
    brake.
    """
    d = e.device
    v, target = e.limits.max_speed_rad_s, e.relay.target
    distance = stopping_rad(d)
    room_s = (room_rad(d) - distance) / v
    if target is None:
        return room_s
    amplitude_rad = target.amplitude_rad * max(1.0, e.relay.second_ratio) * (1.0 + target.tolerance)
    # the stop that the guard predicts grows from A to 2 A as r does from 0 to T/4, then by 8 A/T
    share = room_rad(d) / amplitude_rad
    longest = 0.25 * target.period_s * (math.sqrt(max(share - 1.0, 0.0)) if share < 2.0 else 0.5 * share)
    return min(room_s, longest - distance / v)


def longest_watchdog_s(e: Experiment) -> float | None:
    """The longest watchdog time, up to ``LONGEST_WATCHDOG_S``, for which there is room to stop, s.

    It leaves 20 ms of the room to a bench that acts late. None where arming sets no such time, or no room is left. A
    config may take more: ``room_for_delay_s`` is what is left then.
    """
    watchdog = backend_of(e.device).watchdog(e.device)
    if watchdog.unit_s is None or watchdog.time_s is None:
        return None
    room_s = math.inf if e.limits.is_endless else watchdog.time_s + room_for_delay_s(e) - _LEFT_FOR_DELAY_S
    whole_s = math.ceil(_WHOLE_S / watchdog.unit_s - _ROUNDING) * watchdog.unit_s  # of the device's own unit, too
    wholes = math.floor(min(room_s, LONGEST_WATCHDOG_S) / whole_s + _ROUNDING)
    return round(wholes * whole_s, 6) if wholes > 0 else None


def watchdog_words(e: Experiment) -> str:
    """The watchdog's time, what it leaves room for, and the longest that would fit; "" where arming sets none."""
    longest_s, watchdog_s = longest_watchdog_s(e), e.daq.watchdog_s
    if longest_s is None:
        return ""
    if backend_of(e.device).in_virtual_time(e.device):
        return f"watchdog: {1e3 * watchdog_s:g} ms; there is room for it, and in virtual time no host stands still"
    told = f"watchdog: the host may stand still for {1e3 * watchdog_s:g} ms: a shorter gap is no fault"
    if watchdog_s > longest_s * (1.0 + _ROUNDING):
        left_ms, wanted_ms = 1e3 * max(room_for_delay_s(e), 0.0), 1e3 * _LEFT_FOR_DELAY_S
        return (
            f"{told}. Beside it the limits have room for a drive that acts up to {left_ms:.0f} ms late; with "
            f"daq.watchdog_s {longest_s:g} it may be {wanted_ms:.0f} ms"
        )
    if watchdog_s >= longest_s * (1.0 - _ROUNDING):
        return told
    longer = e.model_copy(update={"daq": e.daq.model_copy(update={"watchdog_s": longest_s})})
    room = "" if e.limits.is_endless else f": {stopping_sum(longer.device)}, of {room_rad(e.device):.3f} rad"
    return f"{told}. If it stands still for longer: there is room for daq.watchdog_s {longest_s:g}{room}"


def stopping_sum(d: DeviceSetup) -> str:
    """``stopping_terms`` and what they add up to, for people."""
    terms = stopping_terms(d)
    written = " + ".join(f"{rad:.3f} ({words})" for words, rad in terms)
    total = f"at {d.limits.max_speed_rad_s:g} rad/s: {written} = {stopping_rad(d):.3f} rad"
    watchdog = backend_of(d).watchdog(d)
    if watchdog.time_s is None:
        return f"{total} while the host lives; if the host dies nothing bounds it: the device has no watchdog"
    if not watchdog.certain and d.daq.accept_no_watchdog:
        return f"{total} if the plug-in driver's device has a watchdog; without one nothing bounds it if the host dies"
    return total


def peak_speed_rad_s(amplitude_rad: float, period_s: float) -> float:
    """Largest speed of a limit cycle, rad/s: that of two parabolas, a little above the true one."""
    return 8.0 * amplitude_rad / period_s


def predicted_stop_rad(d: DeviceSetup, amplitude_rad: float, period_s: float) -> float:
    """Farthest stopping position that the guard predicts within a cycle, rad.

    A cycle of constant accelerations, y = A (1 - s^2) with v = 8 A s/T at s = 0..1 from its top, is faster than the
    motor's; its largest y + v r is A (1 + (4 r/T)^2) within the arc, else 8 A r/T at the centre.
    """
    r = stopping_rad(d) / d.limits.max_speed_rad_s
    s = 4.0 * r / period_s
    return amplitude_rad * (1.0 + s * s if s < 1.0 else 2.0 * s)


def overshoot_terms(d: DeviceSetup) -> tuple[tuple[str, float], ...]:
    """How far the shaft overshoots the hysteresis, at most, term by term: words, rad.

    From a speed v reached under drive d, -d stops the shaft within v tau (1 - ln 2); friction stops it sooner.
    """
    v = d.limits.max_speed_rad_s
    periods = 3 if backend_of(d).writes_first(d) else 2
    return (
        (f"{periods} periods", periods * v * d.period_s),
        ("reversing", v * d.limits.coast_tau_s * (1.0 - math.log(2.0))),
    )


def survey_room(e: Experiment, slowest_rad_s: float, bandwidth_1_s: float) -> Room:
    """What there is for the sweeps, with a sensor that resolves this speed and a loop of this bandwidth."""
    ends = zip(e.limits.soft_rad, e.limits.hard_rad, strict=True)
    # at a soft limit, at this speed, the guard would just not brake yet
    horizon_s = stopping_rad(e.device) / e.limits.max_speed_rad_s
    by_stopping_rad_s = min(abs(hard - soft) for soft, hard in ends) / horizon_s
    return Room(
        e.limits.soft_rad,
        min(e.limits.max_speed_rad_s, by_stopping_rad_s),
        slowest_rad_s,
        bandwidth_1_s,
        e.survey.longest_s,
    )


def expected_sweeps(e: Experiment) -> SweepPlan:
    """The sweeps on a bench without noise and with the least latency. Raises TooShortError if there is no room."""
    least_s = (1.5 if backend_of(e.device).writes_first(e.device) else 0.5) * e.period_s
    return sweep_plan(
        survey_room(e, COUNTS_1_S * e.sensor.curve.lsb_rad, fastest_loop_1_s(least_s)), e.survey.speeds_rad_s or ()
    )


def guard_settings_of(e: Experiment, noise_rad: float | None = None, delay: BenchDelay | None = None) -> GuardSettings:
    """The guard's knowledge; ``noise_rad`` and ``delay`` once they were measured.

    Before that two LSB are assumed, and a drive that acts within its own tick.
    """
    d = e.device
    lsb_rad = e.sensor.curve.lsb_rad
    t = e.limits
    return GuardSettings(
        limits=d.arming,
        rail_counts=e.sensor.rails,
        max_speed_rad_s=t.max_speed_rad_s,
        coast_tau_s=t.coast_tau_s,
        noise_rad=2.0 * lsb_rad if noise_rad is None else max(noise_rad, lsb_rad),
        motion_rad=e.breakaway.motion_rad,
        delay_s=0.0 if delay is None else counted_delay_s(d, delay),
        reaction_s=known_reaction_s(d),  # as in `rig check`
        free_rad_s=0.0 if e.motor is None else e.motor.no_load_speed_rad_s * e.drive.max_V / e.drive.supply_V,
    )
