"""How emulated servos hear the packets of a host, and what they answer to them, in which order. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

from rig.backends.servo import dynamixel, feetech
from rig.backends.servo.emulated.dynamixel_servo import DynamixelServo
from rig.backends.servo.emulated.faults import ReplyFault
from rig.backends.servo.emulated.feetech_servo import FeetechServo
from rig.backends.servo.emulated.servo import EmulatedServo
from rig.backends.servo.packets import BROADCAST

S = TypeVar("S", dynamixel.Status, feetech.Status)


class Answer(NamedTuple):
    """What a servo puts on the wire, and how long after the packet before it."""

    servo: EmulatedServo
    data: bytes
    delay_s: float


class Dynamixels:
    """How Dynamixels hear and answer."""

    def __init__(self) -> None:
        self.stream = dynamixel.Stream()

    def hear(self, frame: dynamixel.Frame, servos: Sequence[DynamixelServo], fault: ReplyFault | None) -> list[Answer]:
        """What the servos that are at the line's baud do with a packet, and answer."""
        if frame.is_status:
            return []
        named = named_by_dynamixel(frame) or {frame.id}
        for_it = {s.id: s.id in named or BROADCAST in named for s in servos}
        hearing = [s for s in servos if s.answers and not (for_it[s.id] and _is_deaf(s, fault))]
        for servo in hearing:
            servo.heard(is_own=for_it[servo.id])
        by_id = {s.id: s for s in hearing}
        if frame.id != BROADCAST:
            for servo in hearing:
                if servo.shadow_id == frame.id != servo.id:
                    servo.obey_shadow(frame)
            called = [s for s in hearing if s.id == frame.id]
            return _answered([(s, s.instruct(frame)) for s in called], fault, _dynamixel_wire)
        return self._to_all(frame, by_id, hearing, fault)

    def _to_all(
        self,
        frame: dynamixel.Frame,
        by_id: dict[int, DynamixelServo],
        hearing: list[DynamixelServo],
        fault: ReplyFault | None,
    ) -> list[Answer]:
        kind = dynamixel.Instruction
        if frame.instruction in (kind.SYNC_WRITE, kind.BULK_WRITE):
            for id, address, data in _written(frame):
                for servo in hearing:
                    if servo.id == id:
                        servo.write(address, data)
                    elif servo.shadow_id == id:
                        servo.write(address, data, is_shadow=True)
            return []
        if frame.instruction in (kind.SYNC_READ, kind.BULK_READ, kind.FAST_SYNC_READ, kind.FAST_BULK_READ):
            statuses: list[dynamixel.Status] = []
            spans = _read(frame)
            for id, address, length in spans:
                if id not in by_id or by_id[id].is_mute or by_id[id].value("status_return_level") < 1:
                    break
                statuses.append(by_id[id].read(address, length))
            if frame.instruction in (kind.SYNC_READ, kind.BULK_READ):
                return _answered([(by_id[s.id], s) for s in statuses], fault, _dynamixel_wire)
            return self._fast(statuses, spans, by_id, fault)
        if frame.instruction == kind.PING:
            return _answered(
                [(s, s.instruct(frame)) for s in sorted(hearing, key=lambda s: s.id)], fault, _dynamixel_wire
            )
        for servo in hearing:
            servo.instruct(frame)
        return []

    def _fast(
        self,
        statuses: list[dynamixel.Status],
        spans: list[tuple[int, int, int]],
        by_id: dict[int, DynamixelServo],
        fault: ReplyFault | None,
    ) -> list[Answer]:
        """One packet that each writes a part of: where one is missing it ends there, and is not whole."""
        if not statuses or sum(n + 4 for _, _, n in spans) + 8 > dynamixel.LONGEST:
            return []
        parts = [
            s._replace(data=s.data.ljust(length, b"\0")) for s, (_, _, length) in zip(statuses, spans, strict=False)
        ]
        missing = spans[len(parts) :]
        packet = dynamixel.fast_status([*parts, *(dynamixel.Status(0, 0, False, bytes(n)) for _, _, n in missing)])
        lost = sum(n + 4 for _, _, n in missing)
        first = by_id[statuses[0].id]
        if fault is not None and fault.kind == "lost" and any(fault.strikes(by_id[s.id]) for s in statuses):
            return []
        return [Answer(first, packet[: len(packet) - lost], first.return_delay_s)]


class Feetechs:
    """How Feetech's servos hear and answer."""

    def __init__(self) -> None:
        self.stream = feetech.Stream()

    def hear(self, frame: feetech.Frame, servos: Sequence[FeetechServo], fault: ReplyFault | None) -> list[Answer]:
        """What the servos that are at the line's baud do with a packet, and answer."""
        named = named_by_feetech(frame)
        for_it = {s.id: s.id in named or BROADCAST in named for s in servos}
        hearing = [s for s in servos if s.answers and not (for_it[s.id] and _is_deaf(s, fault))]
        by_id = {s.id: s for s in hearing}
        kind, parameters = feetech.Instruction, frame.parameters
        if frame.id != BROADCAST:
            called = [s for s in hearing if s.id == frame.id]
            return _answered([(s, s.instruct(frame)) for s in called], fault, _feetech_wire)
        if frame.code == kind.SYNC_WRITE and len(parameters) > 2:
            address, length = parameters[:2]
            for at in range(2, len(parameters) - length, length + 1):
                if parameters[at] in by_id:
                    by_id[parameters[at]].write(address, parameters[at + 1 : at + 1 + length])
            return []
        if frame.code == kind.SYNC_READ and len(parameters) > 2 and parameters[1] <= feetech.LONGEST - 6:
            statuses = []
            for id in parameters[2:]:
                if id not in by_id or by_id[id].is_mute:
                    break
                statuses.append(by_id[id].read(*parameters[:2]))
            return _answered([(by_id[s.id], s) for s in statuses], fault, _feetech_wire)
        if frame.code not in (kind.PING, kind.READ):
            for servo in hearing:
                servo.instruct(frame)
        return []


def _dynamixel_wire(status: dynamixel.Status, is_alert: bool) -> bytes:
    return dynamixel.status(status.id, status.data, status.error, alert=status.alert or is_alert)


def _feetech_wire(status: feetech.Status, is_alert: bool) -> bytes:
    return feetech.status(status.id, status.data, sum(feetech.ERRORS) if is_alert else status.errors)


def _answered(
    statuses: Sequence[tuple[EmulatedServo, S | None]], fault: ReplyFault | None, wire: Callable[[S, bool], bytes]
) -> list[Answer]:
    """What goes out of these answers, with the fault of one servo's."""
    out = []
    for servo, status in statuses:
        if status is None or servo.is_mute:
            continue
        if fault is None or fault.kind == "deaf" or not fault.strikes(servo):
            out.append(Answer(servo, wire(status, False), servo.return_delay_s))
        elif fault.kind != "lost":
            id = fault.id if fault.kind == "id" else status.id
            data = status.data[:-1] if fault.kind == "short" else status.data
            spoilt = wire(status._replace(id=id, data=data), fault.kind == "alert")
            out.append(Answer(servo, spoilt, servo.return_delay_s + (fault.by_s if fault.kind == "late" else 0.0)))
    return out


def _is_deaf(servo: EmulatedServo, fault: ReplyFault | None) -> bool:
    return fault is not None and fault.kind == "deaf" and fault.strikes(servo)


def named_by_feetech(frame: feetech.Frame) -> set[int]:
    """Ids that a packet is for."""
    p, kind = frame.parameters, feetech.Instruction
    if frame.code == kind.SYNC_READ:
        return set(p[2:])
    if frame.code == kind.SYNC_WRITE and len(p) > 2:
        return set(p[2 :: p[1] + 1])
    return {frame.id}


def named_by_dynamixel(frame: dynamixel.Frame) -> set[int]:
    """Ids that a group instruction names."""
    kind = dynamixel.Instruction
    if frame.instruction in (kind.SYNC_WRITE, kind.BULK_WRITE):
        return {id for id, _, _ in _written(frame)}
    if frame.instruction in (kind.SYNC_READ, kind.BULK_READ, kind.FAST_SYNC_READ, kind.FAST_BULK_READ):
        return {id for id, _, _ in _read(frame)}
    return set()


def _word(data: bytes, at: int) -> int:
    return int.from_bytes(data[at : at + 2], "little")


def _written(frame: dynamixel.Frame) -> list[tuple[int, int, bytes]]:
    """Id, address and bytes of each write in a sync or bulk write; what is cut short is left out."""
    data, out = frame.parameters, []
    if frame.instruction == dynamixel.Instruction.SYNC_WRITE:
        length = _word(data, 2)
        for at in range(4, len(data) - length, length + 1):
            out.append((data[at], _word(data, 0), data[at + 1 : at + 1 + length]))
        return out
    at = 0
    while at + 5 < len(data):
        length = _word(data, at + 3)
        if at + 5 + length > len(data):
            break
        out.append((data[at], _word(data, at + 1), data[at + 5 : at + 5 + length]))
        at += 5 + length
    return out


def _read(frame: dynamixel.Frame) -> list[tuple[int, int, int]]:
    """Id, address and length of each read in a sync or bulk read."""
    data, kind = frame.parameters, dynamixel.Instruction
    if frame.instruction in (kind.SYNC_READ, kind.FAST_SYNC_READ):
        return [(id, _word(data, 0), _word(data, 2)) for id in data[4:]]
    return [(data[at], _word(data, at + 1), _word(data, at + 3)) for at in range(0, len(data) - 4, 5)]
