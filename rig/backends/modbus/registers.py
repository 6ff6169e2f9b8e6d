"""The registers of a Modbus device: what is at which address, of which type, in which words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple, Self

from pymodbus.client.mixin import ModbusClientMixin

if TYPE_CHECKING:  # the process of an emulated device starts without the config
    from rig.backends.modbus.section import Modbus, PairRegisters


Table = Literal["holding", "input"]
OFF, ARMED = 0, 1  # of the status register; anything else is a fault
FLOAT_STEPS = 10000  # drive units at full duty where the register is no whole number

_TYPES = {
    "int16": ModbusClientMixin.DATATYPE.INT16,
    "uint16": ModbusClientMixin.DATATYPE.UINT16,
    "int32": ModbusClientMixin.DATATYPE.INT32,
    "uint32": ModbusClientMixin.DATATYPE.UINT32,
    "float32": ModbusClientMixin.DATATYPE.FLOAT32,
}
_RANGES = {
    "int16": (-0x8000, 0x7FFF),
    "uint16": (0, 0xFFFF),
    "int32": (-0x8000_0000, 0x7FFF_FFFF),
    "uint32": (0, 0xFFFF_FFFF),
    "float32": (-3.4028234663852886e38, 3.4028234663852886e38),
}


class Register(NamedTuple):
    """One quantity of the device: one register, or two of a 32-bit type.

    name     key below ``registers`` in the config
    address  of its first register, from 0
    type     int16, uint16, int32, uint32, float32
    """

    name: str
    address: int
    type: str = "uint16"
    table: Table = "holding"
    low_first: bool = False

    @property
    def words(self) -> int:
        """Registers that it takes."""
        return _TYPES[self.type].value[1]

    @property
    def is_whole(self) -> bool:
        """Whether it holds whole numbers only."""
        return self.type != "float32"

    def pack(self, value: float) -> list[int]:
        """Its words for a value; a whole-number type takes the nearest. Raises ValueError where it cannot hold it."""
        low, high = _RANGES[self.type]
        held = round(value) if self.is_whole and math.isfinite(value) else value
        if not low <= held <= high:
            raise ValueError(f"{self} is {self.type} and cannot hold {value:g}")
        return ModbusClientMixin.convert_to_registers(held, _TYPES[self.type], "little" if self.low_first else "big")

    def unpack(self, words: Sequence[int]) -> float:
        """The value of its words; float32 may be infinite or nan. Raises ValueError for another number of words."""
        value = ModbusClientMixin.convert_from_registers(
            words, _TYPES[self.type], "little" if self.low_first else "big"
        )
        if not isinstance(value, int | float):
            raise ValueError(f"{len(words)} words are no {self.type}")
        return value

    def __str__(self) -> str:
        """As a fault names it: position, holding register 16."""
        last = self.address + self.words - 1
        where = f"register {self.address}" if self.words == 1 else f"registers {self.address} and {last}"
        return f"{self.name}, {self.table} {where}"


@dataclass(frozen=True)
class RegisterSpan:
    """Registers that one request takes, gaps included."""

    registers: tuple[Register, ...]

    @cached_property  # asked for in every tick
    def address(self) -> int:
        """The first."""
        return min(r.address for r in self.registers)

    @cached_property
    def words(self) -> int:
        """How many."""
        return max(r.address + r.words for r in self.registers) - self.address

    def values(self, words: Sequence[int]) -> dict[str, float]:
        """What they hold, by name."""
        first = self.address
        return {r.name: r.unpack(words[r.address - first : r.address - first + r.words]) for r in self.registers}

    def pack(self, values: Mapping[str, float]) -> list[int]:
        """Words for values by name; raises ValueError where a register cannot hold its value."""
        words = [0] * self.words
        for r in self.registers:
            at = r.address - self.address
            words[at : at + r.words] = r.pack(values[r.name])
        return words

    def __str__(self) -> str:
        """As a fault names it: the first register's name, then those beside it."""
        return self._text

    @cached_property
    def _text(self) -> str:
        one = str(self.registers[0])
        others = [f"{r.name} {r.address}" for r in self.registers[1:]]
        return f"{one}" + (f" (with {', '.join(others)})" if others else "")


@dataclass(frozen=True)
class RegisterMap:
    """What is at which address; None where the device has no such register.

    full                  value of the drive at full duty
    scale, offset_counts  counts = scale x position + offset_counts
    arm, stop             values of ``control``
    unit_s                of ``watchdog``
    device_watchdog_s     output time-out that is set on the device itself, where no register sets it
    faults                code of a fault by the value of ``status``
    """

    drive: Register
    position: Register
    full: float
    scale: float = 1.0
    offset_counts: float = 0.0
    sequence: Register | None = None
    echo: Register | None = None
    applied: Register | None = None
    status: Register | None = None
    control: Register | None = None
    watchdog: Register | None = None
    limits: tuple[Register, Register] | None = None
    rails: tuple[Register, Register] | None = None
    max_drive: Register | None = None
    arm: int = 1
    stop: int = 0
    unit_s: float = 0.001
    device_watchdog_s: float | None = None
    faults: Mapping[int, str] | None = None

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
    def written(self) -> RegisterSpan:
        """What goes out with each drive."""
        return RegisterSpan((self.drive,) if self.sequence is None else (self.drive, self.sequence))

    @property
    def read(self) -> RegisterSpan:
        """What comes back in each tick."""
        others = (self.echo, self.applied, self.status)
        return RegisterSpan((self.position, *(r for r in others if r is not None)))

    @property
    def full_units(self) -> int:
        """Drive units at full duty."""
        return round(self.full) if self.drive.is_whole else FLOAT_STEPS

    def drive_value(self, units: float) -> float:
        """Value of a register that holds a drive of so many drive units."""
        return units * self.full / self.full_units

    def drive_units(self, value: float) -> int:
        """Drive units nearest to a register's ``value``. Raises ValueError beyond full duty, or for nan."""
        if not abs(value) <= self.full * (1.0 + 1e-6):
            raise ValueError(f"{value:g} is beyond the full duty of {self.full:g}")
        return round(value * self.full_units / self.full)

    def counts(self, position: float) -> int:
        """Raw reading for a value of the register ``position``. Raises ValueError if it is not finite."""
        if not math.isfinite(position):
            raise ValueError(f"{position} is no position")
        return round(self.scale * position + self.offset_counts)

    def position_value(self, counts: float) -> float:
        """Value of the position's register for a raw reading of ``counts``, not rounded."""
        return (counts - self.offset_counts) / self.scale
