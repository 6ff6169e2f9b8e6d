"""A host for tests: asks one thing at a time over the wire of a virtual board."""

from __future__ import annotations

from dataclasses import replace
from typing import Generic, Protocol, TypedDict, TypeVar, Unpack

from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.frames import (
    STATUS_FAULT,
    VERSION,
    Block,
    Code,
    DeviceState,
    FrameReader,
    Hello,
    Kind,
    Packet,
    Setup,
    encode,
    pack_ack,
    pack_arm,
    pack_drive,
)
from rig.model.bench import BenchParameters
from rig.model.friction import coulomb
from rig.model.motor import Motor

BENCH = BenchParameters(Motor(0.17, 6.5, coulomb(0.5)), noise_rad=0.003)
HELD = replace(BENCH, motor=Motor(0.17, 6.5, coulomb(5.0)))  # a shaft that no drive of these tests moves
SESSION = 4711
SETUP = Setup(
    session=SESSION,
    hard_lo=49,
    hard_hi=975,
    rail_lo=5,
    rail_hi=1018,
    centre=512,
    max_drive=200,
    watchdog_ms=100,
    polarity=1,
)
TICK_S = 1e-3
LSB_RAD = BENCH.rad_per_count


class Truth(Protocol):
    """What is really the case at a device, as far as every one of them tells it."""

    @property
    def pin_V(self) -> float: ...


class Wired(Protocol):
    """A device in virtual time at the other end of the wire."""

    def write(self, data: bytes) -> None: ...

    def read(self, timeout_s: float) -> bytes: ...

    def now_s(self) -> float: ...

    def sleep_until(self, t_s: float) -> float: ...

    def truth(self) -> Truth: ...


Device = TypeVar("Device", bound=Wired)


class BoardOptions(TypedDict, total=False):
    """What a virtual board is made with besides its bench."""

    seed: int
    clock_error_ppm: float
    clock_start_us: int


class Host(Generic[Device]):
    """Frames to and from one device.

    heard_s  time at which the last frame sent has arrived whole at the device
    """

    def __init__(self, board: Device) -> None:
        self.board = board
        self.heard_s = 0.0
        self._reader = FrameReader()
        self._seq = 0

    def send(self, kind: int, body: bytes = b"", version: int = VERSION) -> None:
        self._seq = (self._seq + 1) & 0xFFFF
        self.send_raw(encode(kind, self._seq, body, version))

    def send_raw(self, data: bytes) -> None:
        self.heard_s = max(self.heard_s, self.board.now_s()) + len(data) * round(11e9 / 115200) * 1e-9
        self.board.write(data)

    def ask(self, kind: int, body: bytes = b"", version: int = VERSION) -> Packet:
        self.send(kind, body, version)
        until_s = self.board.now_s() + 0.05
        while self.board.now_s() < until_s:
            for packet in self._reader.feed(self.board.read(until_s - self.board.now_s())):
                if packet.seq == self._seq:
                    return packet
        raise AssertionError(f"no reply to {kind}")

    def heard(self, within_s: float) -> list[Packet]:
        """Answers to the last request that come within this time."""
        until_s = self.board.now_s() + within_s
        packets: list[Packet] = []
        while self.board.now_s() < until_s:
            packets += self._reader.feed(self.board.read(until_s - self.board.now_s()))
        return [packet for packet in packets if packet.seq == self._seq]

    def hello(self) -> Hello:
        return Hello.unpack(self.ask(Kind.HELLO).body)

    def setup(self, setup: Setup = SETUP) -> None:
        packet = self.ask(Kind.SETUP, setup.pack())
        assert packet.kind == Kind.SETUP_REPLY and Setup.unpack(packet.body) == setup

    def arm(self, session: int = SESSION) -> Code:
        packet = self.ask(Kind.ARM, pack_arm(session))
        assert packet.kind == Kind.ARM_REPLY
        return Code(packet.body[0])

    def acknowledge(self, code: Code) -> DeviceState:
        """What is latched after it; the device must not refuse it."""
        packet = self.ask(Kind.ACK, pack_ack(code))
        assert packet.kind == Kind.ACK_REPLY
        return DeviceState.unpack(packet.body)

    def arm_anew(self) -> Code:
        """As a command that a person has given begins: what is latched is acknowledged first."""
        state = self.state()
        while state.status & STATUS_FAULT:
            state = self.acknowledge(Code(state.fault))
        return self.arm()

    def state(self) -> DeviceState:
        packet = self.ask(Kind.READ)
        assert packet.kind == Kind.STATE
        return DeviceState.unpack(packet.body)

    def drive(self, units: int) -> None:
        """Send a drive, and wait until the device has it."""
        self.send(Kind.DRIVE, pack_drive(units))
        self.board.sleep_until(self.heard_s)

    def wait(self, time_s: float) -> None:
        self.board.sleep_until(self.board.now_s() + time_s)

    def pin_V(self) -> float:
        return self.board.truth().pin_V


class Told:
    """What a law in the device tells: its blocks, and their numbers."""

    def __init__(self) -> None:
        self.numbers: list[int] = []
        self.blocks: list[Block] = []
        self._reader = FrameReader()

    def take(self, data: bytes) -> None:
        """Bytes from the device."""
        for packet in self._reader.feed(data):
            if packet.kind == Kind.BLOCK:
                self.numbers.append(packet.seq)
                self.blocks.append(Block.unpack(packet.body))

    def rows(self) -> list[tuple[int, int, int]]:
        """Each row's time, us, counts and drive."""
        return [
            (block.t_first_us + k * block.period_us, counts, drive)
            for block in self.blocks
            for k, (counts, drive) in enumerate(block.rows)
        ]


class VirtualHost(Host[VirtualBoard]):
    """Frames to and from one virtual board."""


def armed_host(bench: BenchParameters = BENCH, setup: Setup = SETUP, **board: Unpack[BoardOptions]) -> VirtualHost:
    host = VirtualHost(VirtualBoard(bench, **board))
    host.acknowledge(Code.RESET)
    host.setup(setup)
    assert host.arm(setup.session) == Code.NONE
    return host
