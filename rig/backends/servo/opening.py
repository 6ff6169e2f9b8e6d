"""What rig makes sure of before a servo may drive: who it is, who uses it, how it is set, what its watchdog does.

Nothing is written before every check has passed and the values of before are on disk.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from rig.backends.servo.before import BeforeStore, Sets, put_back, values_of
from rig.backends.servo.bus import ServoLink
from rig.backends.servo.models import ServoModel, models_of
from rig.backends.servo.packets import LAST_ID
from rig.backends.servo.presence import who_answers
from rig.core.faults import Fault
from rig.core.person import Asks

_SUPPLY_SHARE: Final = 0.05  # by which the voltage register and drive.supply_V may differ
_LIMIT_SHARE: Final = 0.03  # that the supply must keep from the servo's own voltage limits
_LISTENS_S: Final = 0.05  # for another master
_LISTENS_AGAIN_S: Final = 0.25  # where answers were disturbed
_QUESTIONS: Final = 4  # that tell whether one servo alone answers
_PINGS: Final = 2  # of them besides, for one that answers nothing else
_ANSWERS_S: Final = 0.03  # within which a second answer comes, also behind a slow adapter
_CALLS: Final = 2  # of an id before nobody has it: one packet may be lost
_TORQUE_BY_GOAL, _SLAVE = 0x08, 0x02  # bits of Dynamixel's drive mode
_TORQUE_AT_START, _RAM_AT_START = 0x01, 0x02  # bits of its startup configuration
_ANSWERS_ALL: Final = {"dynamixel": 2, "feetech": 1}  # level at which a servo answers every instruction
_NO_SHADOW: Final = 253  # from here on there is no second id
_MANY_TURNS: Final = 0x10  # bit of Feetech's phase
_PROTECTS: Final = 0x24  # bits of what takes the torque away, of both protocols: overload and heat
_PROOF_STEPS: Final = 3  # of the drive: 0.3 %, far below breakaway
_PROOF_S: Final = 0.06  # three times the watchdog's time
_ACTS_S: Final = 0.05  # until the proof's duty shows
_FASTEST: Final = 255
_SWITCH_LOOK_S, _SWITCH_LOOKS = 0.1, 3  # that must agree: one answer may be lost
_RISES_S: Final = 10.0  # longest wait for the supply behind a switch: its capacitors may be large
_REBOOTS_S: Final = 3.0
_LOW: Final = 0x01  # bit of the supply among the errors, of both protocols
_MARK: Final = 1  # of a register that has another value after a loss of supply, and moves nothing

_ERRORS: Final = {
    "dynamixel": {0x01: "supply", 0x04: "heat", 0x08: "encoder", 0x10: "shock", 0x20: "overload"},
    "feetech": {0x01: "supply", 0x02: "sensor", 0x04: "heat", 0x08: "current", 0x20: "overload"},
}


@dataclass(frozen=True)
class ServoSetup:
    """What the config says of the servo.

    model, id     who it is
    fastest_slope its duty is to be ramped as fast as it can
    brakes        at a stop the duty is 0 until the shaft rests; else the torque goes off at once
    hot_degC      from here on rig drives no more
    supply_V      of the servo
    zero_counts   position register at 0 rad
    max_units     largest drive of the experiment, steps
    watchdog_s    silence after which its watchdog acts, s
    longest_delay_s  return delay that a tick has room for, s: one that is not longer stays as it is
    supply_switch    that must be tried before it drives, in words; empty: none must
    adapter_s        by how much its USB adapter makes an exchange longer, at most, s
    """

    model: ServoModel
    id: int
    fastest_slope: bool
    brakes: bool
    hot_degC: int
    supply_V: float
    zero_counts: int
    max_units: int
    watchdog_s: float
    longest_delay_s: float = 0.0
    supply_switch: str = ""
    adapter_s: float = 0.0


@dataclass(frozen=True)
class Opened:
    """What the opening found.

    firmware       version
    supply_V       by the servo's register
    slope_V_s      by which its duty is ramped; None: it acts at once
    has_watchdog   that it stops the motor has been seen
    remarks        what people should know
    """

    firmware: int
    supply_V: float
    slope_V_s: float | None
    has_watchdog: bool
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class Left:
    """What an earlier run has left: for people, and as codes of faults; others on the bus, where it looked for them."""

    remarks: tuple[str, ...]
    acknowledged: tuple[str, ...]
    others: tuple[str, ...] | None = None


def look(link: ServoLink, setup: ServoSetup, others: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """Every check that only reads. Returns remarks.

    others  what ``check_others`` has found just before: it takes seconds
    Raises Fault SECOND_MASTER, LINK_UNIT, SERVO_IN_USE, SERVO_SETUP, SERVO_ERROR, SERVO_SUPPLY, SERVO_HOT.
    """
    check_bus(link)
    _check_errors(link)
    _check_setup(link)
    _check_limit(link, setup)
    _check_supply(link, setup)
    _check_heat(link, setup)
    _check_torque(link)
    return check_others(link) if others is None else others


def objections(link: ServoLink) -> tuple[str, ...]:
    """What ``look`` would refuse whatever the config says, for people. Raises Fault LINK_*."""
    found = []
    for check in (check_one, _check_errors, _check_setup, _check_torque):
        try:
            check(link)
        except Fault as fault:
            if not (fault.code.startswith("SERVO_") or fault.code == "LINK_UNIT") or fault.code == "SERVO_REFUSED":
                raise
            found.append(f"{fault.code}: {fault.detail}")
    return tuple(found)


def try_switch(link: ServoLink, setup: ServoSetup, store: BeforeStore, asks: Asks) -> None:
    """Have a person cut the supply by its switch: the servo must fall silent, and start anew.

    One that answers on is fed by something, and that may drive it. A pulled plug of the bus makes it silent, too, but
    it forgets nothing: a register tells, which rig has marked.
    Raises Fault SERVO_SWITCH_UNTRIED where that is not seen in time, LINK_*, SERVO_CHANGED, ARM_READBACK.
    """
    id, marked = link.bus.id, link.model.roles["marked"]

    def sees(*, silence: bool) -> Callable[[], bool]:
        looks = 0

        def is_seen() -> bool:
            nonlocal looks
            link.client.wait(_SWITCH_LOOK_S)
            looks = looks + 1 if (link.value_of(id, marked) is None) == silence else 0
            return looks >= _SWITCH_LOOKS

        return is_seen

    def unmark() -> None:
        link.hold(marked, before)
        store.clear()

    before = link.value(marked)
    store.save(link.model, id, {marked: before}, {marked: [_MARK]})
    try:
        link.hold(marked, _MARK)
        if not asks(f"open the switch of the servo's supply: {setup.supply_switch}", sees(silence=True)):
            words = f"servo {id} answered on: does this switch cut its supply, and all that feeds it?"
            raise Fault("SERVO_SWITCH_UNTRIED", words)
        if not asks(f"servo {id} is silent: close the switch again", sees(silence=False)):
            raise Fault("SERVO_SWITCH_UNTRIED", f"servo {id} did not come back")
        if (anew := link.sure(marked)) == _MARK:
            words = f"servo {id} was silent, but has not started anew: a plug of its bus was out, its supply not cut"
            raise Fault("SERVO_SWITCH_UNTRIED", words)
        store.save(link.model, id, {marked: before}, {marked: [_MARK, anew]})
        _await_supply(link, setup, asks)
    except BaseException:
        with contextlib.suppress(Fault):  # without an answer the file keeps it
            unmark()
        raise
    unmark()  # a run would write its own values into that file


def _await_supply(link: ServoLink, setup: ServoSetup, asks: Asks) -> None:
    """Wait until the supply behind a closed switch has risen; one that does not within the time is refused later on.

    A servo that was fed too little meanwhile may keep that as an error until it starts anew: so it does, then. It has
    just lost its supply, so it forgets nothing but what rig has marked and still puts back.
    Raises Fault LINK_*, SERVO_REFUSED, INTERRUPTED.
    """
    voltage, until_s, risen = link.model.role("voltage"), link.now_s() + _RISES_S, 0

    def is_near() -> bool:
        held = link.value_of(link.bus.id, voltage.name)  # it may still fail again
        return held is not None and _is_near(held * voltage.scale, link, setup)

    def is_over() -> bool:
        nonlocal risen
        risen = risen + 1 if is_near() else 0
        if risen >= _SWITCH_LOOKS or link.now_s() >= until_s:
            return True
        link.client.wait(_SWITCH_LOOK_S)
        return False

    if not (is_there := is_near()):
        words = f"the supply of servo {link.bus.id} rises to {setup.supply_V:g} V: rig waits, {_RISES_S:g} s at most"
        asks(words, is_over)
        is_there = risen >= _SWITCH_LOOKS
    if is_there and link.value(link.model.roles["errors"]) == _LOW:
        start_anew(link)


def start_anew(link: ServoLink) -> None:
    """Reboot it, and wait until it answers. Raises Fault LINK_TIMEOUT, SERVO_REFUSED."""
    try:
        link.client.asked(link.bus.reboot(), 0.1)
    except Fault as fault:
        if fault.code != "LINK_TIMEOUT" or link.model.protocol != "feetech":  # a Feetech is on its way at once
            raise
    until_s = link.now_s() + _REBOOTS_S
    while link.is_there(link.bus.id) is None:
        if link.now_s() > until_s:
            raise Fault("LINK_TIMEOUT", f"servo {link.bus.id} does not answer after its reboot")
        link.client.wait(0.05)


def leave_no_trace(link: ServoLink, setup: ServoSetup, store: BeforeStore) -> Left:
    """Put back what an earlier run has left changed.

    Raises Fault LINK_*, SERVO_CHANGED; before anything is written CONFIG_MISMATCH where it is another servo, and as
    ``check_free``.
    """
    check_model(link, setup)
    words = store.note()
    remarks = (f"the run before has ended without a stop; its keeper {words}",) if words else ()
    if store.load(link.model) is None:
        return Left(remarks, ())
    others = check_free(link)
    watchdog = link.model.roles.get("watchdog")
    acted = ("DEVICE_WATCHDOG",) if watchdog is not None and link.value(watchdog) == -1 else ()
    changed = put_back(link, store, is_left=True)
    done = "rig has done that now"
    if not changed:
        done = f"nothing of that run is left in them; if it drove another servo, {store.aside_path} has that one's"
    remark = f"an earlier run has ended without putting the servo's registers back: {done}"
    return Left((*remarks, remark), acted, others)


def set_up(
    link: ServoLink,
    setup: ServoSetup,
    store: BeforeStore,
    watched: Callable[[], None] = lambda: None,
    further: Mapping[str, int] = MappingProxyType({}),
) -> Opened:
    """Keep the values of before, then set the servo up, torque off, drive 0, and prove its watchdog.

    further  what registers will be set to besides, by name
    watched  has somebody stop the servo if this process dies; called once the values are kept, before anything is
             written
    Raises Fault LINK_*, ARM_READBACK, SERVO_CHANGED, SERVO_REFUSED.
    """
    model = setup.model
    torque, mode, limit = (model.roles[role] for role in ("torque", "mode", "max_drive"))
    before, delay = values_of(link), model.role("return_delay")
    sets = {limit: setup.max_units, mode: model.pwm_mode}
    if before[delay.name] * delay.scale > setup.longest_delay_s:
        sets[delay.name] = 0
    if setup.fastest_slope and "slope" in model.roles:
        sets[model.roles["slope"]] = _FASTEST
    names = {**sets, **further}
    told: Sets = {name: [one[name] for one in (sets, further) if name in one] for name in names}
    store.save(model, setup.id, before, told)
    watched()
    link.put(torque, 0)
    if link.value(delay.name) * delay.scale > setup.longest_delay_s:  # of EEPROM, as limit, mode and slope are
        link.hold(delay.name, 0)
    link.hold(limit, setup.max_units)  # first: changing the mode sets the goal to it
    link.hold(mode, model.pwm_mode)
    if "watchdog" in model.roles:
        link.put(model.roles["watchdog"], 0)  # one that has acted takes no goal
    set_to_0(link)
    link.put(torque, 0)
    slope_V_s = _set_slope(link, setup)
    firmware = link.sure(model.roles["firmware"])
    supply_V = _check_supply(link, setup)
    proven, remark = _prove_watchdog(link)
    changed = ", ".join(f"{name} {value}" for name, value in before.items())
    kept = f"; also in {store.path}" if store.path is not None else ""
    remarks = (f"the servo's registers before this run, which rig puts back: {changed}{kept}", *remark)
    return Opened(firmware, supply_V, slope_V_s, proven, remarks)


def check_model(link: ServoLink, setup: ServoSetup) -> None:
    """Raise Fault CONFIG_MISMATCH where another servo answers than the config's."""
    number = link.value(link.model.roles["model_number"])
    if number != setup.model.number:
        known = [model.name for model in models_of(number, setup.model.protocol)]
        raise Fault(
            "CONFIG_MISMATCH",
            f"servo {setup.id} is {' or '.join(known) or f'of model number {number}, which rig does not know'}, not "
            f"{setup.model.name} (daq.servo.model)",
        )


def check_alone(link: ServoLink, for_s: float = _LISTENS_S) -> None:
    """Raise Fault SECOND_MASTER where another one talks on this bus while rig is silent for so long."""
    before = link.client.statistics["stale_bytes"]
    link.client.wait(for_s)
    heard = link.client.statistics["stale_bytes"] - before
    if heard:
        raise Fault("SECOND_MASTER", f"{heard} bytes on the bus within {1e3 * for_s:g} ms that rig did not ask for")


def check_one(link: ServoLink) -> None:
    """Raise Fault LINK_UNIT where two servos answer to one id: both would obey.

    Two answers come one after the other, or damage each other: positions, and clocks, are hardly the same. One that
    answers pings alone shows in those, unless it is of the same model and firmware, and as quick to the bit.
    """
    roles = link.model.roles
    asked = [roles[role] for role in ("position", "tick") if role in roles]
    twice = sum(not link.one_answers(asked[k % len(asked)], _ANSWERS_S) for k in range(_QUESTIONS))
    pinged = sum(not link.one_answers(None, _ANSWERS_S) for _ in range(_PINGS))
    if 2 * twice >= _QUESTIONS or pinged == _PINGS:
        check_alone(link, _LISTENS_AGAIN_S)  # who has begun to talk meanwhile, as another rig, says more
        raise Fault(
            "LINK_UNIT",
            f"to {twice + pinged} of {_QUESTIONS + _PINGS} questions more came than one whole answer: as where two "
            f"servos have id {link.bus.id}, or another program opens this bus just now",
        )


def set_to_0(link: ServoLink) -> None:
    """Duty 0, of a servo in PWM mode: in another one the write of a goal may switch the torque on.

    Raises Fault ARM_READBACK, DEVICE_RESET, LINK_*.
    """

    def write(one: ServoLink) -> None:
        _check_mode(one)
        one.put(link.model.roles["drive"], 0)
        _check_drive_is_0(one)

    link.in_one_go(write)


def switch_on(link: ServoLink, last: Callable[[], None] = lambda: None) -> None:
    """Torque on, right behind a last look: another duty than 0, or another mode, would drive the shaft at once.

    A servo that has lost its supply meanwhile has forgotten either; one that loses it in between is looked at anew.
    Who else talks on this bus, as the keeper of a rig on another adapter, may change mode or duty right before: the
    torque goes off again at once.

    last  called when all but the torque is done
    Raises Fault ARM_READBACK, DEVICE_RESET, LINK_*.
    """

    def on(one: ServoLink) -> None:
        _check_mode(one)
        _check_drive_is_0(one)
        last()
        one.put(link.model.roles["torque"], 1)
        try:
            _check_mode(one)
            _check_drive_is_0(one)
        except Fault:
            link.put(link.model.roles["torque"], 0)
            raise

    link.in_one_go(on)


def _check_drive_is_0(link: ServoLink) -> None:
    if (held := link.value(link.model.roles["drive"])) != 0:
        raise Fault("ARM_READBACK", f"{link.model.role('drive')}: sent 0, stored {held}")


def _check_mode(link: ServoLink) -> None:
    if (words := other_mode(link)) is not None:
        raise Fault("DEVICE_RESET", words)


def other_mode(link: ServoLink) -> str | None:
    """What to say of a servo that is not in PWM mode any more, as after its supply has failed; None: it is."""
    model = link.model
    mode = link.value(model.roles["mode"])
    return None if mode == model.pwm_mode else f"{model.role('mode')} reads {mode}, not {model.pwm_mode}"


def check_bus(link: ServoLink) -> None:
    """Raise Fault SECOND_MASTER where another one talks on this bus, LINK_UNIT where two servos answer to one id."""
    link.client.wait(_ANSWERS_S)  # what the last question brings besides is no other master's
    check_alone(link)
    check_one(link)


def check_free(link: ServoLink) -> tuple[str, ...]:
    """Before rig takes the torque away from a servo that it has left: somebody else may have taken it over since.

    Rig's own torque is on in PWM mode alone. Returns as ``check_others``.
    Raises Fault SERVO_IN_USE, SECOND_MASTER, LINK_UNIT, SERVO_SETUP.
    """
    check_bus(link)
    others = check_others(link)
    if link.value(link.model.roles["mode"]) != link.model.pwm_mode:
        _check_torque(link)
    return others


def check_started_anew(link: ServoLink) -> None:
    """Raise Fault SERVO_IN_USE, SERVO_ERROR of a servo that has not: a Feetech does not say that it will."""
    _check_torque(link)
    _check_errors(link)


def _check_torque(link: ServoLink) -> None:
    if link.value(link.model.roles["torque"]) != 0:
        raise Fault("SERVO_IN_USE", f"servo {link.bus.id}: its torque is on")


def _check_errors(link: ServoLink) -> None:
    errors = link.value(link.model.roles["errors"])
    if errors:
        raise Fault("SERVO_ERROR", f"{link.model.role('errors')} reads {errors}: {error_words(link.model, errors)}")


def error_words(model: ServoModel, errors: int) -> str:
    """The bits of the error register, for people."""
    names = _ERRORS[model.protocol]
    return ", ".join(words for bit, words in names.items() if errors & bit) or "none that rig knows"


def _check_setup(link: ServoLink) -> None:
    """How the servo is set: what lets it drive unasked, or obey somebody else."""
    model, roles = link.model, link.model.roles
    if "drive_mode" in roles:
        bits = link.value(roles["drive_mode"])
        if bits & _TORQUE_BY_GOAL:
            raise Fault("SERVO_SETUP", f"{model.role('drive_mode')} reads {bits}: a goal switches its torque on")
        if bits & _SLAVE:
            raise Fault("SERVO_SETUP", f"{model.role('drive_mode')} reads {bits}: it follows another servo")
    if "shadow_id" in roles and (shadow := link.value(roles["shadow_id"])) < _NO_SHADOW and shadow != link.bus.id:
        raise Fault("SERVO_SETUP", f"{model.role('shadow_id')} reads {shadow}: it obeys that id, too")
    check_startup(link)
    if (level := link.value(roles["answers"])) < _ANSWERS_ALL[model.protocol]:
        raise Fault("SERVO_SETUP", f"{model.role('answers')} reads {level}: it does not answer what is written")
    if "lock" in roles and link.value(roles["lock"]) != 1:
        raise Fault("SERVO_SETUP", f"{model.role('lock')} is 0: what rig writes would stay for good")
    if "phase" in roles and (bits := link.value(roles["phase"])) & _MANY_TURNS:
        raise Fault("SERVO_SETUP", f"{model.role('phase')} reads {bits}: its position counts turns")
    if ~(bits := link.value(roles["shutdown"])) & _PROTECTS:
        raise Fault("SERVO_SETUP", f"{model.role('shutdown')} reads {bits}: it does not protect itself")


def check_startup(link: ServoLink) -> None:
    """Raise Fault SERVO_SETUP where a servo switches its torque on by itself when it starts."""
    if "startup" in link.model.roles:
        bits = link.value(link.model.roles["startup"])
        if bits & (_TORQUE_AT_START | _RAM_AT_START):
            words = f"{link.model.role('startup')} reads {bits}: it can drive as soon as it has supply, or is rebooted"
            raise Fault("SERVO_SETUP", words)


def _check_limit(link: ServoLink, setup: ServoSetup) -> None:
    """Its own limit of the duty is somebody's choice, as of a gripper: it is lowered for a run, and never raised."""
    limit = link.value(link.model.roles["max_drive"])
    if limit < setup.max_units:
        most_V = (
            math.floor(1e3 * limit / link.model.full_drive * setup.supply_V) / 1e3
        )  # rounded up it would be refused
        words = f"reads {limit}: it allows {most_V:g} V; lower drive.max_V, or raise it"
        raise Fault("SERVO_SETUP", f"{link.model.role('max_drive')} {words}")


def _check_supply(link: ServoLink, setup: ServoSetup) -> float:
    """The supply, V. Raises Fault SERVO_SUPPLY."""
    model = link.model
    voltage = model.role("voltage")
    supply_V = link.value(model.roles["voltage"]) * voltage.scale
    if not _is_near(supply_V, link, setup):
        raise Fault("SERVO_SUPPLY", f"{voltage} reads {supply_V:.1f} V, but drive.supply_V is {setup.supply_V:g} V")
    low_V = link.value(model.roles["low_voltage"]) * model.role("low_voltage").scale
    high_V = link.value(model.roles["high_voltage"]) * model.role("high_voltage").scale
    if not low_V * (1.0 + _LIMIT_SHARE) <= supply_V <= high_V * (1.0 - _LIMIT_SHARE):
        raise Fault(
            "SERVO_SUPPLY",
            f"{supply_V:.1f} V is too near to the servo's own voltage limits, {low_V:.1f} to {high_V:.1f} V",
        )
    return supply_V


def _is_near(supply_V: float, link: ServoLink, setup: ServoSetup) -> bool:
    """Whether it is the config's, as far as the register tells."""
    most_V = _SUPPLY_SHARE * setup.supply_V + 0.5 * link.model.role("voltage").scale
    return abs(supply_V - setup.supply_V) <= most_V


def _check_heat(link: ServoLink, setup: ServoSetup) -> None:
    temperature = link.value(link.model.roles["temperature"])
    if temperature >= setup.hot_degC:
        raise Fault("SERVO_HOT", f"{temperature} degC, daq.servo.hot_degC is {setup.hot_degC}")


def check_others(link: ServoLink) -> tuple[str, ...]:
    """Who else is on the bus. Only their second id is read: one that is ours would make them obey rig.

    One that answers pings alone does not tell it, and obeys in silence. Raises Fault SERVO_SETUP, LINK_*.
    """
    own, shadow = link.bus.id, link.model.roles.get("shadow_id")
    silent = [id for id in range(LAST_ID + 1) if id != own]
    others: dict[int, int] = {}  # their model's numbers
    for _ in range(_CALLS if shadow is not None else 1):
        others |= who_answers(link, silent, surely=True)
        silent = [id for id in silent if id not in others]
    others = dict(sorted(others.items()))
    for id in others:
        if shadow is not None and (second := link.value_of(id, shadow)) in (None, own):
            tells = "does not tell its second id" if second is None else f"has {second} as its second id"
            raise Fault("SERVO_SETUP", f"servo {id} {tells}: it would obey rig, too")
    if not others:
        return ()
    alike = [id for id, number in others.items() if number == link.model.number]
    words = f"also on this bus: servo {_listed(others)}; rig leaves them alone"
    if alike:
        words += (
            f". It drives servo {own}, and {len(alike)} of them, {_listed(alike)}, "
            f"{'is' if len(alike) == 1 else 'are'} of the same model: only the id tells them apart"
        )
    return (words,)


def _listed(ids: Iterable[int]) -> str:
    return ", ".join(map(str, ids))


def _set_slope(link: ServoLink, setup: ServoSetup) -> float | None:
    """Set the ramp of the duty, where the servo has one; what it is, V/s."""
    name = link.model.roles.get("slope")
    if name is None:
        return None
    if setup.fastest_slope:
        link.hold(name, _FASTEST)
    return link.sure(name) * link.model[name].scale


def _prove_watchdog(link: ServoLink) -> tuple[bool, tuple[str, ...]]:
    """Whether the watchdog takes the duty away, seen at the bridge, not in a register; and what to tell people.

    The duty of the proof is far below what breaks the shaft away. Torque off and the watchdog off when it returns.
    """
    roles = link.model.roles
    if "watchdog" not in roles:
        return False, ()
    torque, drive, applied, watchdog = (roles[role] for role in ("torque", "drive", "applied", "watchdog"))
    switch_on(link)
    try:
        link.put(drive, _PROOF_STEPS)
        waited_s = 0.0
        while link.value(applied) == 0 and waited_s < _ACTS_S:
            link.client.wait(0.005)
            waited_s += 0.005
        acts = link.value(applied) != 0
        link.put(watchdog, 1)
        link.client.wait(_PROOF_S)
        left, says = link.value(applied), link.value(watchdog)
    finally:
        link.put(torque, 0)  # before the watchdog is cleared: the old goal might act again
        link.put(watchdog, 0)
        link.put(drive, 0)
    if acts and left == 0 and says == -1:
        return True, ()
    if not acts:
        why = f"{link.model[applied]} stayed 0 under a duty of {_PROOF_STEPS} steps, so nothing could be seen"
    elif says == -1:
        why = f"it says that it has acted, but the duty stayed at {left} steps: the motor drives on"
    else:
        why = f"after {1e3 * _PROOF_S:g} ms of silence {link.model[watchdog]} reads {says}, the duty {left} steps"
    return False, (f"this servo has no watchdog that rig can rely on: {why}",)
