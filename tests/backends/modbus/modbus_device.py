"""The emulated I/O block of the example config, with what a test changes; a bare master, and mishaps on its line."""

from __future__ import annotations

import copy
import struct
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from rig.backends.emulated.line_faults import Direction
from rig.backends.modbus.emulated.io_block import IoBlock
from rig.backends.modbus.emulated.rtu_slave import frame
from rig.backends.modbus.emulated.virtual_io_block import VirtualIoBlock
from rig.backends.modbus.section import Modbus
from rig.config import load
from rig.config.schema import Emulated, EmulatedMotor, EmulatedPotentiometer, EmulatedWiring

CONFIG = Path(__file__).resolve().parents[3] / "config"
DRIVE, SEQUENCE, CONTROL, WATCHDOG, POSITION, ECHO, APPLIED, STATUS = 0, 1, 8, 9, 16, 17, 18, 19
LOW, HIGH, MAX_DRIVE, RAIL_LOW, RAIL_HIGH = 10, 11, 12, 13, 14
SETTINGS = (100, 49, 975, 2500, 5, 1018)  # from WATCHDOG on
FRICTIONLESS = {"tau_s": 0.17, "K_rad_s_V": 6.5, "fc_plus_V": 0.0, "fc_minus_V": 0.0}


def modbus(registers: dict[str, Any] | None = None, **changed: Any) -> Modbus:
    """Section daq.modbus of config/modbus-rtu.yaml; a register of None is taken out."""
    plain = copy.deepcopy(_example())
    for name, change in (registers or {}).items():
        if change is None or plain["registers"][name] is None:
            plain["registers"][name] = change
        else:
            plain["registers"][name] |= change
    return Modbus.model_validate(plain | changed)


@lru_cache
def _example() -> dict[str, Any]:
    section = load(CONFIG / "modbus-rtu.yaml").daq.modbus
    assert section is not None
    return section.model_dump()


def emulated(wiring: dict[str, Any] | None = None, potentiometer: Any = None, **motor: Any) -> Emulated:
    """A bench without noise; by default without friction."""
    return Emulated(
        motor=EmulatedMotor.model_validate(FRICTIONLESS | motor),
        potentiometer=EmulatedPotentiometer.model_validate(potentiometer or {}),
        wiring=EmulatedWiring.model_validate(wiring or {}),
    )


def read(address: int, count: int, function: int = 3) -> bytes:
    return struct.pack(">BHH", function, address, count)


def write_one(address: int, word: int) -> bytes:
    return struct.pack(">BHH", 6, address, word & 0xFFFF)


def write(address: int, *words: int) -> bytes:
    n = len(words)
    return struct.pack(f">BHHB{n}H", 16, address, n, 2 * n, *(word & 0xFFFF for word in words))


def read_write(read_address: int, count: int, address: int, *words: int) -> bytes:
    n = len(words)
    head = struct.pack(">BHHHHB", 23, read_address, count, address, n, 2 * n)
    return head + struct.pack(f">{n}H", *(word & 0xFFFF for word in words))


def words(reply: bytes) -> list[int]:
    """Registers of a reply to a reading, 16-bit signed."""
    assert reply[0] in (3, 4, 23) and reply[1] == len(reply) - 2, reply.hex()
    return list(struct.unpack(f">{reply[1] // 2}h", reply[2:]))


def armed_block(section: Modbus | None = None, bench: Emulated | None = None, **options: Any) -> IoBlock:
    """A block that took its settings and was armed at time 0."""
    block = IoBlock.of(section or modbus(), bench or emulated(), 1, **options)
    assert block.request(write(WATCHDOG, *SETTINGS), 0.0) == struct.pack(">BHH", 16, WATCHDOG, 6)
    assert block.request(write_one(CONTROL, 1), 0.0) == write_one(CONTROL, 1)
    return block


def state(block: IoBlock, t_s: float) -> tuple[int, int]:
    """(applied, status) as read at a time."""
    applied, status = words(block.request(read(APPLIED, 2), t_s))
    return applied, status


class Master:
    """Asks over the virtual line, one request at a time; the next one not before a pause."""

    def __init__(self, device: VirtualIoBlock, unit: int = 1) -> None:
        self.device, self.unit = device, unit

    def ask(self, pdu: bytes, timeout_s: float = 0.1) -> bytes:
        """The reply's function code and data, b"" for none; then a pause of 2 ms."""
        self.device.write(frame(self.unit, pdu))
        reply = self.device.read(timeout_s)
        self.device.sleep_until(self.device.now_s() + 0.002)
        if not reply:
            return b""
        assert reply == frame(self.unit, reply[1:-2]), reply.hex()
        return reply[1:-2]

    def arm(self) -> None:
        self.ask(write(WATCHDOG, *SETTINGS))
        assert self.ask(write_one(CONTROL, 1)) == write_one(CONTROL, 1)


class Mishap:
    """One thing that happens to the next ``times`` of what is sent in a direction.

    delay_s  of it, s; None: it is lost
    copy_s   delay of a second copy, s; None: there is none
    """

    def __init__(
        self, direction: Direction, times: int = 1, *, delay_s: float | None = 0.0, copy_s: float | None = None
    ) -> None:
        self.left = times
        self._direction = direction
        self._delays_s = [d for d in (delay_s, copy_s) if d is not None]

    def __call__(self, direction: Direction, data: bytes, t_s: float) -> Sequence[tuple[float, bytes]]:
        """As a Disturbance."""
        if direction != self._direction or self.left == 0:
            return ((0.0, data),)
        self.left -= 1
        return [(delay_s, data) for delay_s in self._delays_s]
