"""What no manual says of a servo, tried on it: with a free horn, small duties, and its registers put back.

How old a position is shows only together with how late a duty acts. What a Feetech's EEPROM holds is changed behind its
lock: it forgets that with its supply. A Dynamixel's protection is not tried: it would have to be overloaded.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rig.backends.servo.before import BeforeStore, put_back
from rig.backends.servo.bus import ServoLink
from rig.backends.servo.guardian import Guardian, beat
from rig.backends.servo.opening import ServoSetup, leave_no_trace, look, set_to_0, set_up, switch_on
from rig.core.faults import Fault
from rig.core.signals import percent

_STILL_STEPS: Final = 3  # of the drive: far below what breaks a shaft away
_TURNS_SHARE: Final = 0.12  # of full duty, under which a free horn turns
_TURNS_S: Final = 0.3
_SILENT_S: Final = 0.12  # six units of the watchdog
_ACTS_S: Final = 0.05
_TRIES: Final = 20
_STOPS_S: Final = 0.5
_LOOK_S: Final = 0.004
_ABSENT: Final = 251  # an id that hardly any servo has
_FELL_TO: Final = 0.37  # of the speed
_HOT_degC: Final = 50
_P_MOST_STEPS, _P_GOALS = 8, 8  # the most duty that the loop may give; goals on each side
_P_GAIN_COUNTS: Final = {"dynamixel": (16, 8), "feetech": (2, 4)}  # the loop's P, and counts from goal to goal
_STARTS, _START_S = 6, 0.12  # of the horn from rest, and how long each is watched
_OVERLOAD_STEPS: Final = 12  # of a Feetech: a duty above 1 %, and below what breaks it away
_OVERLOAD: Final = {"protective_torque": 0, "protection_time": 10, "overload_torque": 1}  # 0 %, 0.1 s, 1 %
_DUTIES: Final = range(5, 65, 5)  # steps of a Feetech, of which "50 to 1000" drive

Floats = NDArray[np.float64]
Powered = Callable[[], None]  # asks a person to cut the supply for a second; returns when it is back


@dataclass(frozen=True)
class Fact:
    """One of them: its name, what was found, and that in words."""

    name: str
    found: bool | float | str | None
    words: str


def setup_for(link: ServoLink) -> ServoSetup:
    """The setup of a servo that has no config: as it tells of itself. Raises Fault LINK_*."""
    model = link.model
    supply_V = link.value(model.roles["voltage"]) * model.role("voltage").scale
    most = round(2.0 * _TURNS_SHARE * model.full_drive)
    return ServoSetup(model, link.bus.id, True, False, _HOT_degC, supply_V, 2048, most, 0.06)


def facts(
    link: ServoLink,
    store: BeforeStore,
    powered: Powered | None = None,
    guardian: Callable[[ServoLink, BeforeStore], Guardian] | None = None,
) -> Generator[Fact, None, None]:
    """Try them one after the other; the registers are put back at the end, whatever happens.

    powered   None: what needs the supply cut is left out
    guardian  starts who stops the servo if this process dies; None: in virtual time nobody does
    Raises Fault as an opening does, and LINK_*.
    """
    setup = setup_for(link)
    look(link, setup, leave_no_trace(link, setup, store).others)
    watching: list[Guardian] = []

    def watched() -> None:
        if guardian is not None:
            watching.append(guardian(link, store))

    restored = False
    try:
        further = {link.model.roles["mode"]: link.model.position_mode}
        if link.model.protocol == "feetech":
            further |= {link.model.roles["max_drive"]: _P_MOST_STEPS, "position_p_gain": _P_GAIN_COUNTS["feetech"][0]}
            further |= _OVERLOAD
        opened = set_up(link, setup, store, watched, further)
        if "watchdog" in link.model.roles:
            yield Fact(
                "watchdog_stops",
                opened.has_watchdog,
                "the watchdog takes the duty away" if opened.has_watchdog else "; ".join(opened.remarks[1:]),
            )
            yield _fed_by(link)
            yield _resumes(link)
        yield _delay(link)
        watcher = watching[0] if watching else None
        yield _moves(link, watcher)
        yield from _stops(link, watcher, has_watchdog=opened.has_watchdog)
        yield _p_scale(link)
        if link.model.protocol == "feetech":
            link.hold(link.model.roles["max_drive"], setup.max_units)
            link.hold(link.model.roles["mode"], link.model.pwm_mode)
            least = _least_duty(link, watcher)
            yield least
            if powered is not None:
                yield _protects(link, max(_OVERLOAD_STEPS, int(least.found or 0)), watcher)
                yield _keeps_mode(link, powered)
    finally:
        try:
            put_back(link, store)
            restored = True
        finally:
            for one in watching:
                one.end(restored=restored)


def _still(link: ServoLink, duty: int, guardian: Guardian | None = None) -> None:
    """Torque on with duty 0, then this one; heard by the keeper where the duty may turn the horn."""
    set_to_0(link)
    switch_on(link, lambda: _lives(link, guardian, 0.0))  # last: what the keeper has just switched off stays off
    _drive(link, duty)
    _lives(link, guardian, _ACTS_S)


def _drive(link: ServoLink, duty: int) -> float:
    """A duty, only to a servo whose torque is on: one that has restarted it may switch on, in a mode of its own.

    Returns the time right before its packet, s. Raises Fault DEVICE_RESET.
    """
    roles, asked_s = link.model.roles, math.nan

    def write(one: ServoLink) -> None:
        nonlocal asked_s
        if one.value(roles["torque"]) != 1:
            raise Fault("DEVICE_RESET", f"{link.model.role('torque')} is off: it has restarted")
        asked_s = one.now_s()
        one.put(roles["drive"], duty)

    link.in_one_go(write)
    return asked_s


def _off(link: ServoLink, guardian: Guardian | None = None) -> None:
    """Torque off before a watchdog is cleared: the old goal might act again. Then the keeper need not hear rig.

    No duty to one with a lock: it may have lost its mode, and in another one that may switch its torque on.
    """
    roles = link.model.roles
    link.put(roles["torque"], 0)
    if "watchdog" in roles:
        link.put(roles["watchdog"], 0)
        link.put(roles["drive"], 0)
    if guardian is not None:
        guardian.rest()


def _fed_by(link: ServoLink) -> Fact:
    """Whether packets for others feed the watchdog."""
    roles = link.model.roles
    _still(link, _STILL_STEPS)
    try:
        link.put(roles["watchdog"], 1)
        pings = round(_SILENT_S / 0.005)
        for _ in range(pings):
            link.is_there(_ABSENT)
        fed = link.value(roles["watchdog"]) != -1
    finally:
        _off(link)
    words = "any packet on the bus feeds the watchdog" if fed else "only packets for this servo feed the watchdog"
    return Fact("watchdog_fed_by", "any" if fed else "own", words)


def _resumes(link: ServoLink) -> Fact:
    """Whether the old goal acts again once a watchdog that has acted is cleared. The duty is too small to turn it."""
    roles = link.model.roles
    _still(link, _STILL_STEPS)
    try:
        link.put(roles["watchdog"], 1)
        link.client.wait(_SILENT_S)
        link.put(roles["watchdog"], 0)
        link.client.wait(_ACTS_S)
        again = link.value(roles["applied"]) != 0
    finally:
        _off(link)
    words = "the old goal acts again once it is cleared" if again else "the old goal does not act again"
    return Fact("watchdog_resumes", again, words)


def _delay(link: ServoLink) -> Fact:
    """From a duty's packet to the reading that tells it, in the middle of some, s; the reading's own way is in it."""
    roles, found_s = link.model.roles, []
    now_s = link.now_s
    _still(link, 0)
    try:
        for number in range(_TRIES):
            duty = _STILL_STEPS if number % 2 == 0 else -_STILL_STEPS
            began_s = _drive(link, duty)
            while link.value(roles["applied"]) != duty and now_s() - began_s < _ACTS_S:
                pass
            found_s.append(now_s() - began_s)
    finally:
        _off(link)
    middle_s = statistics.median(found_s)
    return Fact("duty_told_after_s", round(middle_s, 6), f"a duty is told {1e3 * middle_s:.2f} ms after it was sent")


def _lives(link: ServoLink, guardian: Guardian | None, wait_s: float) -> None:
    """Wait, heard by the keeper: a process that is stopped meanwhile, as by Ctrl-Z, must not leave it turning."""
    until_s = link.now_s() + wait_s
    while True:
        if guardian is not None:
            beat(guardian)
        if (left_s := until_s - link.now_s()) <= 0.0:
            return
        link.client.wait(min(left_s, _LOOK_S))


def _moves(link: ServoLink, guardian: Guardian | None) -> Fact:
    """When a position shows that a duty acts: how late the duty acts and how old the position is, together.

    By the horn's starts from rest under a constant duty, to and fro: v (t - tau (1 - exp(-t/tau))) after the first
    motion, with one delay, tau and v for all, and the place of each start within its count. An exchange is timed by its
    middle. To 1 ms: a start is a few counts.
    """
    name, model = "moves_after_s", link.model
    turn, duty = model.counts_per_turn, round(_TURNS_SHARE * model.full_drive)
    times: list[float] = []
    ways: list[float] = []
    starts: list[int] = []
    try:
        for number in range(_STARTS):
            _still(link, 0, guardian)
            _lives(link, guardian, _TURNS_S)
            rests, side = link.value(model.roles["position"]), 1 if number % 2 == 0 else -1
            sent_s = 0.5 * (_drive(link, side * duty) + link.now_s())
            while (asked_s := link.now_s()) < sent_s + _START_S:
                _lives(link, guardian, 0.0)
                position = link.value(model.roles["position"])
                times.append(0.5 * (asked_s + link.now_s()) - sent_s)
                starts.append(number)
                ways.append(side * ((position - rests + turn // 2) % turn - turn // 2))
    finally:
        _off(link, guardian)
    t_s, counts = np.array(times), np.array(ways, dtype=np.float64)
    counts *= np.sign(counts.sum()) or 1.0  # the sign of a duty is not known here
    if counts.max() < 10.0:
        return Fact(name, None, f"the horn did not turn under {percent(_TURNS_SHARE)} of full duty")

    def off(x: Floats) -> Floats:
        since = np.maximum(t_s - x[0], 0.0)
        return np.asarray(x[2] * (since + x[1] * np.expm1(-since / x[1])) + x[3:][starts] - counts)

    first = (5e-3, _START_S, counts.max() / _START_S, *[0.0] * _STARTS)
    low, high = (0.0, 1e-3, 0.0, *[-1.0] * _STARTS), (_START_S, 1.0, np.inf, *[1.0] * _STARTS)
    found = least_squares(off, first, bounds=(low, high), x_scale=(1e-3, 1e-2, 1e2, *[1.0] * _STARTS))
    after_s = float(found.x[0])
    words = (
        f"a position shows a duty about {1e3 * after_s:.0f} ms after it was sent: late duty and old position together"
    )
    return Fact(name, round(after_s, 4), words)


def _stops(link: ServoLink, guardian: Guardian | None, *, has_watchdog: bool) -> Iterator[Fact]:
    """How soon a turning horn slows down: at duty 0, with torque off, and by the watchdog."""
    roles = link.model.roles
    ways: list[tuple[str, Callable[[], object]]] = [
        ("duty 0", lambda: _drive(link, 0)),
        ("torque off", lambda: link.put(roles["torque"], 0)),
    ]
    if has_watchdog:
        ways.append(("watchdog", lambda: link.put(roles["watchdog"], 1)))
    for name, stop in ways:
        slowed_s = _slowed_s(link, stop, guardian, silent=name == "watchdog")
        key = f"slows_s_{name.replace(' ', '_')}"
        if slowed_s is None:
            yield Fact(key, None, f"the horn did not turn under {percent(_TURNS_SHARE)} of full duty")
        elif slowed_s == math.inf:
            yield Fact(key, None, f"{name}: its speed did not fall to 37 % within {1e3 * _STOPS_S:g} ms")
        else:
            yield Fact(key, round(slowed_s, 4), f"{name}: its speed fell to 37 % within {1e3 * slowed_s:.0f} ms")


def _slowed_s(link: ServoLink, stop: Callable[[], object], guardian: Guardian | None, *, silent: bool) -> float | None:
    """Time until its speed has fallen to 37 %, s, a watchdog's own time in it; inf: never. None: it did not turn."""
    model, now_s = link.model, link.now_s
    position, turn = model.roles["position"], model.counts_per_turn

    def step(before: int, after: int) -> int:
        return (after - before + turn // 2) % turn - turn // 2

    def lives(wait_s: float) -> None:
        _lives(link, guardian, wait_s)

    try:
        _still(link, round(_TURNS_SHARE * model.full_drive), guardian)
        lives(_TURNS_S)
        first, from_s = link.value(position), now_s()
        lives(5.0 * _LOOK_S)
        last, at_s = link.value(position), now_s()
        speed = abs(step(first, last)) / (at_s - from_s)
        if abs(step(first, last)) < 5:
            return None
        stop()
        began_s = now_s()
        if silent:  # reading would feed it
            lives(_SILENT_S / 4.0)
        before, before_s = link.value(position), now_s()
        while now_s() - began_s < _STOPS_S:
            lives(_LOOK_S)
            after, after_s = link.value(position), now_s()
            if abs(step(before, after)) / (after_s - before_s) < _FELL_TO * speed:
                return after_s - began_s
            before, before_s = after, after_s
        return math.inf
    finally:
        _off(link, guardian)


def _p_scale(link: ServoLink) -> Fact:
    """What a P of 1 makes of 1 rad in the servo's own position mode: by duties too small to turn it.

    Of a Dynamixel Goal PWM is the most duty that this mode gives, of a Feetech its torque limit. Changing the mode sets
    Goal PWM to the limit: so it is written before the torque goes on, and read back.
    """
    model, roles, name = link.model, link.model.roles, "p_scale_1_rad"
    position, applied = roles["position"], roles["applied"]
    most = roles["drive" if model.protocol == "dynamixel" else "max_drive"]
    P, counts = _P_GAIN_COUNTS[model.protocol]
    set_to_0(link)
    link.put(roles["torque"], 0)
    link.client.wait(_STOPS_S)  # the horn may still coast
    if model.protocol == "feetech" and (integral := link.value("position_i_gain")) != 0:
        return Fact(name, None, f"its I is {integral}: a P by itself does not show")
    link.hold(roles["mode"], model.position_mode)
    link.hold("position_p_gain", P)
    if model.protocol == "dynamixel":
        for gain in ("position_i_gain", "position_d_gain"):
            link.put(gain, 0)
    at = link.value(position)
    low, high = link.value("min_position_limit"), link.value("max_position_limit")
    rests = min(max(at, low), high)  # no goal may be beyond; the duty is bounded anyway
    products, squares = 0.0, 0.0

    def go_to(one: ServoLink, goal: int) -> None:
        if (held := one.value(most)) != _P_MOST_STEPS:  # another one if it has restarted
            raise Fault("ARM_READBACK", f"{model[most]}: sent {_P_MOST_STEPS}, stored {held}")
        one.put("goal_position", goal)

    def on(one: ServoLink) -> None:
        one.put(most, _P_MOST_STEPS)
        go_to(one, rests)
        one.put(roles["torque"], 1)

    try:
        link.in_one_go(on)
        for goal in range(at - _P_GOALS * counts, at + _P_GOALS * counts + 1, counts):
            if not low <= goal <= high:
                continue
            link.in_one_go(partial(go_to, goal=goal))
            link.client.wait(_ACTS_S)
            error, duty = goal - link.value(position), link.value(applied)
            if abs(duty) < _P_MOST_STEPS:
                products, squares = products + error * duty, squares + error * error
        link.in_one_go(partial(go_to, goal=rests))  # with the torque off it might switch that on
    finally:
        _off(link)
    if not products > 0.0:
        return Fact(name, None, "its position mode gave no duty, or all that it may, for an error of its position")
    counts_rad = model.counts_per_turn / (2.0 * math.pi)
    steps = products / squares / P  # of duty for a count
    scale = steps * counts_rad / model.full_drive
    return Fact(name, round(scale, 6), f"a P of 1 makes {scale:.3g} of full duty of 1 rad: 1/{1.0 / steps:.0f} a count")


def _least_duty(link: ServoLink, guardian: Guardian | None) -> Fact:
    """The smallest duty that a Feetech drives with."""
    roles = link.model.roles
    try:
        for duty in _DUTIES:
            _still(link, duty, guardian)
            if link.value(roles["applied"]) != 0:
                return Fact("least_duty", duty, f"{duty} steps of duty act; {duty - _DUTIES.step} do not")
    finally:
        _off(link, guardian)
    return Fact("least_duty", None, f"no duty up to {_DUTIES[-1]} steps acts")


def _protects(link: ServoLink, duty: int, guardian: Guardian | None) -> Fact:
    """Whether a Feetech's protection from overload acts in PWM mode: made to begin at 1 % of duty, after 0.1 s.

    Afterwards it may answer nothing until its supply is cut, as people say of theirs: so this comes before that is.
    """
    roles, name = link.model.roles, "protects_in_pwm"
    for register, value in _OVERLOAD.items():
        link.hold(register, value)
    try:
        _still(link, duty, guardian)
        _lives(link, guardian, _STOPS_S)
        left = link.value(roles["applied"])
        _off(link, guardian)
    except Fault as fault:
        if fault.code != "LINK_TIMEOUT":
            raise
        return Fact(name, True, "its protection acts in PWM mode, and then it answers nothing until its supply is cut")
    acts = abs(left) < duty
    return Fact(name, acts, f"its protection {'acts' if acts else 'does not act'} in PWM mode: {duty} steps are {left}")


def _keeps_mode(link: ServoLink, powered: Powered) -> Fact:
    """Whether a mode that was written with the lock at 1 is forgotten with the supply."""
    mode = link.model.roles["mode"]
    powered()
    kept = link.value(mode) == link.model.pwm_mode
    words = "the mode is kept without supply, though the lock is 1" if kept else "the mode is forgotten with the supply"
    return Fact("lock_keeps_mode", kept, words)
