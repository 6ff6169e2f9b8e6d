"""Our driver on a servo whose packets dynamixel-sdk makes and takes: its stuffing and its CRC, none of ours.

The servo is as small as it can be: bytes of registers, and a motor that turns as fast as its duty says.
"""

from __future__ import annotations

import math
from typing import Any

import dynamixel_sdk
import pytest
from servo_bench import Bench

from rig.backends.driver import Timeouts
from rig.backends.servo.before import BeforeStore
from rig.backends.servo.driver import ServoDriver

HEADER = [0xFF, 0xFF, 0xFD, 0x00]
TURN_RAD_S_PER_STEP = 2.354 * 5.0 / 885
WATCHDOG_S = 0.02
AS_SHIPPED = [
    (0, 1200, 2), (6, 52, 1), (9, 250, 1), (11, 3, 1), (12, 255, 1), (32, 70, 2), (34, 35, 2), (36, 885, 2),
    (62, 140, 1), (63, 53, 1), (68, 2, 1), (100, 885, 2), (144, 50, 2), (146, 25, 1),
]  # fmt: skip


class TheirServo:
    """A servo of id 1, an XL330-M288, in virtual time; a transport and a clock."""

    absolute = True

    def __init__(self) -> None:
        self.handler: Any = dynamixel_sdk.Protocol2PacketHandler()
        self.registers = bytearray(200)
        self.t_s = self.heard_s = 0.0
        self.y_counts = 2048.0
        self.reply = b""
        self.acted = False
        for address, value, size in AS_SHIPPED:
            self.put(address, value, size)

    def put(self, address: int, value: int, size: int) -> None:
        self.registers[address : address + size] = (value % 256**size).to_bytes(size, "little")

    def get(self, address: int, size: int = 2) -> int:
        return int.from_bytes(self.registers[address : address + size], "little", signed=True)

    @property
    def duty(self) -> int:
        return self.get(100) if self.registers[64] and self.registers[11] == 16 and not self.acted else 0

    def now_s(self) -> float:
        return self.t_s

    def sleep_until(self, t_s: float) -> float:
        while self.t_s < t_s:
            step_s = min(t_s - self.t_s, 1e-3)
            self.y_counts += self.duty * TURN_RAD_S_PER_STEP * step_s * 4096 / math.tau
            self.t_s += step_s
            units = self.get(98, 1)
            if units > 0 and self.registers[64] and self.t_s - self.heard_s > units * WATCHDOG_S:
                self.acted = True
                self.put(98, -1, 1)
        return self.t_s

    def close(self) -> None:
        pass

    def read(self, timeout_s: float) -> bytes:
        if not self.reply:
            self.sleep_until(self.t_s + max(timeout_s, 1e-6))
            return b""
        self.sleep_until(self.t_s + 5e-4)
        taken, self.reply = self.reply, b""
        return taken

    def write(self, data: bytes) -> None:
        packet = list(data)
        assert packet[:4] == HEADER and self.handler.updateCRC(0, packet, len(packet) - 2) == data[-2] | data[-1] << 8
        packet = self.handler.removeStuffing(packet)
        self.heard_s = self.t_s
        if packet[4] != 1:
            return
        instruction, parameters = packet[7], packet[8 : 7 + (packet[5] | packet[6] << 8) - 2]
        if instruction == 1:
            self.answer([*self.registers[0:2], self.registers[6]])
            return
        address = parameters[0] | parameters[1] << 8
        if instruction == 2:
            self.refresh()
            self.answer(list(self.registers[address : address + (parameters[2] | parameters[3] << 8)]))
            return
        assert instruction == 3
        values = bytes(parameters[2:])
        error = 0
        if address < 64 and self.registers[64]:
            error = 7
        elif address == 100 and self.acted:
            error = 4
        else:
            self.registers[address : address + len(values)] = values
            if address == 98:
                self.acted = False
            if address == 11:
                self.put(100, self.get(36), 2)
        self.answer([], error)

    def refresh(self) -> None:
        self.put(120, int(self.t_s * 1e3) % 32768, 2)
        self.put(124, self.duty, 2)
        self.put(132, round(self.y_counts), 4)

    def answer(self, data: list[int], error: int = 0) -> None:
        length = 4 + len(data)
        packet = [*HEADER, 1, length & 0xFF, length >> 8, 0x55, error, *data, 0, 0]
        packet = self.handler.addStuffing(packet)
        crc = self.handler.updateCRC(0, packet, len(packet) - 2)
        packet[-2:] = [crc & 0xFF, crc >> 8]
        self.reply += bytes(packet)


def test_our_driver_opens_arms_drives_and_stops_a_servo_of_their_packets() -> None:
    bench, servo = Bench(setup={"fastest_slope": False}), TheirServo()
    before = bytes(servo.registers[:64])
    servo.registers[100:102] = (885).to_bytes(2, "little")
    driver = ServoDriver(
        servo, bench.setup, 1_000_000, bench.e.device.scaling, Timeouts(0.01, 0.2), BeforeStore(), emulated=True
    )
    info = driver.open()
    assert info.board == "xl330-m288" and driver.failsafe is not None and info.drive_units == 885
    driver.arm(bench.limits)
    driver.write(0.0)
    begun = driver.read()
    for _ in range(20):
        driver.write(0.5)
        servo.sleep_until(servo.t_s + 0.008)
        sample = driver.read()
    assert sample.u_V == pytest.approx(0.5, abs=5.0 / 885)
    assert sample.y_rad - begun.y_rad == pytest.approx(2.354 * 0.5 * (sample.t_s - begun.t_s), rel=0.1)
    assert driver.safe_stop() and not servo.registers[64]
    driver.close()
    assert bytes(servo.registers[:64]) == before
    assert driver.link_statistics["bad_replies"] == 0


def test_positions_whose_bytes_need_stuffing_are_read_as_they_are() -> None:
    """FF FF FD in the data of an answer."""
    servo = TheirServo()
    bench = Bench(setup={"zero_counts": 2048})
    driver = ServoDriver(servo, bench.setup, 1_000_000, bench.e.device.scaling, Timeouts(0.01, 0.2), BeforeStore())
    driver.open()
    servo.put(124, 0, 2)
    for counts in (-0x0201, -0x020001, -3, -0x0300):  # the second: FF FF FD FF
        servo.y_counts = counts
        driver._position = None
        assert (driver.read().y_counts + 2048 - counts) % 4096 == 0
