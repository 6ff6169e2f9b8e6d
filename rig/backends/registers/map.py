"""The registers of a device on a bus: what is at which address, of which type, in which cells.

A cell is what one address holds: 16 bits on Modbus, a byte on a servo's bus.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

OFF, ARMED = 0, 1  # of the status register; anything else is a fault
FLOAT_STEPS = 10000  # drive units at full duty where the register is no whole number

_LETTERS = {"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}
_BYTES = {kind: struct.calcsize(f">{letter}") for kind, letter in _LETTERS.items()}
_LARGEST_FLOAT = 3.4028234663852886e38


class Register(NamedTuple):
    """One quantity of the device: one cell or more.

    name        key below ``registers`` in the config, or as the device's manual calls it
    address     of its first cell, from 0
    type        int8, uint8, int16, uint16, int32, uint32, float32
    table       of Modbus: holding or input
    low_first   the low cell comes first; within a cell of two bytes the high byte always does
    cell_bytes  bytes of a cell
    sign_bit    bit that makes the value negative, the bits below hold its size; None: two's complement
    """

    name: str
    address: int
    type: str = "uint16"
    table: str = "holding"
    low_first: bool = False
    cell_bytes: int = 2
    sign_bit: int | None = None

    @property
    def words(self) -> int:
        """Cells that it takes."""
        return _BYTES[self.type] // self.cell_bytes

    @property
    def is_whole(self) -> bool:
        """Whether it holds whole numbers only."""
        return self.type != "float32"

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest value that it holds."""
        bits = 8 * _BYTES[self.type]
        if not self.is_whole:
            return -_LARGEST_FLOAT, _LARGEST_FLOAT
        if self.sign_bit is not None:
            return 1 - (1 << self.sign_bit), (1 << self.sign_bit) - 1
        return (0, (1 << bits) - 1) if self.type.startswith("u") else (-(1 << bits - 1), (1 << bits - 1) - 1)

    def pack(self, value: float) -> list[int]:
        """Its cells for a value; a whole-number type takes the nearest. Raises ValueError where it cannot hold it."""
        low, high = self.range
        held = round(value) if self.is_whole and math.isfinite(value) else value
        if not low <= held <= high:
            raise ValueError(f"{self} is {self._kind} and cannot hold {value:g}")
        if self.sign_bit is not None:
            held = abs(int(held)) | (int(held < 0) << self.sign_bit)
        data = struct.pack(f">{_LETTERS[self.type]}", held)
        cells = [int.from_bytes(data[k : k + self.cell_bytes], "big") for k in range(0, len(data), self.cell_bytes)]
        return cells[::-1] if self.low_first else cells

    def unpack(self, words: Sequence[int]) -> float:
        """The value of its cells; float32 may be infinite or nan. Raises ValueError for another number of cells."""
        if len(words) != self.words:
            raise ValueError(f"{len(words)} words are no {self._kind}")
        cells = words[::-1] if self.low_first else words
        data = b"".join(cell.to_bytes(self.cell_bytes, "big") for cell in cells)
        value: int | float = struct.unpack(f">{_LETTERS[self.type]}", data)[0]
        return self.signed(value)

    def signed(self, raw: float) -> float:
        """The value of ``raw``, what its type holds, where a bit is the sign; both in the register's steps.

        Raises ValueError for bits above it.
        """
        if self.sign_bit is None:
            return raw
        if int(raw) >> self.sign_bit > 1:
            raise ValueError(f"{self} holds {int(raw):#x}, with bits above its sign")
        size = int(raw) & ((1 << self.sign_bit) - 1)
        return -size if int(raw) >> self.sign_bit & 1 else size

    @property
    def _kind(self) -> str:
        return self.type if self.sign_bit is None else f"{self.type} with its sign in bit {self.sign_bit}"

    def __str__(self) -> str:
        """As a fault names it: position, holding register 16."""
        last = self.address + self.words - 1
        if self.cell_bytes == 1:
            return f"{self.name}, address {self.address}"
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
        """How many cells."""
        return max(r.address + r.words for r in self.registers) - self.address

    def values(self, words: Sequence[int]) -> dict[str, float]:
        """What they hold, by name. Raises ValueError for another number of cells, and as ``Register.unpack``."""
        if self._bytes is not None:
            return dict(zip(self.names, self.numbers(bytes(words)), strict=True))
        first = self.address
        return {r.name: r.unpack(words[r.address - first : r.address - first + r.words]) for r in self.registers}

    def numbers(self, data: bytes) -> Sequence[int]:
        """What they hold in the order of ``names``, where each cell is a byte. Raises ValueError as ``values``."""
        assert self._bytes is not None
        form, signed = self._bytes
        if len(data) != form.size:
            raise ValueError(f"{len(data)} bytes where {self} has {form.size}")
        if not signed:
            return form.unpack(data)
        held = list(form.unpack(data))
        for place, below, r in signed:
            if held[place] >= below:
                held[place] = r.signed(held[place])
        return held

    @cached_property
    def names(self) -> tuple[str, ...]:
        """In the order of addresses."""
        return tuple(r.name for r in self._in_order)

    @cached_property
    def _in_order(self) -> tuple[Register, ...]:
        return tuple(sorted(self.registers, key=lambda r: r.address))

    @cached_property
    def _bytes(self) -> tuple[struct.Struct, tuple[tuple[int, int, Register], ...]] | None:
        """How all of it lies in bytes, low first: taken apart at once in each tick. None where cells are no bytes.

        Also of those with a sign bit place and least raw value that has bits from it on.
        """
        if not all(r.cell_bytes == 1 and r.low_first for r in self.registers):
            return None
        form, at = "<", self.address
        for r in self._in_order:
            form += f"{r.address - at}x{_LETTERS[r.type]}"
            at = r.address + r.words
        signed = tuple((k, 1 << r.sign_bit, r) for k, r in enumerate(self._in_order) if r.sign_bit is not None)
        return struct.Struct(form), signed

    def pack(self, values: Mapping[str, float]) -> list[int]:
        """Cells for values by name; raises ValueError where a register cannot hold its value."""
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
    faults                code of a fault by the value of ``status``
    """

    drive: Register
    position: Register
    full: float
    scale: float = 1.0
    offset_counts: float = 0.0
    applied: Register | None = None
    status: Register | None = None
    control: Register | None = None
    watchdog: Register | None = None
    max_drive: Register | None = None
    arm: int = 1
    stop: int = 0
    unit_s: float = 0.001
    faults: Mapping[int, str] | None = None

    @property
    def written(self) -> RegisterSpan:
        """What goes out with each drive."""
        return RegisterSpan((self.drive,))

    @property
    def read(self) -> RegisterSpan:
        """What comes back in each tick."""
        return RegisterSpan((self.position, *(r for r in (self.applied, self.status) if r is not None)))

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
