"""One register of a servo: where it is, what it holds, what may be written."""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

from rig.backends.servo import feetech

Kind = Literal["uint8", "int8", "uint16", "int16", "uint32", "int32", "sign10", "sign11", "sign15"]
Access = Literal["r", "rw"]


class _Held(NamedTuple):
    """What a kind holds: its bytes; the bit that says negative; smallest and largest number."""

    size: int
    sign_bit: int | None
    least: int
    most: int


def _held(kind: Kind) -> _Held:
    if kind.startswith("sign"):
        bit = int(kind[4:])
        return _Held(2, bit, 1 - (1 << bit), (1 << bit) - 1)
    bits = int(kind.removeprefix("u")[3:])
    least = 0 if kind.startswith("u") else -(1 << bits - 1)
    return _Held(bits // 8, None, least, (1 << bits) - 1 + least)


_HELD: dict[Kind, _Held] = {kind: _held(kind) for kind in get_args(Kind)}


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
        return _HELD[self.kind].size

    @property
    def end(self) -> int:
        """Address behind its last byte."""
        return self.address + self.size

    @property
    def sign_bit(self) -> int | None:
        """The bit that says negative, where it is magnitude and bit."""
        return _HELD[self.kind].sign_bit

    @property
    def least(self) -> int:
        """Smallest number that its kind holds."""
        return _HELD[self.kind].least

    @property
    def most(self) -> int:
        """Largest number that its kind holds."""
        return _HELD[self.kind].most

    def pack(self, value: int) -> bytes:
        """Its bytes for a value. Raises ValueError where its kind cannot hold it."""
        size, sign_bit, least, most = _HELD[self.kind]
        if not least <= value <= most:
            raise ValueError(f"{self} cannot hold {value}: {least} to {most}")
        held = value if sign_bit is None else feetech.magnitude(value, sign_bit)
        return held.to_bytes(size, "little", signed=held < 0)

    def unpack(self, data: bytes) -> int:
        """The value of its bytes. Raises ValueError for another number of bytes, and for bits above its sign."""
        size, sign_bit, least, _ = _HELD[self.kind]
        if len(data) != size:
            raise ValueError(f"{self} has {size} bytes, not {len(data)}")
        if sign_bit is not None:
            return feetech.signed(int.from_bytes(data, "little"), sign_bit)
        return int.from_bytes(data, "little", signed=least < 0)

    def __str__(self) -> str:
        """As a message names it: goal_pwm (register 100)."""
        return f"{self.name} (register {self.address})"
