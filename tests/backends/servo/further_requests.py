"""Requests of both protocols that no host of rig sends, and that its emulated servos understand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.dynamixel import ALERT, BROADCAST, Frame, Instruction, Status, crc16
from rig.backends.servo.packets import one_id

Keep = Literal["nothing", "id", "id and baud"]
KEEP: Mapping[Keep, int] = {"nothing": 0xFF, "id": 0x01, "id and baud": 0x02}


def reg_write(codec: Any, id: int, address: int, data: bytes) -> bytes:
    """Have bytes written at the next action."""
    return _packet(codec, id, Instruction.REG_WRITE, _short(codec, address) + data)


def action(codec: Any, id: int = BROADCAST) -> bytes:
    """Do what was registered."""
    return _packet(codec, id, Instruction.ACTION)


def sync_read(codec: Any, address: int, length: int, ids: Iterable[int]) -> bytes:
    """Ask several servos for the same registers; each answers for itself, in this order."""
    return _packet(codec, BROADCAST, Instruction.SYNC_READ, _short(codec, address) + _short(codec, length) + bytes(ids))


def sync_write(codec: Any, address: int, data: Mapping[int, bytes]) -> bytes:
    """Write the same registers of several servos, by id; none answers."""
    (length,) = {len(values) for values in data.values()}
    each = b"".join(bytes((id,)) + values for id, values in data.items())
    return _packet(codec, BROADCAST, Instruction.SYNC_WRITE, _short(codec, address) + _short(codec, length) + each)


def _packet(codec: Any, id: int, code: int, parameters: bytes = b"") -> bytes:
    packet: bytes = codec.Frame(id, code, parameters).encode()
    return packet


def _short(codec: Any, value: int) -> bytes:
    return value.to_bytes(1 if codec is feetech else 2, "little")


def clear_turns(id: int) -> bytes:
    """Have the position fall back into one turn; only at rest."""
    return Frame(id, Instruction.CLEAR, dynamixel.CLEAR_TURNS).encode()


def reset(id: int) -> bytes:
    """Feetech: put every register back to how it was shipped, but the id."""
    return feetech.Frame(id, feetech.Instruction.RESET).encode()


def factory_reset(id: int, keep: Keep) -> bytes:
    """Put every register back to how it was shipped, but what ``keep`` says."""
    return Frame(id, Instruction.FACTORY_RESET, bytes((KEEP[keep],))).encode()


def fast_sync_read(address: int, length: int, ids: Iterable[int]) -> bytes:
    """The same, with one answer for all (``fast_statuses``)."""
    return Frame(BROADCAST, Instruction.FAST_SYNC_READ, number(address) + number(length) + bytes(ids)).encode()


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


def fast_statuses(frame: Frame, lengths: Mapping[int, int]) -> list[Status]:
    """The answers in the one packet that a fast read brings: error, id, data and CRC of each servo, in a row.

    lengths  bytes of data by id, in the order of the request
    Each CRC covers the packet from its header to its place; the last is that of the packet.
    """
    assert frame.id == BROADCAST and frame.is_status
    whole, out, at = frame.encode(), [], 8
    assert len(frame.parameters) == sum(lengths.values()) + 4 * len(lengths) - 2
    for id, length in lengths.items():
        error, end = whole[at], at + 2 + length
        assert whole[at + 1] == id
        assert crc16(whole[:end]).to_bytes(2, "little") == whole[end : end + 2]
        out.append(Status(id, error & ~ALERT, bool(error & ALERT), whole[at + 2 : end]))
        at = end + 2
    return out
