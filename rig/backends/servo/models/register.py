"""One register of a servo: where it is, what it holds, what may be written."""

from __future__ import annotations

from typing import Literal, NamedTuple

from rig.backends.servo import feetech

Kind = Literal["uint8", "int8", "uint16", "int16", "uint32", "int32", "sign10", "sign11", "sign15"]
Access = Literal["r", "rw"]

_SIZES: dict[str, int] = {"uint8": 1, "int8": 1, "uint32": 4, "int32": 4}  # every other has two bytes


class Register(NamedTuple):
    """One quantity of a servo; bytes low first.

    name     as its manual calls it
    address  of its first byte
    kind     two's complement or none; sign10 to sign15: two bytes, a magnitude and that bit where it is negative
    access   r: read only
    shipped  value as the servo comes; None: no manual says, or it is not the same in all
    unit, scale   of one step: rad, rad/s, rad/s2, V, V/s, A, s, degC, baud's index is ""; "1" is a part of the whole
    low, high     smallest and largest value that may be written; None: no bound is known, or other registers set it
    """

    name: str
    address: int
    kind: Kind = "uint8"
    access: Access = "rw"
    shipped: int | None = None
    unit: str = ""
    scale: float = 1.0
    low: int | None = None
    high: int | None = None

    @property
    def size(self) -> int:
        """Its bytes."""
        return _SIZES.get(self.kind, 2)

    @property
    def end(self) -> int:
        """Address behind its last byte."""
        return self.address + self.size

    @property
    def sign_bit(self) -> int | None:
        """The bit that says negative, where it is magnitude and bit."""
        return int(self.kind[4:]) if self.kind.startswith("sign") else None

    @property
    def least(self) -> int:
        """Smallest number that its kind holds."""
        if self.sign_bit is not None:
            return 1 - (1 << self.sign_bit)
        return -(1 << 8 * self.size - 1) if self.kind.startswith("int") else 0

    @property
    def most(self) -> int:
        """Largest number that its kind holds."""
        if self.sign_bit is not None:
            return (1 << self.sign_bit) - 1
        return (1 << 8 * self.size - self.kind.startswith("int")) - 1

    def pack(self, value: int) -> bytes:
        """Its bytes for a value. Raises ValueError where its kind cannot hold it."""
        if not self.least <= value <= self.most:
            raise ValueError(f"{self} cannot hold {value}: {self.least} to {self.most}")
        if self.sign_bit is not None:
            return feetech.magnitude(value, self.sign_bit).to_bytes(2, "little")
        return value.to_bytes(self.size, "little", signed=self.kind.startswith("int"))

    def unpack(self, data: bytes) -> int:
        """The value of its bytes. Raises ValueError for another number of bytes, and for bits above its sign."""
        if len(data) != self.size:
            raise ValueError(f"{self} has {self.size} bytes, not {len(data)}")
        if self.sign_bit is not None:
            return feetech.signed(int.from_bytes(data, "little"), self.sign_bit)
        return int.from_bytes(data, "little", signed=self.kind.startswith("int"))

    def __str__(self) -> str:
        """As a message names it: goal_pwm (register 100)."""
        return f"{self.name} (register {self.address})"
