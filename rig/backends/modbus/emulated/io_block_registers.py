"""The registers of the emulated I/O block: what is at which address, of which type; its words and its status values.

What a register means is the config's section ``daq.modbus``. The block packs its registers by itself, with no code of
the driver's, so that each side tests the other.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Self

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

Table = Literal["holding", "input"]


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
class RegisterMap:
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
    def from_mapping(cls, modbus: Mapping[str, Any]) -> Self:
        """From the plain values of the config's section ``daq.modbus``."""
        r = modbus["registers"]
        drive, position, table = r["drive"], r["position"], r["position"]["table"]
        written = [Field("drive", drive["address"], drive["type"])]
        seen = [Field("position", position["address"], position["type"])]
        if r["sequence"] is not None:
            written.append(Field("sequence", r["sequence"]["address"]))
            seen.append(Field("echo", r["sequence"]["echo"]))
        if r["applied"] is not None:
            seen.append(Field("applied", r["applied"]["address"], r["applied"]["type"]))
        if r["status"] is not None:
            seen.append(Field("status", r["status"]["address"]))
        if r["control"] is not None:
            written.append(Field("control", r["control"]["address"]))
        if r["watchdog"] is not None:
            written.append(Field("watchdog", r["watchdog"]["address"]))
        for pair in ("limits", "rails"):
            if r[pair] is not None:
                written += [Field(f"{pair}.{end}", r[pair][end], position["type"]) for end in ("low", "high")]
        if r["max_drive"] is not None:
            written.append(Field("max_drive", r["max_drive"]["address"], drive["type"]))
        readable: dict[Table, tuple[Field, ...]] = {
            "holding": (*written, *seen) if table == "holding" else tuple(written),
            "input": tuple(seen) if table == "input" else (),
        }
        return cls(
            readable=readable,
            writable=tuple(written),
            low_first=modbus["word_order"] == "low-first",
            full=drive["full"],
            scale=position["scale"],
            offset_counts=position["offset_counts"],
            arm=r["control"]["arm"] if r["control"] is not None else 1,
            stop=r["control"]["stop"] if r["control"] is not None else 0,
            unit_s=r["watchdog"]["unit_s"] if r["watchdog"] is not None else 0.001,
            status_of=_statuses({} if r["status"] is None else r["status"]["faults"]),
            watchdog_s=modbus["device_watchdog_s"],
        )

    def has(self, name: str) -> bool:
        """Whether there is such a field."""
        return any(f.name == name for fields in self.readable.values() for f in fields)


def _statuses(named: Mapping[str, int]) -> dict[str, int]:
    """A value for each fault: as named, else the usual one, or the next that is free."""
    statuses = dict(named)
    for fault, value in STATUS_OF_FAULT.items():
        if fault not in statuses:
            while value in statuses.values():
                value += 1
            statuses[fault] = value
    return statuses
