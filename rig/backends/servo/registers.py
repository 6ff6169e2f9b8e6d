"""A servo's table as the register map of a bus: what a tick reads and writes, and what arming sets."""

from __future__ import annotations

from dataclasses import dataclass

from typing_extensions import override

from rig.backends.registers import map as registers_map
from rig.backends.registers.map import Register, RegisterSpan
from rig.backends.servo.models import ServoModel

_KINDS = {"uint8": "uint8", "int8": "int8", "uint16": "uint16", "int16": "int16", "uint32": "uint32", "int32": "int32"}


@dataclass(frozen=True)
class ServoMap(registers_map.RegisterMap):
    """What is at which address; ``others`` are read in each tick besides, by their roles."""

    others: tuple[Register, ...] = ()

    @property
    @override
    def read(self) -> RegisterSpan:
        applied = () if self.applied is None else (self.applied,)
        return RegisterSpan((self.position, *applied, *self.others))


def bus_register(model: ServoModel, name: str, called: str = "") -> Register:
    """A register of a model by its name, as the bus takes it. Raises KeyError where it has none."""
    r = model[name]
    kind = _KINDS.get(r.kind, "uint16")
    return Register(called or name, r.address, kind, "", low_first=True, cell_bytes=1, sign_bit=r.sign_bit)


def servo_map(model: ServoModel, zero_counts: int = 2048) -> ServoMap:
    """The map of a model; the position is counted from ``zero_counts``."""

    def role(name: str) -> Register:
        return bus_register(model, model.roles[name], name)

    others = ["voltage", "temperature", "tick"]
    if model.protocol == "feetech":
        # with Dynamixel the alert in each reply tells of errors, and a torque that is off does no harm
        others += ["errors", "torque"]
    return ServoMap(
        drive=role("drive"),
        position=role("position"),
        full=model.full_drive,
        offset_counts=-float(zero_counts),
        applied=role("applied"),
        control=role("torque"),
        watchdog=role("watchdog") if "watchdog" in model.roles else None,
        max_drive=role("max_drive"),
        unit_s=model.role("watchdog").scale if "watchdog" in model.roles else 0.001,
        others=tuple(role(name) for name in others if name in model.roles),
    )
