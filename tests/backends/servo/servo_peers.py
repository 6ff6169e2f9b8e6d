"""The port of both makers' packages on an emulated bus in virtual time: none asks the machine's clock."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig.backends.servo.emulated.virtual_bus import VirtualServoBus

_WAIT_S = 1e-3  # of virtual time, where their busy loop finds nothing
_LATENCY_S = 0.034  # that both packages allow an adapter


class VirtualPort:
    """What dynamixel_sdk and scservo_sdk call on their PortHandler, on a bus in virtual time."""

    def __init__(self, bus: VirtualServoBus) -> None:
        self.bus = bus
        self.is_using = False
        self.sent: list[bytes] = []
        self._arrived = b""
        self._until_s = 0.0

    def rest(self) -> None:
        """Wait for what they do not: the answer to what they only sent."""
        self.bus.sleep_until(self.bus.now_s() + 0.01)

    def getBaudRate(self) -> int:
        return self.bus.bus.line.baud

    def clearPort(self) -> None:
        self._arrived = b""
        while self.bus.read(0.0):
            pass

    def writePort(self, packet: Any) -> int:
        self.sent.append(bytes(packet))
        self.bus.write(bytes(packet))
        return len(packet)

    def readPort(self, length: int) -> bytes:
        if len(self._arrived) < length:
            self._arrived += self.bus.read(_WAIT_S)
        taken, self._arrived = self._arrived[:length], self._arrived[length:]
        return taken

    def setPacketTimeout(self, n_bytes: int) -> None:
        self.setPacketTimeoutMillis(1e3 * (n_bytes * 10.0 / self.getBaudRate() + _LATENCY_S))

    def setPacketTimeoutMillis(self, ms: float) -> None:
        self._until_s = self.bus.now_s() + 1e-3 * ms

    def isPacketTimeout(self) -> bool:
        return self.bus.now_s() > self._until_s


def violations_in(file: Path) -> list[str]:
    """What a board has noted so far, in words; without a last line that is torn."""
    lines = file.read_text(encoding="ascii").split("\n")[:-1] if file.exists() else []
    return [line.split(",", 2)[2] for line in lines]
