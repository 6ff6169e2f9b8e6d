"""The firmware's two laws, a relay and strokes, in virtual time: at the pin, through the driver, in the loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Unpack

from simulated_bench import CALIBRATION, DEMO, GUARD, LIMITS, PERIOD_S, SCALING, ListSink
from virtual_host import BENCH, SETUP, BoardOptions, VirtualHost, armed_host

from rig.backends.driver import RelayCommand, RelayRow, StrokesCommand, StrokeTimes
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.frames import Block, FrameReader, Kind, RelaySetup, Setup, StrokesSetup
from rig.control.bounded import Bounded
from rig.control.excitation import RelayTest
from rig.control.guard import Guard, GuardSettings
from rig.control.law import Law
from rig.control.loop.runner import Loop
from rig.control.loop.stop_request import StopRequest
from rig.control.relay import RelayOnCounts
from rig.control.strokes_on_counts import StrokesOnCounts
from rig.model.bench import BenchParameters
from rig.model.cycle_detector import CycleDetector

LawSetup = RelaySetup | StrokesSetup
RELAY = RelaySetup((-80, 30, -30, 80), 512 * 16, 5_000_000, 1, 10)
STROKES = StrokesSetup(((80, 600), (-90, 420), (60, 560), (-70, 470)), 2000, 2000, 5, 10)
GAINS_V = (0.4, 0.85)
LEVELS_V = ((0.9, 0.35), (-1.0, -0.35), (0.8, 0.2), (-0.7, -0.2))  # drive, V; turning point, rad
TIMES = StrokeTimes(1.5, 0.3)
MOTION_RAD = 0.02


def kind_of(law: LawSetup) -> Kind:
    """By which a host asks for it."""
    return Kind.RELAY if isinstance(law, RelaySetup) else Kind.STROKES


def running_host(
    law: LawSetup, bench: BenchParameters = BENCH, setup: Setup = SETUP, **board: Unpack[BoardOptions]
) -> VirtualHost:
    host = armed_host(bench, setup, **board)
    packet = host.ask(kind_of(law), law.pack())
    assert packet.kind == kind_of(law) | 0x80 and law.unpack(packet.body) == law
    return host


def told_blocks(host: VirtualHost, reader: FrameReader | None = None) -> list[tuple[int, Block]]:
    """Every block that has arrived by now, and not been read before."""
    reader = reader or FrameReader()
    packets = []
    while data := host.board.read(0.0):
        packets += reader.feed(data)
    return [(p.seq, Block.unpack(p.body)) for p in packets if p.kind == Kind.BLOCK]


def armed_driver(**bench: Any) -> tuple[VirtualBoard, SerialDriver]:
    board = VirtualBoard(replace(DEMO, **bench), clock_error_ppm=4000)
    driver = SerialDriver(board, SCALING)
    driver.open()
    driver.arm(LIMITS)
    return board, driver


def start_relay(driver: SerialDriver) -> None:
    driver.start_relay(driver.relay_command(*GAINS_V, 0.7))


def start_strokes(driver: SerialDriver) -> None:
    driver.start_strokes(driver.strokes_command(LEVELS_V, TIMES, MOTION_RAD))


def run_for(board: VirtualBoard, driver: SerialDriver, time_s: float) -> list[RelayRow]:
    rows = []
    until_s = board.now_s() + time_s
    while board.now_s() < until_s:
        board.sleep_until(board.now_s() + PERIOD_S)
        driver.keep()
        rows += driver.read_rows()
    return rows


class DeviceBench:
    """The loop on the compiled firmware, and a law that runs in it.

    test, command  the law as the host decides along, and as the device is told
    """

    test: RelayTest | Bounded
    command: RelayCommand | StrokesCommand
    stage: str

    def __init__(self, guard: GuardSettings = GUARD, **bench: Any) -> None:
        self.board = VirtualBoard(replace(DEMO, **bench), clock_error_ppm=4000)
        self.driver = SerialDriver(self.board, SCALING)
        self.driver.open()
        self.guard, self.record, self.stop = Guard(guard), ListSink(), StopRequest()
        self.guard.sign_proven = True
        self.loop = Loop(self.driver, self.board, self.guard, self.record, PERIOD_S, self.stop)

    def run(
        self, after: Callable[[float], None] | None = None, *, then: Law | None = None, guard_ends_run: bool = True
    ) -> None:
        with self.loop.armed(LIMITS):
            self.loop.run_in_device(self.test, self.command, self.stage, after, guard_ends_run=guard_ends_run)
            if then is not None:
                self.loop.run(then, "rest")


class RelayBench(DeviceBench):
    """A relay test for the device's own relay."""

    test: RelayTest
    stage = "relay-1"

    def __init__(
        self, cycles: int = 3, gains_V: tuple[float, float] = GAINS_V, guard: GuardSettings = GUARD, **bench: Any
    ) -> None:
        super().__init__(guard, **bench)
        self.command = self.driver.relay_command(*gains_V, 0.7)
        self.detector = CycleDetector(30 * PERIOD_S, 20 * CALIBRATION.lsb_rad)
        relay = RelayOnCounts(self.command, gains_V)
        self.test = RelayTest(relay, self.detector, gains_V, cycles, 30.0)


class StrokesBench(DeviceBench):
    """Strokes for the device's own stroke test."""

    test: Bounded
    stage = "strokes-1"

    def __init__(self, guard: GuardSettings = GUARD, levels: Any = LEVELS_V, **bench: Any) -> None:
        super().__init__(guard, **bench)
        self.command = self.driver.strokes_command(levels, TIMES, MOTION_RAD)
        self.strokes = StrokesOnCounts(self.command)
        self.test = Bounded(self.strokes, None)
