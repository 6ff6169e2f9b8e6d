"""What a Modbus device is asked, and what its reply must say: requests and replies as bytes, no line.

Requests are packed and replies unpacked by pymodbus (Modbus Application Protocol 1.1b3).
"""

from __future__ import annotations

from typing import NamedTuple

from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest, ReadDeviceInformationResponse
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from rig.backends.modbus.frames import Frame, is_exception
from rig.backends.modbus.registers import Register, RegisterSpan
from rig.core.faults import Fault
from rig.core.signals import plain

_EXCEPTIONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledge",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not answer",
}


class Request(NamedTuple):
    """A request, and its subject in words, for a fault."""

    pdu: ModbusPDU
    about: str


def reading(span: RegisterSpan) -> Request:
    """FC03, or FC04 of input registers."""
    kind = ReadInputRegistersRequest if span.registers[0].table == "input" else ReadHoldingRegistersRequest
    return Request(kind(address=span.address, count=span.words), str(span))


def writing(what: Register | RegisterSpan, words: list[int]) -> Request:
    """FC06 of one register, FC16 of more."""
    if len(words) == 1:
        return Request(WriteSingleRegisterRequest(address=what.address, registers=words), str(what))
    return Request(WriteMultipleRegistersRequest(address=what.address, registers=words), str(what))


def reading_and_writing(read: RegisterSpan, written: RegisterSpan, words: list[int]) -> Request:
    """FC23: the device writes ``words``, then reads."""
    pdu = ReadWriteMultipleRegistersRequest(
        read_address=read.address,
        read_count=read.words,
        write_address=written.address,
        write_registers=words,
    )
    return Request(pdu, f"{written} and {read}")


def identification() -> Request:
    """FC43: ask for vendor, product and revision."""
    return Request(ReadDeviceInformationRequest(read_code=1, object_id=0), "identification")


def identity_of(pdu: bytes) -> tuple[str, str, str]:
    """Vendor, product and revision from the reply to ``identification``, printable; empty where they are missing."""
    response = ReadDeviceInformationResponse()
    try:
        response.decode(pdu[1:])
    except (ValueError, IndexError, OverflowError):
        return "", "", ""
    texts = (response.information.get(k, b"") for k in range(3))
    vendor, product, revision = (
        plain(text.decode("ascii", "replace")) if isinstance(text, bytes) else "" for text in texts
    )
    return vendor, product, revision


def registers_of(pdu: bytes) -> list[int]:
    """Registers of a reply that ``check`` has accepted."""
    reply = ReadHoldingRegistersResponse()
    reply.decode(pdu[1:])
    return list(reply.registers)


def check(frame: Frame, request: Request, unit: int, number: int) -> None:
    """Check that a frame is the reply to a request.

    unit    unit id that was asked
    number  number of the request (TCP)
    Raises Fault LINK_REPLY, LINK_UNIT, MODBUS_EXCEPTION.
    """
    asked, about = request
    if frame.number is not None and frame.number != number:
        raise Fault("LINK_REPLY", f"asked for {about}: the reply is to request {frame.number}, not to {number}")
    if frame.unit != unit:
        raise Fault("LINK_UNIT", f"unit {frame.unit} answered, unit {unit} was asked for {about}")
    if is_exception(frame, asked):
        code = frame.pdu[1]
        way_out = "; try daq.modbus.requests: separate" if code == 1 and asked.function_code == 23 else ""
        raise Fault(
            "MODBUS_EXCEPTION",
            f"{_EXCEPTIONS.get(code, 'exception')} ({code}) at {about}, FC{asked.function_code:02d}{way_out}",
        )
    if frame.pdu[0] != asked.function_code:
        raise Fault(
            "LINK_REPLY", f"asked for {about} by FC{asked.function_code:02d}: the reply is of FC{frame.pdu[0]:02d}"
        )
    expected = _expected(asked)
    if isinstance(expected, int):
        if len(frame.pdu) != expected or frame.pdu[1] != expected - 2:
            raise Fault("LINK_REPLY", f"asked for {about}: {len(frame.pdu) - 2} bytes came, not {expected - 2}")
    elif expected is not None and frame.pdu != expected:
        raise Fault("LINK_REPLY", f"asked for {about}: confirmed is {frame.pdu.hex(' ')}, not {expected.hex(' ')}")


def _expected(request: ModbusPDU) -> int | bytes | None:
    """The reply to a request: its length where registers come back, all of it where a write is confirmed."""
    if isinstance(request, ReadWriteMultipleRegistersRequest):
        return 2 + 2 * request.read_count
    if isinstance(request, ReadHoldingRegistersRequest):
        return 2 + 2 * request.count
    if isinstance(request, WriteSingleRegisterRequest | WriteMultipleRegistersRequest):
        return bytes((request.function_code,)) + request.encode()[:4]
    return None
