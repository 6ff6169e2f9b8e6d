"""An encoder at the Pico's pins GP2 and GP3: what is counted, and what its faults do to the drive, in virtual time."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest
from evidence import evidence
from pico_host import PICO_FULL, PicoHost, pico
from test_hil_encoder import COUNTS_PER_RAD, ENDLESS, LIMITED, MOTOR, STILL_EDGES
from virtual_host import TICK_S

from rig.backends.serial.emulated.firmware_build import Variant
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
from rig.model.bench import BenchParameters
from rig.model.friction import coulomb
from rig.model.motor import Motor

OPTIONS = Variant(baud=1_000_000, encoder=True)
LARGEST_RATE = 2_000_000  # edges a second: firmware/boards/pico/encoder.h
FAR = LIMITED._replace(hard_lo=-(10**9), hard_hi=10**9, max_drive=PICO_FULL // 2)
DRIVE = 600  # units, 1.15 V


def turning(counts_per_s: float) -> BenchParameters:
    """A shaft that turns at 1 rad/s, with so many counts a radian."""
    return replace(MOTOR, motor=Motor(1e9, 6.5, coulomb(0.5)), rad_per_count=1.0 / counts_per_s)


def zero(host: PicoHost, counts: int = 0) -> DeviceState:
    packet = host.ask(Kind.ZERO, pack_zero(counts))
    assert packet.kind == Kind.ZERO_REPLY
    return DeviceState.unpack(packet.body)


def arm(host: PicoHost, setup: Setup = FAR) -> None:
    """With the encoder's zero where the shaft stands."""
    host.setup(setup)
    assert host.arm_anew() == Code.NO_ZERO
    assert zero(host).counts == 0
    assert host.arm() == Code.NONE


@contextmanager
def armed(bench: BenchParameters = MOTOR, setup: Setup = FAR) -> Iterator[PicoHost]:
    with pico(bench, OPTIONS) as host:
        arm(host, setup)
        yield host


def off_within(host: PicoHost, longest_s: float) -> None:
    """From now on; the pins stay at 0."""
    event_s = host.board.now_s()
    host.board.sleep_until(event_s + longest_s)
    assert host.pin_V() == 0.0
    host.wait(0.02)
    assert host.pin_V() == 0.0


@pytest.mark.parametrize(("rate", "way"), [(1_900_000, -1.0), *evidence((240_000, 1.0), (12_500, -1.0))])
def test_no_count_is_lost_up_to_the_bound(rate: int, way: float) -> None:
    """While the host asks for everything as fast as it may."""
    bench = turning(rate)
    with pico(bench, OPTIONS) as host:
        host.acknowledge(Code.RESET)
        host.setup(ENDLESS)
        zero(host)
        host.board.place(0.0, way)
        until_s = host.board.now_s() + (0.1 if rate < 1_000_000 else 0.03)
        while host.board.now_s() < until_s:
            state, true = host.state(), host.truth().y_rad * rate
            host.hello()
            assert state.fault == Code.NONE
            # the sample is older than what is true now by the way of the reply
            assert abs(state.counts - true) < 2.0 + 1.1e-3 * rate
        host.board.place(host.truth().y_rad, 0.0)
        host.wait(0.01)
        assert abs(host.state().counts - host.truth().y_rad * rate) <= 1.0
        assert host.truth().overruns == 0 and host.board.broken_rule() == ""


@pytest.mark.parametrize("rate", [1.2 * LARGEST_RATE, *evidence(5 * LARGEST_RATE)])
def test_edges_too_fast_to_count_are_a_fault_within_three_ticks(rate: float) -> None:
    with armed(turning(rate)) as host:
        host.drive(DRIVE)
        host.wait(0.0037)
        host.board.place(0.0, 1.0)
        off_within(host, 3 * TICK_S)
        assert host.truth().resets == 0
        state = host.state()
        assert state.fault in (Code.ENCODER_RATE, Code.ENCODER_LOST) and not state.status & STATUS_ZERO
        host.board.place(0.0, 0.0)
        host.wait(0.05)
        assert host.arm_anew() == Code.NO_ZERO


def test_two_channels_at_once_mean_0_V_within_two_ticks_and_no_zero() -> None:
    rng = random.Random(3)
    with armed() as host:
        for _ in range(5):
            host.drive(DRIVE)
            host.wait(rng.uniform(0.0, 0.02))
            host.board.rewire(sensor="jumped")
            off_within(host, 2 * TICK_S)
            assert host.arm() == Code.ENCODER_LOST
            assert not host.state().status & STATUS_ZERO
            host.board.rewire()
            host.board.place(0.0)
            host.wait(0.1)
            arm(host)


@pytest.mark.parametrize("units", [625, *evidence(-3125)])
def test_a_channel_that_stands_still_ends_the_drive_after_its_bound(units: int) -> None:
    """In counts of travel, whatever the speed."""
    with armed() as host:
        for _ in range(6):
            host.drive(units)
            host.wait(0.0137)
        began_rad = host.truth().y_rad
        host.board.rewire(sensor="still")
        while host.pin_V() != 0.0:
            host.wait(TICK_S)
            host.drive(units)
        truth = host.truth()
        gone = abs(truth.y_rad - began_rad) * COUNTS_PER_RAD
        assert gone <= 2 * (STILL_EDGES + 2) + abs(truth.v_rad_per_s) * 4 * TICK_S * COUNTS_PER_RAD
        assert host.state().fault == Code.ENCODER_STILL
        assert host.arm_anew() == Code.NO_ZERO


@pytest.mark.parametrize("hang", ["everything", *evidence("counter", "tick", "main loop")])
def test_a_hung_program_loses_its_zero_and_the_drive(hang: Any) -> None:
    with armed(setup=FAR._replace(watchdog_ms=1000)) as host:
        host.drive(DRIVE)
        host.board.hang(hang)
        off_within(host, 0.13)
        assert host.truth().resets == 1
        assert host.arm_anew() == Code.NO_SETUP
        host.setup(FAR)
        assert host.arm() == Code.NO_ZERO


def test_a_limit_is_kept_in_counts_from_the_zero_and_a_reset_ends_that() -> None:
    with armed(setup=FAR._replace(hard_lo=-100, hard_hi=100)) as host:
        while host.pin_V() != 0.0 or host.board.now_s() < 0.1:
            host.drive(900)
            host.wait(0.01)
        assert host.state().fault == Code.TRAVEL
        assert 100 < host.state().counts < 200
        host.board.reset(2)
        host.wait(0.01)
        host.setup(FAR)
        assert host.arm_anew() == Code.NO_ZERO


def test_the_relay_in_the_chip_swings_about_any_centre_of_counts() -> None:
    """Without limits, which takes an e-stop that was tried."""
    centre = 1_000_000
    with pico(MOTOR, OPTIONS) as host:
        host.acknowledge(Code.RESET)
        host.setup(ENDLESS._replace(max_drive=PICO_FULL // 2))
        zero(host, centre)
        assert host.arm() == Code.E_STOP_UNTRIED
        host.board.contact("e_stop", is_open=True)
        host.wait(0.01)
        host.board.contact("e_stop", is_open=False)
        assert host.arm_anew() == Code.NONE
        relay = RelaySetup((-1100, -310, 310, 1100), 16 * centre, 2**24, 1, 10)
        assert host.ask(Kind.RELAY, relay.pack()).kind == Kind.RELAY_REPLY
        reader, blocks = FrameReader(), []
        for _ in range(100):
            host.send(Kind.KEEP)
            host.wait(0.02)
            packets = reader.feed(host.board.read(0.0))
            blocks += [Block.unpack(packet.body) for packet in packets if packet.kind == Kind.BLOCK]
        assert all(block.status & STATUS_LAW for block in blocks)
        away = [counts - centre for block in blocks for counts, _ in block.rows]
        assert len(away) > 1900 and min(away[900:]) < -20 and max(away[900:]) > 20 and max(map(abs, away)) < 2000
