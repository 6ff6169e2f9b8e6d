"""What a servo's registers held before rig changed them, and what it set, kept on disk until they hold it again.

The file is of a place, where another servo may be by the next command: nothing is put back to one that holds a value
which is neither. What is lost without supply tells nothing by that.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from rig.backends.links.usb_port import usb_port
from rig.backends.servo.bus import ServoLink
from rig.backends.servo.models import ServoModel
from rig.core import strict_json
from rig.core.faults import Fault
from rig.core.plain_file import read_plain

_MOST_BYTES: Final = 64 * 1024
# Changing the mode sets these anew (e-Manual, "Operating Mode")
_RESET_BY_MODE: Final = (
    "velocity_i_gain",
    "velocity_p_gain",
    "position_d_gain",
    "position_i_gain",
    "position_p_gain",
    "feedforward_2nd_gain",
    "feedforward_1st_gain",
    "profile_acceleration",
    "profile_velocity",
    "goal_current",  # in a gripper's mode it bounds what the servo may squeeze with
    "goal_velocity",
)
# What `rig servo facts` changes of a Feetech; its lock keeps all of it out of the EEPROM
_TRIED_ON_FEETECH: Final = ("position_p_gain", "protective_torque", "protection_time", "overload_torque")
# In the order in which they are put back, as ``back_of`` says
_CHANGED: Final = {
    "dynamixel": (
        "pwm_slope",
        "return_delay_time",
        "operating_mode",
        *_RESET_BY_MODE,
        "bus_watchdog",
        "pwm_limit",
        "goal_pwm",
    ),
    "feetech": ("return_delay_time", *_TRIED_ON_FEETECH, "mode", "goal_duty", "lock", "torque_limit"),
}
_LIMITS: Final = {"goal_pwm": "pwm_limit", "goal_current": "current_limit", "goal_velocity": "velocity_limit"}

Sets = Mapping[str, Sequence[int]]  # what rig may set a register to
_NOTHING: Final[Sets] = MappingProxyType({})


class BeforeStore:
    """A file that holds the values of before, and those that rig sets, while rig has changed them.

    path        None: kept in memory alone, of a servo in virtual time
    aside_path  where values stay that were of another servo, as it seems: nobody reads them there
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self.aside_path: Path | None = None
        self._values: dict[str, int] | None = None
        self._sets = _NOTHING

    @property
    def note_path(self) -> Path | None:
        """Where the keeper leaves word of what it did."""
        return None if self.path is None else self.path.with_suffix(".txt")

    @property
    def own(self) -> tuple[dict[str, int] | None, Sets]:
        """What this process has kept, whatever became of the file: another run may think it its own."""
        return self._values, self._sets

    @property
    def is_kept(self) -> bool:
        """Whether there is something to put back."""
        return self._values is not None if self.path is None else self.path.exists()

    def note(self) -> str:
        """What the keeper of an earlier run did, once; empty where it had nothing to do."""
        if self.note_path is None:
            return ""
        with contextlib.suppress(OSError):
            words = self.note_path.read_text(encoding="utf-8", errors="replace")[:200]
            with contextlib.suppress(OSError):  # of a folder that is read-only: it is told again
                self.note_path.unlink()
            return words
        return ""

    def load(self, model: ServoModel) -> dict[str, int] | None:
        """The values of before that an earlier run has left, as ``read``."""
        return self.read(model)[0]

    def read(self, model: ServoModel) -> tuple[dict[str, int] | None, Sets]:
        """The values of before, None where none are left; and what rig sets.

        Raises Fault SERVO_CHANGED for a damaged file, and for one of another model.
        """
        if self.path is None:
            return self.own
        try:
            content = read_plain(self.path, _MOST_BYTES)
        except FileNotFoundError:
            return self.own  # somebody has deleted it meanwhile
        except OSError as error:
            raise Fault("SERVO_CHANGED", f"{self.path}: {error.strerror}") from error
        try:
            found: Any = strict_json.parse(content.decode("utf-8"))
            whose, registers = found["model"], {str(name): int(value) for name, value in found["registers"].items()}
            sets = {name: [int(value) for value in found["set"][name]] for name in registers if name in found["set"]}
            for name, value in registers.items():
                if whose == model.name and model.has(name):
                    model[name].pack(value)  # one that it cannot hold would stop the putting back half-way
        except KeyError as error:  # an older rig wrote no key `set`
            raise Fault("SERVO_CHANGED", f"{self.path} lacks the key {error}; its values may be old") from error
        except (ValueError, TypeError, AttributeError, OverflowError) as error:
            raise Fault("SERVO_CHANGED", f"{self.path} is damaged: {error}") from error
        foreign = [name for name in registers if name not in _CHANGED[model.protocol] or not model.has(name)]
        if whose != model.name or foreign:
            raise Fault("SERVO_CHANGED", f"{self.path} is of {whose}{f', with {foreign[0]}' if foreign else ''}")
        return registers, sets

    def save(self, model: ServoModel, id: int, values: Mapping[str, int], sets: Sets = _NOTHING) -> None:
        """Keep the values, on the disk when this returns. Raises Fault SERVO_CHANGED: then nothing may be written.

        sets  what rig sets those registers to whose value it knows beforehand
        """
        self._values, self._sets = dict(values), sets
        if self.path is None:
            return
        fresh = self.path.with_name(f"{self.path.name}.{os.getpid()}")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with fresh.open("w", encoding="utf-8") as file:
                file.write(text_of(model, id, values, sets))
                file.flush()
                os.fsync(file.fileno())
            fresh.replace(self.path)
        except OSError as error:
            raise Fault("SERVO_CHANGED", f"{self.path}: {error.strerror}: what to put back would be lost") from error

    def set_aside(self) -> None:
        """Of a servo that shows nothing of the run that left the values: another one may have to get them back.

        Beside those of servos before. Where the folder is read-only they stay where they are.
        """
        self._values, self._sets, self.aside_path = None, _NOTHING, self.path
        if self.path is not None:
            names = (f".aside{'' if number == 1 else number}.json" for number in itertools.count(1))
            beside = next(one for one in map(self.path.with_suffix, names) if not one.exists())
            with contextlib.suppress(OSError):
                self.aside_path = self.path.replace(beside)

    def clear(self) -> None:
        """The servo holds them again."""
        self._values, self._sets = None, _NOTHING
        if self.path is not None:
            with contextlib.suppress(OSError):
                self.path.unlink(missing_ok=True)


def text_of(model: ServoModel, id: int, values: Mapping[str, int], sets: Sets) -> str:
    """What the file says."""
    return json.dumps({"model": model.name, "id": id, "registers": dict(values), "set": dict(sets)})


def state_folder() -> Path:
    """Where these files are: ``$XDG_STATE_HOME/rig``, or ``~/.local/state/rig``."""
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if base.startswith("/") else Path.home() / ".local/state") / "rig"


def store_of(port: str, id: int) -> BeforeStore:
    """The file of one servo, by its id and the serial number of its adapter on USB, else where that is plugged in.

    The same for every command and config, by whatever name they have the port: a file that nobody finds again is none.
    Off USB by the name of the device file.
    """
    found = usb_port(port)
    where = found.serial_number or found.location or Path(port).resolve().name
    if found.serial_number and (channel := (found.location or "").partition(":")[2]):
        where = f"{where}_{channel}"  # all ports of an FT4232 have one serial number
    return BeforeStore(state_folder() / f"servo-{re.sub(r'[^A-Za-z0-9_.-]', '_', where)}-{id}.json")


def values_of(link: ServoLink) -> dict[str, int]:
    """What the registers that a run changes hold now. Raises Fault LINK_*."""
    model = link.model
    names = [name for name in _CHANGED[model.protocol] if model.has(name)]
    values = {name: link.sure(name) for name in names}
    kept, drive = _within_limits(link, values), model.roles["drive"]
    if kept.get("bus_watchdog", 1) <= 0:
        del kept["bus_watchdog"]  # off, or it has acted: the end leaves it off
    if values[model.roles["mode"]] == model.pwm_mode:
        kept[drive] = 0  # there it is the duty: whoever switches the torque on next must not find rig's
    elif "lock" in model.roles:
        del kept[drive]  # in another mode its write may switch the torque on
    return kept


def _within_limits(link: ServoLink, values: Mapping[str, int]) -> dict[str, int]:
    """The same without what the servo refuses by now: goals of before their limit was lowered."""
    kept = dict(values)
    for goal, limit in _LIMITS.items():
        if goal in values and link.model.has(limit):
            most = values[limit] if limit in values else link.sure(limit)
            kept[goal] = max(-most, min(values[goal], most))
    return kept


class Back(NamedTuple):
    """What puts a servo back: registers and their values, in three parts, one after the other.

    early   what changing the mode leaves
    middle  the mode, and what that sets anew; behind it no goal is left
    last    the limit, by which a servo shows until then that not all is back; behind it the goal
    told    what the file must say from the middle on: rig itself has changed the mode back. None: it says enough
    """

    early: list[tuple[str, int]]
    middle: list[tuple[str, int]]
    last: list[tuple[str, int]]
    told: Sets | None


def back_of(model: ServoModel, values: Mapping[str, int], sets: Sets, *, is_blind: bool = False) -> Back:
    """What puts values back that a run has changed, of which ``sets`` says to what.

    is_blind  the mode is written whatever it is, and so resets all, though the run may have changed nothing yet
    """
    mode, limit, drive = (model.roles[role] for role in ("mode", "max_drive", "drive"))
    names = [name for name in _CHANGED[model.protocol] if name in values]
    at = names.index(mode) if mode in names else 0
    end = names.index(limit) if limit in names else len(names)
    early, middle, last = ([(name, values[name]) for name in part] for part in (names[:at], names[at:end], names[end:]))
    if mode not in names or "lock" in model.roles:
        return Back(early, middle, last, None)
    middle.insert(1, (drive, 0))  # changing the mode has set it to the limit
    told = {**sets, mode: (*sets.get(mode, ()), values[mode])}
    if limit in values and (is_blind or values[limit] in sets.get(limit, ())):  # where it tells nothing, it does now
        shows = next((one for one in sets.get(limit, ()) if one != values[limit]), values[limit] - 1)
        middle.insert(0, (limit, shows))
        told[limit] = (*sets.get(limit, ()), shows)
    return Back(early, middle, last, told)


def put_back(link: ServoLink, store: BeforeStore, *, is_left: bool = False) -> dict[str, int]:
    """Torque off, then every register as it was, read back; then the store is empty. What was put back.

    is_left  by an earlier run: then only what is still as that has set it, and to no other servo
    Raises Fault LINK_*, SERVO_REFUSED, ARM_READBACK; SERVO_CHANGED before anything is written.
    """
    model, roles = link.model, link.model.roles
    values, sets = store.read(model) if is_left else store.own
    values = values or {}
    if is_left and not (values := _as_left(link, values, sets, store)):
        store.set_aside()
        return {}
    values = _within_limits(link, values)
    link.put(roles["torque"], 0)
    if "watchdog" in roles:
        link.put(roles["watchdog"], 0)  # while it has acted no goal can be written
        link.hold(roles["watchdog"], 0)  # a late answer to another write may have confirmed that
    link.in_one_go(_end_duty)
    link.put(roles["torque"], 0)  # on some servos writing a goal switches it on
    back = back_of(model, values, sets)
    for part in (back.early, back.middle, back.last):
        if part is back.middle and back.told is not None:
            store.save(model, link.bus.id, values, back.told)
        for name, value in part + part:  # a wrong answer may have said that one holds its value already
            link.hold(name, value)
    link.put(roles["torque"], 0)
    if is_left and values.keys() <= {roles["drive"], "bus_watchdog"}:
        store.set_aside()
    else:
        store.clear()
    return values


def _end_duty(link: ServoLink) -> None:
    """Rig's duty: the next program that wants this mode would drive with it. In another one its write may drive."""
    model = link.model
    if link.sure(model.roles["mode"]) == model.pwm_mode:
        link.put(model.roles["drive"], 0)


def _as_left(link: ServoLink, values: Mapping[str, int], sets: Sets, store: BeforeStore) -> dict[str, int]:
    """The values of before for what is still as the run has set it; none for a servo that shows nothing of it.

    Raises Fault SERVO_CHANGED where a register that is kept without supply holds another value than those two.
    """
    model, drive = link.model, link.model.roles["drive"]
    held = {name: link.sure(name) for name in values}
    mode, limit = model.roles["mode"], model.roles["max_drive"]
    ours = {name: (before, *sets.get(name, ())) for name, before in values.items()}
    names = list(values)
    is_last = {mode, limit} <= sets.keys() and names.index(mode) < names.index(limit)  # an older rig's file: first
    if is_last and held[mode] != values[mode] and held[mode] in sets[mode] and model.is_eeprom(model[limit]):
        ours[limit] = tuple(sets[limit])  # rig lowers the limit ahead of the mode, and puts it back behind that
    for name, known in ours.items():
        if held[name] not in known and model.is_eeprom(model[name]):
            words = " or ".join(str(value) for value in dict.fromkeys(known))
            raise Fault(
                "SERVO_CHANGED",
                f"{model[name]} reads {held[name]}, but a run that has not put it back left {words}: this is another "
                f"servo, or somebody has changed it{' or cut its supply' if 'lock' in model.roles else ''} since. "
                f"Nothing was written. {store.path} is of that run: delete it, if this servo is as you want it"
                + (f"; with {held[name]} for {values[name]} there the rest is put back" * (held[name] != values[name])),
            )
    # of a rig that put the mode back last, and named that alone from there on: all that it resets is still to be done
    is_end = sets.keys() == {mode}
    if not is_end and not any(held[name] != values[name] and held[name] in ours[name] for name in sets):
        # a keeper has stopped it, and nothing else was changed; of a servo of PWM mode rig's duty shows nowhere else
        is_ours = drive in values and 0 in (held[drive], values[drive])
        return {name: values[name] for name in (drive, "bus_watchdog") if is_ours and name in values}
    # who has changed the mode back, and was not rig, has set these anew: what they hold is that one's
    is_back = mode in sets and not is_end and held[mode] == values[mode] not in sets[mode]
    theirs = _RESET_BY_MODE if is_back else ()
    return {
        name: value
        for name, value in values.items()
        if name not in theirs and (name not in sets or held[name] in ours[name])
    }
