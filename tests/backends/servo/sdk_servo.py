"""A servo that owes nothing to ours: its maker's package makes its packets and takes them apart; its motor is Euler's.

In virtual time, as a Transport that is a Clock. It is an XL330-M288 or an STS3215 as their tables have them, with what
a host needs that drives the duty: lock, limit, mode, ramp, watchdog. Addresses stand here once more on purpose.
"""

from __future__ import annotations

import math
from typing import Any

import dynamixel_sdk as dxl
import scservo_sdk as scs

TAU_S, K_RAD_S_V, FRICTION_V = 0.05, 2.0, 0.1
STEP_S = 1e-4
BAUD = 1_000_000
FULL = {"dynamixel": 885, "feetech": 1000}


class _Kept:
    """A port of scservo_sdk that keeps what is written to it."""

    def __init__(self) -> None:
        self.is_using, self.packet = False, b""

    def clearPort(self) -> None:
        """Nothing waits in it."""

    def writePort(self, packet: Any) -> int:
        self.packet = bytes(packet)
        return len(packet)


class SdkServo:
    """One servo of id 1 on a bus of its own; ``protocol``: dynamixel or feetech."""

    absolute = True

    def __init__(self, protocol: str, supply_V: float = 5.0) -> None:
        self.supply_V = supply_V
        self.is_dynamixel = protocol == "dynamixel"
        self.full = FULL[protocol]
        self.regs = bytearray(256)
        self.y_rad = self.v_rad_s = self.duty = 0.0
        self.now = self._heard_s = 0.0
        self.has_driven_unasked = False
        self._stopped = False
        self._in, self._out, self._due_s = b"", b"", math.inf
        if self.is_dynamixel:
            self._put(0, 1200, 2)
            for at, value, size in [(6, 52, 1), (7, 1, 1), (8, 3, 1), (9, 250, 1), (11, 3, 1), (12, 255, 1), (13, 2, 1),
                                    (31, 70, 1), (32, 70, 2), (34, 35, 2), (36, 885, 2), (48, 4095, 4), (62, 140, 1),
                                    (63, 53, 1), (68, 2, 1), (100, 885, 2)]:  # fmt: skip
                self._put(at, value, size)
        else:
            scs.PacketHandler(0)  # low byte first: a global of theirs
            for at, value, size in [(3, 777, 2), (5, 1, 1), (8, 1, 1), (11, 4095, 2), (13, 70, 1), (14, 80, 1),
                                    (15, 40, 1), (16, 1000, 2), (18, 12, 1), (19, 44, 1), (34, 20, 1), (35, 200, 1),
                                    (36, 80, 1), (44, 1000, 2), (48, 1000, 2), (55, 1, 1)]:  # fmt: skip
                self._put(at, value, size)

    def _put(self, at: int, value: int, size: int) -> None:
        self.regs[at : at + size] = (value % (1 << 8 * size)).to_bytes(size, "little")

    def _get(self, at: int, size: int) -> int:
        return int.from_bytes(self.regs[at : at + size], "little", signed=size > 1)

    # ------------------------------------------------------------------ port and clock

    def now_s(self) -> float:
        return self.now

    def sleep_until(self, t_s: float) -> float:
        while self.now + STEP_S <= t_s:
            self.now += STEP_S
            self._step()
        self.now = max(self.now, t_s)
        return self.now

    def write(self, data: bytes) -> None:
        self._in += data
        self.sleep_until(self.now + 10.0 * len(data) / BAUD)
        while taken := self._taken():
            answer = self._answer(*taken)
            if answer:
                self._out += answer
                delay_s = 2e-6 * self.regs[9] if self.is_dynamixel else 0.0
                self._due_s = self.now + delay_s + 10.0 * len(answer) / BAUD

    def read(self, timeout_s: float) -> bytes:
        until_s = self.now + timeout_s
        if self._due_s > until_s:
            self.sleep_until(until_s)
            return b""
        self.sleep_until(self._due_s)
        out, self._out, self._due_s = self._out, b"", math.inf
        return out

    def close(self) -> None:
        """The servo lives on."""

    # ------------------------------------------------------------------ motor

    def _step(self) -> None:
        torque, mode = self.regs[64 if self.is_dynamixel else 40], self.regs[11 if self.is_dynamixel else 33]
        if (
            self.is_dynamixel
            and torque
            and 0 < self.regs[98] < 128
            and self.now - self._heard_s >= 0.02 * self.regs[98]
        ):
            self.regs[98], self._stopped = 0xFF, True
        goal = 0.0
        if torque and not self._stopped and mode == (16 if self.is_dynamixel else 2):
            goal = self._get(100, 2) if self.is_dynamixel else scs.SCS_TOHOST(self._get(44, 2), 10)
            most = self._get(36 if self.is_dynamixel else 48, 2)
            goal = min(max(goal, -most), most)
        if torque and abs(goal) == self.full:
            self.has_driven_unasked = True  # no test of ours asks for full duty
        ramp = 1.977 * self.regs[62] * STEP_S / self.supply_V * self.full if self.is_dynamixel else math.inf
        self.duty = min(max(goal, self.duty - ramp), self.duty + ramp) if torque and not self._stopped else 0.0
        u_V = self.duty / self.full * self.supply_V
        force_V = u_V - self.v_rad_s / K_RAD_S_V
        if self.v_rad_s == 0.0 and abs(u_V) <= FRICTION_V:
            return
        sign = math.copysign(1.0, self.v_rad_s if self.v_rad_s else u_V)
        v = self.v_rad_s + STEP_S / TAU_S * K_RAD_S_V * (force_V - sign * FRICTION_V)
        self.v_rad_s = 0.0 if v * sign < 0.0 else v
        self.y_rad += STEP_S * self.v_rad_s

    def _refresh(self) -> None:
        counts = 2048 + math.floor(self.y_rad * 4096 / (2.0 * math.pi) + 0.5)
        if self.is_dynamixel:
            self._put(120, int(1e3 * self.now) % 32_768, 2)
            self._put(124, round(self.duty), 2)
            self._put(128, round(self.v_rad_s / 0.02397), 4)
            self._put(132, counts, 4)
            self._put(144, round(10 * self.supply_V), 2)
            self.regs[146] = 30
        else:
            self._put(56, counts % 4096, 2)
            self._put(58, scs.SCS_TOSCS(round(self.v_rad_s * 4096 / (2.0 * math.pi)), 15), 2)
            self._put(60, scs.SCS_TOSCS(round(self.duty), 10), 2)
            self.regs[62], self.regs[63] = round(10 * self.supply_V), 30

    # ------------------------------------------------------------------ packets, by their functions

    def _taken(self) -> tuple[int, int, bytes] | None:
        """Id, instruction and parameters of the next packet; None: none is whole."""
        header = b"\xff\xff\xfd\x00" if self.is_dynamixel else b"\xff\xff"
        at = self._in.find(header)
        if at < 0 or len(self._in) < at + 7:
            return self._short(at)
        self._in = self._in[at:]
        length = dxl.DXL_MAKEWORD(self._in[5], self._in[6]) + 7 if self.is_dynamixel else self._in[3] + 4
        if len(self._in) < length:
            return None
        packet, self._in = list(self._in[:length]), self._in[length:]
        if not self.is_dynamixel:
            assert ~sum(packet[2:-1]) & 0xFF == packet[-1]
            return packet[2], packet[4], bytes(packet[5:-1])
        sdk = dxl.Protocol2PacketHandler()
        assert sdk.updateCRC(0, packet, length - 2) == dxl.DXL_MAKEWORD(packet[-2], packet[-1])
        plain = sdk.removeStuffing(packet)
        n = dxl.DXL_MAKEWORD(plain[5], plain[6])
        return plain[4], plain[7], bytes(plain[8 : 5 + n])

    def _short(self, at: int) -> tuple[int, int, bytes] | None:
        """A Feetech's ping has six bytes."""
        if not self.is_dynamixel and at >= 0 and len(self._in) == at + 6 and self._in[at + 3] == 2:
            packet, self._in = self._in[at:], b""
            return packet[2], packet[4], b""
        return None

    def _status(self, data: bytes = b"", error: int = 0) -> bytes:
        if not self.is_dynamixel:
            port = _Kept()
            packet = [0, 0, 1, len(data) + 2, error, *data, 0]
            scs.protocol_packet_handler().txPacket(port, packet)
            return port.packet
        sdk, n = dxl.Protocol2PacketHandler(), len(data) + 4
        packet = sdk.addStuffing([0xFF, 0xFF, 0xFD, 0, 1, n & 0xFF, n >> 8, 0x55, error, *data, 0, 0])
        length = dxl.DXL_MAKEWORD(packet[5], packet[6]) + 7
        crc = sdk.updateCRC(0, packet, length - 2)
        return bytes([*packet[: length - 2], dxl.DXL_LOBYTE(crc), dxl.DXL_HIBYTE(crc)])

    def _answer(self, id: int, instruction: int, p: bytes) -> bytes:
        self._heard_s = self.now
        wide = 2 if self.is_dynamixel else 1  # bytes of an address, and of a length
        at = int.from_bytes(p[:wide], "little")
        if instruction == dxl.INST_SYNC_WRITE:
            length = int.from_bytes(p[wide : 2 * wide], "little")
            for k in range(2 * wide, len(p), length + 1):
                if p[k] == 1:
                    self._write(at, p[k + 1 : k + 1 + length])
            return b""
        if id not in (1, 254) or (id == 254 and instruction != dxl.INST_PING):
            return b""
        if instruction == dxl.INST_PING:
            if self.is_dynamixel:
                return self._status(bytes(self.regs[0:2] + self.regs[6:7]))
            return self._status() if id == 1 else b""
        if instruction == dxl.INST_READ:
            self._refresh()
            length = int.from_bytes(p[wide : 2 * wide], "little")
            return self._status(bytes(self.regs[at : at + length]))
        if instruction == dxl.INST_WRITE:
            return self._status(error=self._write(at, p[wide:]))
        return self._status(error=2)

    def _write(self, at: int, data: bytes) -> int:
        if not self.is_dynamixel:
            assert not (at <= 40 < at + len(data) and data[40 - at] == 128), "the middle of an arm is gone"
            self.regs[at : at + len(data)] = data
            return 0
        if at < 64 and self.regs[64]:
            return 7
        if at == 100:
            goal = int.from_bytes(data[:2], "little", signed=True)
            if self.regs[98] == 0xFF:
                return 4
            if abs(goal) > self._get(36, 2):
                return 6
        self.regs[at : at + len(data)] = data
        if at <= 11 < at + len(data):
            self._put(100, self._get(36, 2), 2)
        if at == 98 and data[0] == 0:
            self._stopped = False
        if at <= 64 < at + len(data) and data[64 - at]:
            assert self._get(100, 2) == 0, "torque on with a goal"
        return 0
