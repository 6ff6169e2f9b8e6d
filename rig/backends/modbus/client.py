"""Modbus as it goes over a line. The silences between frames follow Modbus over Serial Line 1.02."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from typing_extensions import override

from rig.backends.modbus.frames import Frame, Framing, RtuFraming, TcpFraming
from rig.backends.modbus.requests import Request, check
from rig.backends.registers.bus import Protocol


@dataclass(frozen=True)
class ModbusLine:
    """How the device is reached.

    tcp           Modbus TCP; else RTU
    unit          unit id of the device, 1 to 247
    requests      "read-write": FC23 in a tick; "separate": FC03 (FC04), then FC16 (FC06)
    baud, bits_per_byte, silence_s   of an RTU line
    turnaround_s  the device's own time, as the config has it
    """

    tcp: bool = False
    unit: int = 1
    requests: Literal["read-write", "separate"] = "read-write"
    baud: int = 115200
    bits_per_byte: int = 10
    silence_s: float = 0.00175
    turnaround_s: float = 0.0005

    def wire_s(self, n_bytes: int) -> float:
        """Time that bytes take on the wire; of TCP nothing that counts."""
        return 0.0 if self.tcp else n_bytes * self.bits_per_byte / self.baud

    @property
    def pause_s(self) -> float:
        """Least silence between two frames."""
        return 0.0 if self.tcp else self.silence_s


class Modbus(Protocol[Request]):
    """Modbus as it goes over a line."""

    refusal = "MODBUS_EXCEPTION"

    def __init__(self, line: ModbusLine) -> None:
        self.late_come_together = line.tcp
        self.name = f"unit {line.unit}"
        self.pause_s = line.pause_s
        self.turnaround_s = line.turnaround_s
        self._line = line
        self._framing: Framing = TcpFraming() if line.tcp else RtuFraming()
        self._number = 0  # of the request, TCP

    @override
    def encode(self, request: Request) -> bytes:
        self._number = self._number % 0xFFFF + 1
        return self._framing.encode(request.pdu, self._line.unit, self._number)

    @override
    def take(self, data: bytes, request: Request) -> Frame | None:
        return self._framing.take(data)

    @override
    def check(self, frame: Frame, request: Request) -> None:
        check(frame, request, self._line.unit, self._number)

    @override
    def wire_s(self, n_bytes: int) -> float:
        return self._line.wire_s(n_bytes)
