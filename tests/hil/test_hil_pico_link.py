"""The Pico's firmware on its emulated chip, pins, tick and relay."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import pairwise

import pytest
from device_relay import DeviceRelay
from device_strokes import DeviceStrokes
from evidence import evidence
from pico_host import BENCH, HELD, PICO_FULL, QUIET, SETUP, UNIT_V, armed_pico, pico
from virtual_host import TICK_S, Told

from emulated_chips.pico_parameters import pico_parameters
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.emulated.errors import EmulationError
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.frames import (
    STATUS_ARMED,
    STATUS_LAW,
    Code,
    Kind,
    RelaySetup,
    StrokesSetup,
)

BRIDGES = [Variant(), Variant(bridge="IN1_IN2")]
FAST = Variant(baud=1_000_000)
RELAY = RelaySetup((-780, 250, -250, 780), 2048 * 16, 12_000_000, 1, 10)
STROKES = StrokesSetup(((625, 2240), (-700, 1840), (500, 2160), (-550, 1920)), 2000, 2000, 20, 10)
UNIT_S = 1 / 125e6  # of a pulse, for each unit of drive
CYCLES_S = 12 / 125e6  # of a few instructions


@pytest.mark.parametrize("options", BRIDGES, ids=lambda o: o.bridge)
def test_no_pulse_is_longer_than_its_share(options: Variant) -> None:
    """The first one after a reset, and any after a zero, a turn or a change, at any phase of the counter."""
    rng = random.Random(3)
    last = 0
    with armed_pico(HELD, SETUP._replace(max_drive=PICO_FULL), options) as host:
        assert host.board.longest_pulse_s() == 0.0
        for units in [6000, 0, 1, -1, 0, 40, 0, -900, 900, 30, 0, 3000, -3000, 0, 80, -80, PICO_FULL, -7, 0] * 3:
            host.wait(rng.uniform(0.0, 100e-6))
            host.drive(units)
            host.wait(0.0003)
            most_s = host.board.longest_pulse_s()
            if PICO_FULL not in (abs(units), abs(last)):
                assert most_s <= max(abs(units), abs(last)) * UNIT_S + CYCLES_S
                host.wait(0.001)
                assert host.board.longest_pulse_s() == pytest.approx(abs(units) * UNIT_S, abs=CYCLES_S)
            assert host.pin_V() == pytest.approx(units * UNIT_V, abs=1e-9)
            last = units
        assert host.board.broken_rule() == ""


def test_a_zero_cuts_a_long_pulse_and_the_next_drive_does_not_take_it_up() -> None:
    """At any phase of a period of 50 us: off, and at once on again with one unit."""
    with armed_pico(HELD, SETUP._replace(max_drive=PICO_FULL), FAST) as host:
        for k in range(30):
            host.drive(6000)
            host.wait(0.0005 + 1.7e-6 * k)
            host.board.longest_pulse_s()
            host.drive(0)
            host.board.longest_pulse_s()
            host.drive(1)
            host.wait(0.0005)
            assert host.board.longest_pulse_s() <= UNIT_S + CYCLES_S


@pytest.mark.parametrize("stall_s", [*evidence(0.0), 0.018])
def test_the_relay_in_the_chip_decides_each_millisecond_by_the_law(stall_s: float) -> None:
    """Each row is on the grid of the ticks, and its drive the law's, while the main loop is busy for 18 ms, too."""
    told = Told()
    with armed_pico(QUIET) as host:
        board = host.board
        host.send(Kind.RELAY, RELAY.pack())
        for k in range(30):
            host.send(Kind.KEEP)
            if stall_s and k % 5 == 2:
                board.stall("main loop", stall_s)
            host.wait(0.0093)
            told.take(board.read(0.0))
        assert board.broken_rule() == "" and host.truth().resets == 0
    rows = told.rows()
    assert len(rows) > 200 and told.numbers == list(range(len(told.numbers)))
    assert all(abs(later - now - 1000) <= 1 for (now, *_), (later, *_) in pairwise(rows))
    law = DeviceRelay(RELAY.centre, RELAY.z_bound, RELAY.drive, RELAY.direction)
    assert all(drive == law.step(counts) for _, counts, drive in rows)
    assert len({drive for *_, drive in rows}) == 4 and max(b.delay_us for b in told.blocks) < 12


@pytest.mark.parametrize("options", [*evidence((Variant(),)), FAST], ids=["115200", str(FAST.baud)])
def test_the_strokes_in_the_chip_are_the_laws_and_at_its_pins(options: Variant) -> None:
    """Each row's drive is the law's, on the grid of the ticks, also while the main loop is busy; the pins follow it."""
    told, pins = Told(), set()
    with armed_pico(QUIET, options=options) as host:
        board = host.board
        packet = host.ask(Kind.STROKES, STROKES.pack())
        assert packet.kind == Kind.STROKES_REPLY and StrokesSetup.unpack(packet.body) == STROKES
        for k in range(100):
            host.send(Kind.KEEP)
            if k % 20 == 10:
                board.stall("main loop", 0.018)
            host.wait(0.0093)
            pins.add(round(host.pin_V() / UNIT_V))
            told.take(board.read(0.0))
        assert host.state().status == STATUS_ARMED | STATUS_LAW
        assert board.broken_rule() == "" and host.truth().resets == 0
    rows = told.rows()
    assert len(rows) > 850 and told.numbers == list(range(len(told.numbers)))
    assert all(
        abs(later - now - 1000) <= 3 for (now, *_), (later, *_) in pairwise(rows)
    )  # a byte's interrupt may go first
    law = DeviceStrokes(STROKES.strokes, SETUP.centre, (2000, 2000), STROKES.still_counts, SETUP.polarity)
    assert all(drive == law.step(counts) for _, counts, drive in rows)
    assert {drive for *_, drive in rows} == {625, -700, 500, -550} >= pins and len(pins) == 4


def test_requests_at_any_phase_of_the_tick_cost_no_tick() -> None:
    told = Told()
    with armed_pico(QUIET, options=FAST) as host:
        host.send(Kind.RELAY, RELAY.pack())
        rng = random.Random(1)
        for _ in range(60):
            host.send(Kind.KEEP)
            host.send(Kind.READ)
            host.wait(rng.uniform(0.4e-3, 3e-3))
            told.take(host.board.read(0.0))
    times = [b.t_first_us for b in told.blocks]
    assert len(times) > 8
    assert all(later - now == pytest.approx(10 * 1000, abs=1) for now, later in pairwise(times))


def test_the_watchdog_for_the_hosts_silence_outlives_the_main_loop() -> None:
    """It is the tick's: off in time, and reset by the hardware watchdog later."""
    rng = random.Random(4)
    setup = SETUP._replace(watchdog_ms=50)
    with armed_pico(HELD, setup) as host:
        for _ in range(6):
            host.drive(900)
            heard_s = host.heard_s
            host.wait(rng.uniform(0.0, 0.01))
            host.board.hang("main loop")
            host.board.sleep_until(heard_s + 0.05 - TICK_S)
            assert host.pin_V() > 0.0
            host.board.sleep_until(heard_s + 0.05 + TICK_S)
            assert host.pin_V() == 0.0 and host.truth().pin_changed_s > heard_s + 0.05 - TICK_S
            host.wait(0.15)
            host.acknowledge(Code.RESET)
            host.setup(setup)
            assert host.arm_anew() == Code.NONE


def test_what_is_not_possible_is_said() -> None:
    with pytest.raises(EmulationError, match="tau-s"):
        VirtualPico(pico_parameters(BENCH) | {"options": [["counts-max", "4095"], ["tau-s", "-1"]]})
    with pytest.raises(EmulationError, match="0 to 4095"):
        VirtualPico(pico_parameters(replace(BENCH, counts_max=1023)))
    with pytest.raises(EmulationError, match="baud rate"):
        pico_parameters(BENCH, options=Variant(baud=9_000_000))
    with pico() as host, pytest.raises(EmulationError, match="no such wiring"):
        host.board.rewire(sensor="gone")  # type: ignore[arg-type]
    ended = VirtualPico(pico_parameters(BENCH))
    ended.end()
    with pytest.raises(EmulationError, match="has ended"):
        ended.truth()
