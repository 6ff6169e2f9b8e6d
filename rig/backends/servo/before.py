"""What a servo's registers held before rig changed them, kept on disk until they hold it again."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rig.backends.links.usb_port import usb_port
from rig.backends.servo.bus import Ask, ServoLink
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
# In the order in which they are put back: the mode after the limit, because changing it sets the goal to the limit
_CHANGED: Final = {
    "dynamixel": ("pwm_slope", "pwm_limit", "return_delay_time", "operating_mode", "goal_pwm", *_RESET_BY_MODE),
    "feetech": ("return_delay_time", "torque_limit", *_TRIED_ON_FEETECH, "mode", "goal_duty", "lock"),
}


class BeforeStore:
    """A file that holds the values of before while rig has changed them.

    path  None: kept in memory alone, of a servo in virtual time
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self._values: dict[str, int] | None = None

    @property
    def note_path(self) -> Path | None:
        """Where the keeper leaves word of what it did."""
        return None if self.path is None else self.path.with_suffix(".txt")

    @property
    def is_kept(self) -> bool:
        """Whether there is something to put back."""
        return self._values is not None if self.path is None else self.path.exists()

    def note(self) -> str:
        """What the keeper of an earlier run did, once; empty where it had nothing to do."""
        if self.note_path is None:
            return ""
        with contextlib.suppress(OSError):
            words = self.note_path.read_text(encoding="utf-8", errors="replace")
            self.note_path.unlink()
            return words[:200]
        return ""

    def load(self, model: ServoModel) -> dict[str, int] | None:
        """What an earlier run has left; None where it left nothing.

        Raises Fault SERVO_CHANGED for a damaged file, and for one of another model.
        """
        if self.path is None:
            return self._values
        try:
            content = read_plain(self.path, _MOST_BYTES)
        except FileNotFoundError:
            return self._values  # somebody has deleted it meanwhile
        except OSError as error:
            raise Fault("SERVO_CHANGED", f"{self.path}: {error.strerror}") from error
        try:
            found: Any = strict_json.parse(content.decode("utf-8"))
            whose, registers = found["model"], {str(name): int(value) for name, value in found["registers"].items()}
            for name, value in registers.items():
                if whose == model.name and model.has(name):
                    model[name].pack(value)  # one that it cannot hold would stop the putting back half-way
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise Fault("SERVO_CHANGED", f"{self.path} is damaged: {error}") from error
        foreign = [name for name in registers if name not in _CHANGED[model.protocol] or not model.has(name)]
        if whose != model.name or foreign:
            raise Fault("SERVO_CHANGED", f"{self.path} is of {whose}{f', with {foreign[0]}' if foreign else ''}")
        return registers

    def save(self, model: ServoModel, id: int, values: Mapping[str, int]) -> None:
        """Keep the values, on the disk when this returns. Raises Fault SERVO_CHANGED: then nothing may be written."""
        self._values = dict(values)
        if self.path is None:
            return
        fresh = self.path.with_name(f"{self.path.name}.{os.getpid()}")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with fresh.open("w", encoding="utf-8") as file:
                json.dump({"model": model.name, "id": id, "registers": self._values}, file)
                file.flush()
                os.fsync(file.fileno())
            fresh.replace(self.path)
        except OSError as error:
            raise Fault("SERVO_CHANGED", f"{self.path}: {error.strerror}: what to put back would be lost") from error

    def clear(self) -> None:
        """The servo holds them again."""
        self._values = None
        if self.path is not None:
            with contextlib.suppress(OSError):
                self.path.unlink(missing_ok=True)


def state_folder() -> Path:
    """Where these files are: ``$XDG_STATE_HOME/rig``, or ``~/.local/state/rig``."""
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if base.startswith("/") else Path.home() / ".local/state") / "rig"


def store_of(port: str, id: int) -> BeforeStore:
    """The file of one servo, by its id and the serial number of its adapter on USB, else where that is plugged in.

    The same for every command and config, by whatever name they have the port: a file that nobody finds again is none.
    Off USB by the name of the device file. Another servo at the same place is not told from it, if of its model and id.
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
    kept, drive = dict(values), model.roles["drive"]
    if values[model.roles["mode"]] == model.pwm_mode:
        kept[drive] = 0  # there it is the duty: whoever switches the torque on next must not find rig's
    elif "lock" in model.roles:
        del kept[drive]  # in another mode its write may switch the torque on
    return kept


def put_back(link: ServoLink, values: Mapping[str, int]) -> None:
    """Torque off, then every register as it was, read back. Raises Fault LINK_*, SERVO_REFUSED, ARM_READBACK."""
    model = link.model
    torque = model.roles["torque"]
    link.put(torque, 0)
    if "watchdog" in model.roles:
        link.put(model.roles["watchdog"], 0)  # while it has acted no goal can be written
    names = [name for name in _CHANGED[model.protocol] if name in values]
    for name in names + names:  # a wrong answer may have said that one holds its value already
        link.hold(name, values[name])
    link.put(torque, 0)  # on some servos writing a goal switches it on


def order_of(link: ServoLink, values: Mapping[str, int]) -> list[Ask]:
    """The same as instructions, without a look in between: made before anything is changed, so it holds all of it."""
    model, roles = link.model, link.model.roles
    asks = [link.write_of(roles["torque"], 0)]
    if "watchdog" in roles:
        asks.append(link.write_of(roles["watchdog"], 0))
    asks += [link.write_of(name, values[name]) for name in _CHANGED[model.protocol] if name in values]
    return [*asks, link.write_of(roles["torque"], 0)]
