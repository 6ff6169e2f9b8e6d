"""The stroke test on the Uno's emulated chip: what it decides, and what it drives at most, at the pins."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from chip_host import HELD, QUIET, SETUP, ChipHost, armed_chip
from device_strokes import DeviceStrokes
from virtual_host import Told

from rig.backends.serial.emulated.firmware_build import PLAIN_VARIANT, Variant
from rig.backends.serial.frames import STATUS_ARMED, STATUS_LAW, Kind, StrokesSetup
from rig.model.bench import BenchParameters, SensorWiring

STROKES = StrokesSetup(((40, 560), (-45, 460), (32, 540), (-35, 480)), 2000, 2000, 5, 10)
BRIEF = STROKES._replace(stroke_ticks=250, still_ticks=120)
FAST = Variant(baud=1_000_000)
CLOCK_US = 8  # two steps of the chip's clock
LOOK_S = 0.5e-3


class Running(Told):
    """A chip whose strokes drive, all that it says of them, and what is at its pins meanwhile."""

    def __init__(
        self, strokes: StrokesSetup = STROKES, options: Variant = PLAIN_VARIANT, bench: BenchParameters = QUIET
    ) -> None:
        super().__init__()
        self.strokes = strokes
        self.host: ChipHost = armed_chip(bench, SETUP, options)
        packet = self.host.ask(Kind.STROKES, strokes.pack())
        assert packet.kind == Kind.STROKES_REPLY and StrokesSetup.unpack(packet.body) == strokes
        self.pins: list[tuple[float, float]] = []  # time, mean voltage

    def run(self, duration_s: float) -> None:
        """Let the host's loop go on, and look at the pins all the while."""
        board = self.host.board
        end_s, keeps_s = board.now_s() + duration_s, board.now_s()
        while board.now_s() < end_s:
            if board.now_s() >= keeps_s:
                self.host.send(Kind.KEEP)
                keeps_s += 9.7e-3
            board.sleep_until(board.now_s() + LOOK_S)
            self.pins.append((board.now_s(), board.truth().pin_V))
            self.take(board.read(0.0))


@pytest.mark.parametrize("options", [PLAIN_VARIANT, FAST], ids=["115200", "1000000"])
def test_every_tick_is_decided_by_the_law_also_while_the_main_loop_is_busy(options: Variant) -> None:
    running = Running(options=options)
    for _ in range(4):
        running.run(0.3)
        running.host.board.stall("main loop", 18e-3)
        running.run(0.05)
    rows = running.rows()
    law = DeviceStrokes(STROKES.strokes, SETUP.centre, (2000, 2000), STROKES.still_counts, SETUP.polarity)
    assert [drive for _, _, drive in rows] == [law.step(counts) for _, counts, _ in rows]
    assert {drive for _, _, drive in rows} == {40, -45, 32, -35}
    assert running.numbers == list(range(len(running.numbers))) and len(rows) > 1300
    assert all(abs(b - a - 1000) <= CLOCK_US for (a, *_), (b, *_) in pairwise(rows))
    assert running.host.truth().resets == 0 and running.host.state().status == STATUS_ARMED | STATUS_LAW


@pytest.mark.parametrize("sensor", ["stuck", "ok"])
def test_a_reading_that_stands_still_ends_it_after_two_strokes(sensor: SensorWiring) -> None:
    """P12 at the pins, though the host lives: a frozen sensor, or a shaft that the drive does not move."""
    running = Running(BRIEF, bench=QUIET if sensor == "stuck" else replace(HELD, noise_rad=0.0))
    began_s = running.host.board.now_s()
    running.host.board.rewire(sensor=sensor)
    running.run(1.0)
    driven = [(t_s - began_s, pin_V) for t_s, pin_V in running.pins if pin_V != 0.0]
    assert driven[-1][0] < 2 * 0.123
    assert [a > 0.0 for (_, a), (_, b) in pairwise(driven) if (a > 0.0) != (b > 0.0)] == [True]  # one turn
    assert running.host.state().status == STATUS_ARMED | STATUS_LAW and running.host.truth().resets == 0
    running.host.drive(30)  # and the host can take over
    assert running.host.pin_V() > 0.0


def test_a_stroke_that_takes_too_long_ends_after_its_time() -> None:
    """To the tick, at the pins: the shaft moves, but its turning points are too far for the time."""
    far = StrokesSetup(((60, 900), (-60, 100)), 150, 150, 1, 10)
    running = Running(far)
    running.run(0.6)
    drives = [drive for _, _, drive in running.rows()]
    assert drives[:302] == [60] * 151 + [-60] * 151 and set(drives[302:]) == {0}
    signs = [(pin_V > 0.0) - (pin_V < 0.0) for _, pin_V in running.pins]
    assert signs[-400:] == [0] * 400 and -1 in signs and 1 in signs
