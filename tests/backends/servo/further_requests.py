"""Requests of both protocols that no host of rig sends, and that its emulated servos understand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.dynamixel import BROADCAST, Frame, Instruction
from rig.backends.servo.packets import one_id

Keep = Literal["nothing", "id", "id and baud"]
KEEP: Mapping[Keep, int] = {"nothing": 0xFF, "id": 0x01, "id and baud": 0x02}


def reset(id: int) -> bytes:
    """Feetech: put every register back to how it was shipped, but the id."""
    return feetech.Frame(id, feetech.Instruction.RESET).encode()


def factory_reset(id: int, keep: Keep) -> bytes:
    """Put every register back to how it was shipped, but what ``keep`` says."""
    return Frame(id, Instruction.FACTORY_RESET, bytes((KEEP[keep],))).encode()


def fast_sync_read(address: int, length: int, ids: Iterable[int]) -> bytes:
    """The same, with one answer for all (``fast_statuses``)."""
    return dynamixel.sync_read(address, length, ids, Instruction.FAST_SYNC_READ)


def bulk_read(spans: Mapping[int, tuple[int, int]]) -> bytes:
    """Ask several servos each for an address and a length; each answers for itself, in this order."""
    return _bulk(Instruction.BULK_READ, spans)


def fast_bulk_read(spans: Mapping[int, tuple[int, int]]) -> bytes:
    """The same, with one answer for all (``fast_statuses``)."""
    return _bulk(Instruction.FAST_BULK_READ, spans)


def bulk_write(data: Mapping[int, tuple[int, bytes]]) -> bytes:
    """Write to several servos, by id, each an address and bytes; none answers. Raises ValueError for no servo."""
    parameters = b"".join(
        bytes((one_id(id),)) + number(address) + number(len(values)) + values for id, (address, values) in data.items()
    )
    if not parameters:
        raise ValueError("a bulk write to no servo")
    return Frame(BROADCAST, Instruction.BULK_WRITE, parameters).encode()


def _bulk(instruction: Instruction, spans: Mapping[int, tuple[int, int]]) -> bytes:
    parameters = b"".join(
        bytes((one_id(id),)) + number(address) + number(length) for id, (address, length) in spans.items()
    )
    if not parameters:
        raise ValueError("a bulk read of no servo")
    return Frame(BROADCAST, instruction, parameters).encode()


def number(value: int) -> bytes:
    """An address or a length. Raises OverflowError where it does not fit."""
    return value.to_bytes(2, "little")
