"""An encoder at the Uno's pins D2 and D3: what is counted, and what its faults do to the drive, in virtual time."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from chip_host import SETTLE_S, ChipHost
from evidence import evidence
from virtual_host import SESSION, TICK_S, VirtualHost

from emulated_chips.virtual_chip import VirtualChip
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.frames import (
    STATUS_LAW,
    STATUS_ZERO,
    Block,
    Code,
    DeviceState,
    FrameReader,
    Kind,
    RelaySetup,
    Setup,
    pack_zero,
)
from rig.core.calibration import ALL_COUNTS
from rig.model.bench import BenchParameters, SensorWiring
from rig.model.friction import coulomb
from rig.model.motor import Motor

UNO = Variant(baud=1_000_000, encoder=True)
PHASES = 10
COUNTS_PER_RAD = 500.0
MOTOR = BenchParameters(
    Motor(0.17, 6.5, coulomb(0.5)), rad_per_count=1.0 / COUNTS_PER_RAD, stop_rad=(-1e6, 1e6), encoder=True
)
LIMITED = Setup(SESSION, -1000, 1000, 0, 0, 0, 200, 100, 1)
ENDLESS = LIMITED._replace(hard_lo=ALL_COUNTS[0], hard_hi=ALL_COUNTS[1])
LARGEST_RATE = 40_000  # edges a second: firmware/boards/uno/encoder.h
STILL_EDGES = 32


def turning(counts_per_s: float) -> BenchParameters:
    """A shaft that turns at 1 rad/s, with so many counts a radian."""
    return replace(MOTOR, motor=Motor(1e9, 6.5, coulomb(0.5)), rad_per_count=1.0 / counts_per_s)


def chip_at(bench: BenchParameters) -> ChipHost:
    host = ChipHost(VirtualChip(bench, options=UNO), UNO.baud)
    host.acknowledge(Code.RESET)
    return host


def zero(host: ChipHost | VirtualHost, counts: int = 0) -> DeviceState:
    packet = host.ask(Kind.ZERO, pack_zero(counts))
    assert packet.kind == Kind.ZERO_REPLY
    return DeviceState.unpack(packet.body)


def armed_chip(bench: BenchParameters = MOTOR, setup: Setup = LIMITED) -> ChipHost:
    host = chip_at(bench)
    host.setup(setup)
    assert zero(host).counts == 0
    assert host.arm() == Code.NONE
    return host


def true_counts(host: ChipHost, bench: BenchParameters) -> float:
    return host.truth().y_rad / bench.rad_per_count


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("rate", [12_500, 39_000, *evidence(2_546)])
def test_no_count_is_lost_up_to_the_bound(rate: int, way: float) -> None:
    """While the host asks for everything as fast as it may, over more counts than 16 bits hold."""
    bench = turning(rate)
    host = chip_at(bench)
    host.setup(ENDLESS)
    zero(host)
    host.board.place(0.0, way)
    seconds = 2.0 if rate == 39_000 else 0.5
    while host.board.now_s() < seconds:
        state, true = host.state(), true_counts(host, bench)
        host.hello()
        assert state.fault == Code.NONE
        # the sample is older than what is true now by the way of the reply
        assert abs(state.counts - true) < 2.0 + 1.1e-3 * rate
    host.board.place(host.truth().y_rad, 0.0)
    host.wait(0.01)
    assert abs(host.state().counts - true_counts(host, bench)) <= 1.0
    assert rate != 39_000 or abs(host.state().counts) > 2**16


@pytest.mark.parametrize("rate", [10 * LARGEST_RATE, *evidence(1.2 * LARGEST_RATE, 100 * LARGEST_RATE)])
def test_edges_too_fast_to_count_are_a_fault_within_two_ticks_whatever_their_rate(rate: float) -> None:
    bench = turning(rate)
    rng = random.Random(int(rate))
    for _ in range(PHASES):
        host = armed_chip(bench, LIMITED._replace(hard_lo=-(10**9), hard_hi=10**9))
        host.drive(20)
        host.wait(rng.uniform(0.0, 0.01))
        host.board.place(0.0, 1.0)
        off_at_zero_within(host, 3 * TICK_S)
        assert host.truth().resets == 0
        host.wait(0.2)  # as long as the edges come
        state = patient_state(host)
        assert state.fault in (Code.ENCODER_RATE, Code.ENCODER_LOST) and not state.status & STATUS_ZERO
    host.board.place(0.0, 0.0)
    host.wait(0.1)
    assert host.arm_anew() == Code.NO_ZERO


def patient_state(host: ChipHost) -> DeviceState:
    """Edges that storm in keep the receiver waiting for up to a fifth of the time: a frame may be lost."""
    for _ in range(20):
        host.wait(0.7 * TICK_S)
        host.send(Kind.READ)
        packets = host.heard(0.005)
        if packets:
            return DeviceState.unpack(packets[-1].body)
    raise AssertionError("no frame came through")


def off_at_zero_within(host: ChipHost, longest_s: float) -> float:
    """How long after now the pins went to 0, at most ``longest_s``; they stay there."""
    event_s = host.board.now_s()
    host.board.sleep_until(event_s + longest_s)
    assert host.pin_V() == 0.0
    host.wait(0.02)
    assert host.pin_V() == 0.0
    return host.truth().pin_changed_s - event_s


def test_two_channels_at_once_mean_0_V_within_two_ticks_and_no_zero() -> None:
    rng = random.Random(3)
    for _ in range(PHASES):
        host = armed_chip()
        host.drive(40)
        host.wait(rng.uniform(0.0, 0.02))
        host.board.rewire(sensor="jumped")
        off_at_zero_within(host, 2 * TICK_S)
    assert host.arm() == Code.ENCODER_LOST
    assert not host.state().status & STATUS_ZERO
    assert host.arm_anew() == Code.NO_ZERO


def test_a_dead_clock_looks_like_too_many_edges_and_the_watchdog_resets_the_chip_all_the_same() -> None:
    """Why `hang: clock, encoder` of docs/evidence/safety-table.md is shorter than the hardware watchdog's time."""
    host = armed_chip()
    host.drive(40)
    host.wait(0.09)  # 2,000 edges a second by then
    host.drive(40)
    hung_s = host.board.now_s()
    host.board.hang("clock")
    while host.board.now_s() < hung_s + 0.05:
        host.wait(0.01)
        state = host.state()
    assert state.fault == Code.ENCODER_RATE and host.pin_V() == 0.0
    assert host.truth().resets == 0
    host.board.sleep_until(hung_s + 0.15)
    assert host.truth().resets == 1 and host.pin_V() == 0.0


@pytest.mark.parametrize("units", [40, 200, -200])
def test_a_channel_that_stands_still_ends_the_drive_after_its_bound(units: int) -> None:
    """In counts of travel, whatever the speed."""
    rng = random.Random(units)
    for _ in range(PHASES):
        host = armed_chip(setup=LIMITED._replace(hard_lo=-(10**9), hard_hi=10**9))
        host.drive(units)
        for _ in range(5):
            host.wait(rng.uniform(0.005, 0.02))
            host.drive(units)
        began_rad = host.truth().y_rad
        host.board.rewire(sensor="still")
        while host.pin_V() != 0.0:
            host.wait(TICK_S)
            host.drive(units)
        speed = abs(host.truth().v_rad_per_s)
        gone = abs(host.truth().y_rad - began_rad)
        assert gone * COUNTS_PER_RAD <= 2 * (STILL_EDGES + 2) + speed * 4 * TICK_S * COUNTS_PER_RAD
    assert host.state().fault == Code.ENCODER_STILL
    assert host.arm_anew() == Code.NO_ZERO


@pytest.mark.parametrize("cause", [1, 2, 4])
def test_a_reset_ends_the_zero(cause: int) -> None:
    host = armed_chip()
    host.board.place(0.5)
    host.wait(0.05)
    host.board.reset(cause)
    host.wait(0.01)
    assert host.arm_anew() == Code.NO_SETUP
    host.setup(LIMITED)
    assert host.arm() == Code.NO_ZERO
    host.drive(60)
    assert host.pin_V() == 0.0
    assert zero(host, 250).counts == 250 and host.arm() == Code.NONE


@pytest.mark.parametrize("hang", ["clock", "tick", "main loop", "everything"])
def test_a_hung_program_loses_its_zero_and_the_drive(hang: str) -> None:
    host = armed_chip(setup=LIMITED._replace(watchdog_ms=1000))
    host.drive(20)
    host.board.hang(hang)  # type: ignore[arg-type]
    off_at_zero_within(host, 0.15)
    assert host.truth().resets == 1
    assert host.arm_anew() == Code.NO_SETUP


def test_a_limit_is_kept_in_counts_from_the_zero() -> None:
    host = armed_chip(setup=LIMITED._replace(hard_lo=-100, hard_hi=100))
    while host.pin_V() != 0.0 or host.board.now_s() < 0.1:
        host.drive(60)
        host.wait(0.01)
    assert host.state().fault == Code.TRAVEL
    assert 100 < host.state().counts < 200


def test_without_limits_the_e_stop_is_tried_first() -> None:
    host = chip_at(MOTOR)
    host.setup(ENDLESS)
    zero(host)
    assert host.arm() == Code.E_STOP_UNTRIED
    host.board.contact("e_stop", is_open=True)
    host.wait(0.05)
    host.board.contact("e_stop", is_open=False)
    host.wait(0.05)
    assert host.arm_anew() == Code.NONE
    host.board.contact("e_stop", is_open=True)
    host.wait(SETTLE_S)
    assert host.pin_V() == 0.0 and host.state().fault == Code.E_STOP


def test_the_relay_in_the_chip_swings_about_any_centre_of_counts() -> None:
    host = chip_at(MOTOR)
    host.setup(ENDLESS)
    host.board.contact("e_stop", is_open=True)
    host.wait(0.01)
    host.board.contact("e_stop", is_open=False)
    centre = 1_000_000
    zero(host, centre)
    assert host.arm_anew() == Code.NONE
    relay = RelaySetup((-70, -20, 20, 70), 16 * centre, 2**24, 1, 10)
    assert host.ask(Kind.RELAY, relay.pack()).kind == Kind.RELAY_REPLY
    reader, blocks = FrameReader(), []
    for _ in range(200):
        host.send(Kind.KEEP)
        host.wait(0.02)
        packets = reader.feed(host.board.read(0.0))
        blocks += [Block.unpack(packet.body) for packet in packets if packet.kind == Kind.BLOCK]
    assert all(block.status & STATUS_LAW for block in blocks)
    away = [counts - centre for block in blocks for counts, _ in block.rows]
    assert len(away) > 3900
    assert min(away[2000:]) < -20 and max(away[2000:]) > 20 and max(map(abs, away)) < 2000
    assert abs(away[-1] - true_counts(host, MOTOR)) < 60  # since that row the shaft has gone on


@pytest.mark.parametrize("sensor", ["jumped", "still"])
def test_the_host_board_has_the_same_faults(sensor: SensorWiring) -> None:
    host = VirtualHost(VirtualBoard(MOTOR))
    host.acknowledge(Code.RESET)
    host.setup(LIMITED)
    assert host.arm() == Code.NO_ZERO
    zero(host)
    assert host.arm() == Code.NONE
    host.drive(90)
    host.board.rewire(sensor=sensor)
    while host.pin_V() != 0.0 and host.board.now_s() < 2.0:
        host.wait(0.005)
        host.drive(90)
    assert host.state().fault == (Code.ENCODER_LOST if sensor == "jumped" else Code.ENCODER_STILL)
