"""The registers of the emulated I/O block: what is at which address, of which type; its words and its status values.

Block and driver share what the config says, parsed. The block packs its registers by itself, with no code of the
driver's, so that each side tests the other.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from rig.backends.modbus.registers import Register, RegisterMap, Table

STATUS_OF_FAULT = {
    "DEVICE_WATCHDOG": 2,
    "DEVICE_TRAVEL": 3,
    "DEVICE_SENSOR": 4,
    "DEVICE_DRIVE_RANGE": 5,
    "DEVICE_NOT_ARMED": 6,
    "DEVICE_ESTOP": 7,
}

_FORMAT = {"int16": ">h", "uint16": ">H", "int32": ">i", "uint32": ">I", "float32": ">f"}
RANGES = {"int16": (-0x8000, 0x7FFF), "uint16": (0, 0xFFFF), "int32": (-(2**31), 2**31 - 1), "uint32": (0, 2**32 - 1)}


class Field(NamedTuple):
    """One register, or two of a 32-bit type: its name, address and type."""

    name: str
    address: int
    type: str = "uint16"

    @property
    def words(self) -> int:
        """Registers that it takes."""
        return struct.calcsize(_FORMAT[self.type]) // 2

    def pack(self, value: float, low_first: bool) -> list[int]:
        """Its words for a value; whole-number types take the nearest."""
        data = struct.pack(_FORMAT[self.type], value if self.type == "float32" else round(value))
        words = [int.from_bytes(data[k : k + 2], "big") for k in range(0, len(data), 2)]
        return words[::-1] if low_first else words

    def unpack(self, words: list[int], low_first: bool) -> float:
        """The value of its words."""
        data = b"".join(word.to_bytes(2, "big") for word in (words[::-1] if low_first else words))
        return float(struct.unpack(_FORMAT[self.type], data)[0])


@dataclass(frozen=True)
class BlockRegisters(RegisterMap):
    """What is at which address, with the block's own fields."""

    @cached_property
    def writable(self) -> tuple[Field, ...]:
        """Fields that are written."""
        return _fields(*self.written.registers, *self.set_when_armed)

    @cached_property
    def readable(self) -> Mapping[Table, tuple[Field, ...]]:
        """Fields that are read, by table; written ones can be read back from the holding table."""
        seen, holding = _fields(*self.read.registers), self.position.table == "holding"
        return {"holding": (*self.writable, *seen) if holding else self.writable, "input": () if holding else seen}

    @cached_property
    def status_of(self) -> Mapping[str, int]:
        """Value of the status register for each fault."""
        return _statuses({code: value for value, code in (self.faults or {}).items()})

    def has(self, name: str) -> bool:
        """Whether there is such a field."""
        return any(f.name == name for fields in self.readable.values() for f in fields)


def _fields(*registers: Register) -> tuple[Field, ...]:
    return tuple(Field(r.name, r.address, r.type) for r in registers)


def _statuses(named: Mapping[str, int]) -> dict[str, int]:
    """A value for each fault: as named, else the usual one, or the next that is free."""
    statuses = dict(named)
    for fault, value in STATUS_OF_FAULT.items():
        if fault not in statuses:
            while value in statuses.values():
                value += 1
            statuses[fault] = value
    return statuses
