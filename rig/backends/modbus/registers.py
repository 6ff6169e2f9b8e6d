"""The registers of a Modbus device, as the section ``daq.modbus`` has them; pure data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Self

from typing_extensions import override

from rig.backends.registers import map as registers_map
from rig.backends.registers.map import Register, RegisterSpan

if TYPE_CHECKING:  # the process of an emulated device starts without the config
    from rig.backends.modbus.section import Modbus, PairRegisters

__all__ = ["Register", "RegisterMap", "RegisterSpan", "Table"]

Table = Literal["holding", "input"]


@dataclass(frozen=True)
class RegisterMap(registers_map.RegisterMap):
    """What is at which address; None where the device has no such register. Of a Modbus device alone:

    sequence, echo        a number that goes out with each drive, and comes back once that was executed
    limits, rails         two bounds of the position
    device_watchdog_s     output time-out that is set on the device itself, where no register sets it
    """

    sequence: Register | None = None
    echo: Register | None = None
    limits: tuple[Register, Register] | None = None
    rails: tuple[Register, Register] | None = None
    device_watchdog_s: float | None = None

    @classmethod
    def of(cls, modbus: Modbus) -> Self:
        """As the section ``daq.modbus`` has it."""
        r, low_first = modbus.registers, modbus.word_order == "low-first"
        drive, position, control = r.drive, r.position, r.control

        def holding(name: str, address: int, kind: str = "uint16") -> Register:
            return Register(name, address, kind, "holding", low_first)

        def seen(name: str, address: int, kind: str = "uint16") -> Register:
            return Register(name, address, kind, position.table, low_first)

        def pair(name: str, bounds: PairRegisters | None) -> tuple[Register, Register] | None:
            if bounds is None:
                return None
            low, high = bounds.low, bounds.high
            return holding(f"{name}.low", low, position.type), holding(f"{name}.high", high, position.type)

        return cls(
            drive=holding("drive", drive.address, drive.type),
            position=seen("position", position.address, position.type),
            full=drive.full,
            scale=position.scale,
            offset_counts=position.offset_counts,
            sequence=None if r.sequence is None else holding("sequence", r.sequence.address),
            echo=None if r.sequence is None else seen("echo", r.sequence.echo),
            applied=None if r.applied is None else seen("applied", r.applied.address, r.applied.type),
            status=None if r.status is None else seen("status", r.status.address),
            control=None if control is None else holding("control", control.address),
            watchdog=None if r.watchdog is None else holding("watchdog", r.watchdog.address),
            limits=pair("limits", r.limits),
            rails=pair("rails", r.rails),
            max_drive=None if r.max_drive is None else holding("max_drive", r.max_drive.address, drive.type),
            arm=1 if control is None else control.arm,
            stop=0 if control is None else control.stop,
            unit_s=0.001 if r.watchdog is None else r.watchdog.unit_s,
            device_watchdog_s=modbus.device_watchdog_s,
            faults={} if r.status is None else {value: code for code, value in r.status.faults.items()},
        )

    @property
    def set_when_armed(self) -> tuple[Register, ...]:
        """What is written outside the tick."""
        pairs = (*(self.limits or ()), *(self.rails or ()))
        return tuple(r for r in (self.control, self.watchdog, *pairs, self.max_drive) if r is not None)

    @property
    @override
    def written(self) -> RegisterSpan:
        return RegisterSpan((self.drive,) if self.sequence is None else (self.drive, self.sequence))

    @property
    @override
    def read(self) -> RegisterSpan:
        others = (self.echo, self.applied, self.status)
        return RegisterSpan((self.position, *(r for r in others if r is not None)))
