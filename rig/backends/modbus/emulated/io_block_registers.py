"""The registers of the emulated I/O block: what is at which address, of which type; its words and its status values.

Block and driver share what the config says, parsed. The block packs its registers by itself, with no code of the
driver's, so that each side tests the other.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Self

from rig.backends.modbus.registers import Register, RegisterMap, Table

if TYPE_CHECKING:  # the process of an emulated device starts without the config
    from rig.backends.modbus.section import Modbus

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
class BlockRegisters:
    """What is at which address.

    readable     fields that are read, by table; written ones can be read back from the holding table
    writable     fields that are written
    low_first    word order of 32-bit types
    full         value of the drive at full duty
    scale, offset_counts   counts = scale x value + offset_counts, of the position
    arm, stop    values of the control register
    unit_s       of the watchdog register
    status_of    value of the status register for each fault
    watchdog_s   the output's own time-out where no register sets it; None: it has none
    """

    readable: Mapping[Table, tuple[Field, ...]]
    writable: tuple[Field, ...]
    low_first: bool
    full: float
    scale: float
    offset_counts: float
    arm: int
    stop: int
    unit_s: float
    status_of: Mapping[str, int]
    watchdog_s: float | None

    @classmethod
    def of(cls, modbus: Modbus) -> Self:
        """As the section ``daq.modbus`` has it."""
        found = RegisterMap.of(modbus)
        pairs = [r for pair in (found.limits, found.rails) if pair is not None for r in pair]
        written = _fields(found.drive, found.sequence, found.control, found.watchdog, *pairs, found.max_drive)
        seen = _fields(found.position, found.echo, found.applied, found.status)
        holding = found.position.table == "holding"
        return cls(
            readable={"holding": (*written, *seen) if holding else written, "input": () if holding else seen},
            writable=written,
            low_first=found.drive.low_first,
            full=found.full,
            scale=found.scale,
            offset_counts=found.offset_counts,
            arm=found.arm,
            stop=found.stop,
            unit_s=found.unit_s,
            status_of=_statuses({code: value for value, code in (found.faults or {}).items()}),
            watchdog_s=found.device_watchdog_s,
        )

    def has(self, name: str) -> bool:
        """Whether there is such a field."""
        return any(f.name == name for fields in self.readable.values() for f in fields)


def _fields(*registers: Register | None) -> tuple[Field, ...]:
    return tuple(Field(r.name, r.address, r.type) for r in registers if r is not None)


def _statuses(named: Mapping[str, int]) -> dict[str, int]:
    """A value for each fault: as named, else the usual one, or the next that is free."""
    statuses = dict(named)
    for fault, value in STATUS_OF_FAULT.items():
        if fault not in statuses:
            while value in statuses.values():
                value += 1
            statuses[fault] = value
    return statuses
