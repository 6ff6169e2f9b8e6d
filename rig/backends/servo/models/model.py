"""One model of servo: its registers, and which of them does what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from rig.backends.servo.models.register import Register

Protocol = Literal["dynamixel", "feetech"]


@dataclass(frozen=True)
class ServoModel:
    """A model.

    name, family     as a config names it; as its maker groups it
    number           that its register model_number holds
    protocol         that it speaks
    registers        by name, in the order of their addresses
    roles            names of registers by what rig uses them for, the same words for both protocols
    eeprom_end       addresses below it are kept without supply
    full_drive       value of the drive's register at full duty
    pwm_mode         value of the mode's register in which the drive's register is the duty
    position_mode    in which it holds a position by itself, within one turn
    counts_per_turn  of the position
    bauds            by the value of the baud's register, as far as all sources agree
    supply_V         lowest and highest that its voltage limits can be set to, V
    """

    name: str
    family: str
    number: int
    protocol: Protocol
    registers: Mapping[str, Register]
    roles: Mapping[str, str]
    eeprom_end: int
    full_drive: int
    pwm_mode: int
    position_mode: int
    counts_per_turn: int
    bauds: Mapping[int, int]
    supply_V: tuple[float, float]

    def __getitem__(self, name: str) -> Register:
        """The register of that name. Raises KeyError where it has none."""
        return self.registers[name]

    def has(self, name: str) -> bool:
        """Whether it has a register of that name."""
        return name in self.registers

    def role(self, role: str) -> Register:
        """The register that rig uses for that. Raises KeyError where it has none."""
        return self.registers[self.roles[role]]

    def is_eeprom(self, register: Register) -> bool:
        """Whether what is written there is kept without supply, and wears it out."""
        return register.address < self.eeprom_end

    def at(self, address: int) -> Register | None:
        """The register that has this address among its bytes; None in a gap."""
        return self._by_byte.get(address)

    @cached_property
    def _by_byte(self) -> Mapping[int, Register]:
        return {at: r for r in self.registers.values() for at in range(r.address, r.end)}

    @cached_property
    def end(self) -> int:
        """Address behind its last register."""
        return max(r.end for r in self.registers.values())

    def unpack(self, data: bytes, address: int) -> dict[str, int]:
        """Values by name of all registers wholly in bytes from ``address`` on. Raises ValueError as Register."""
        end = address + len(data)
        return {
            r.name: r.unpack(data[r.address - address : r.end - address])
            for r in self.registers.values()
            if address <= r.address and r.end <= end
        }
