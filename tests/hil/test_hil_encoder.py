"""An encoder at the pins of Uno and Pico: what is counted, and what its faults do to the drive, in virtual time."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest
from both_chips import PICO, UNO, Chip, name_of
from chip_host import SETTLE_S, ChipHost
from evidence import evidence
from pico_host import PicoHost
from virtual_host import SESSION, TICK_S, Told, VirtualHost

from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.frames import (
    STATUS_LAW,
    STATUS_ZERO,
    Code,
    DeviceState,
    Kind,
    RelaySetup,
    Setup,
    pack_zero,
)
from rig.core.calibration import ALL_COUNTS
from rig.model.bench import BenchParameters, SensorWiring
from rig.model.friction import coulomb
from rig.model.motor import Motor

ChipsHost = ChipHost | PicoHost
BOTH = pytest.mark.parametrize("chip", [UNO, PICO], ids=name_of)
WIRED = Variant(baud=1_000_000, encoder=True)
COUNTS_PER_RAD = 500.0
MOTOR = BenchParameters(
    Motor(0.17, 6.5, coulomb(0.5)), rad_per_count=1.0 / COUNTS_PER_RAD, stop_rad=(-1e6, 1e6), encoder=True
)
LIMITED = Setup(SESSION, -1000, 1000, 0, 0, 0, 200, 100, 1)
FAR = LIMITED._replace(hard_lo=-(10**9), hard_hi=10**9)
ENDLESS = LIMITED._replace(hard_lo=ALL_COUNTS[0], hard_hi=ALL_COUNTS[1])
STILL_EDGES = 32


def turning(counts_per_s: float) -> BenchParameters:
    """A shaft that turns at 1 rad/s, with so many counts a radian."""
    return replace(MOTOR, motor=Motor(1e9, 6.5, coulomb(0.5)), rad_per_count=1.0 / counts_per_s)


def zero(host: ChipsHost | VirtualHost, counts: int = 0) -> DeviceState:
    packet = host.ask(Kind.ZERO, pack_zero(counts))
    assert packet.kind == Kind.ZERO_REPLY
    return DeviceState.unpack(packet.body)


def arm(chip: Chip, host: ChipsHost, setup: Setup) -> None:
    """With the encoder's zero where the shaft stands."""
    set_up(chip, host, setup)
    assert host.arm_anew() == Code.NO_ZERO
    assert zero(host).counts == 0
    assert host.arm() == Code.NONE


def set_up(chip: Chip, host: ChipsHost, setup: Setup) -> None:
    host.setup(setup._replace(max_drive=chip.setup.max_drive))


@contextmanager
def armed(chip: Chip, bench: BenchParameters = MOTOR, setup: Setup = LIMITED) -> Iterator[ChipsHost]:
    with chip.powered(bench, WIRED) as host:
        arm(chip, host, setup)
        yield host


def true_counts(host: ChipsHost, bench: BenchParameters) -> float:
    return host.truth().y_rad / bench.rad_per_count


@pytest.mark.parametrize(
    ("chip", "rate", "way", "seconds"),
    [
        *((UNO, rate, way, 2.0 if rate == 39_000 else 0.5) for rate in (12_500, 39_000) for way in (1.0, -1.0)),
        (PICO, 1_900_000, -1.0, 0.03),
        *evidence((UNO, 2_546, 1.0, 0.5), (UNO, 2_546, -1.0, 0.5)),
        *evidence((PICO, 240_000, 1.0, 0.1), (PICO, 12_500, -1.0, 0.1)),
    ],
    ids=name_of,
)
def test_no_count_is_lost_up_to_the_bound(chip: Chip, rate: int, way: float, seconds: float) -> None:
    """While the host asks for everything as fast as it may; on the Uno over more counts than 16 bits hold."""
    bench = turning(rate)
    with chip.powered(bench, WIRED) as host:
        host.acknowledge(Code.RESET)
        host.setup(ENDLESS)
        zero(host)
        host.board.place(0.0, way)
        until_s = host.board.now_s() + seconds
        while host.board.now_s() < until_s:
            state, true = host.state(), true_counts(host, bench)
            host.hello()
            assert state.fault == Code.NONE
            # the sample is older than what is true now by the way of the reply
            assert abs(state.counts - true) < 2.0 + 1.1e-3 * rate
        host.board.place(host.truth().y_rad, 0.0)
        host.wait(0.01)
        assert abs(host.state().counts - true_counts(host, bench)) <= 1.0
        assert rate != 39_000 or abs(host.state().counts) > 2**16
        assert chip is UNO or (host.truth().overruns == 0 and host.board.broken_rule() == "")


@pytest.mark.parametrize(
    ("chip", "rate"),  # the largest are 40,000 and 2,000,000 edges a second: encoder.h of firmware/boards
    [(UNO, 4e5), (PICO, 2.4e6), *evidence((UNO, 4.8e4), (UNO, 4e6), (PICO, 1e7))],
    ids=name_of,
)
def test_edges_too_fast_to_count_are_a_fault_within_two_ticks_whatever_their_rate(chip: Chip, rate: float) -> None:
    rng = random.Random(int(rate))
    for _ in range(10 if chip is UNO else 1):
        with armed(chip, turning(rate), FAR) as host:
            host.drive(chip.drive)
            host.wait(rng.uniform(0.0, 0.01))
            host.board.place(0.0, 1.0)
            off_at_zero_within(host, 3 * TICK_S)
            assert host.truth().resets == 0
            host.wait(0.2 if chip is UNO else 0.0)  # as long as the edges come
            state = patient_state(host)
            assert state.fault in (Code.ENCODER_RATE, Code.ENCODER_LOST) and not state.status & STATUS_ZERO
            host.board.place(0.0, 0.0)
            host.wait(0.1)
            assert host.arm_anew() == Code.NO_ZERO


def patient_state(host: ChipsHost) -> DeviceState:
    """Edges that storm in keep the Uno's receiver waiting for up to a fifth of the time: a frame may be lost."""
    for _ in range(20):
        host.wait(0.7 * TICK_S)
        host.send(Kind.READ)
        packets = host.heard(0.005)
        if packets:
            return DeviceState.unpack(packets[-1].body)
    raise AssertionError("no frame came through")


def off_at_zero_within(host: ChipsHost, longest_s: float) -> None:
    """From now on, at most ``longest_s``; the pins stay at 0."""
    host.board.sleep_until(host.board.now_s() + longest_s)
    assert host.pin_V() == 0.0
    host.wait(0.02)
    assert host.pin_V() == 0.0


@BOTH
def test_two_channels_at_once_mean_0_V_within_two_ticks_and_no_zero(chip: Chip) -> None:
    rng = random.Random(3)
    for _ in range(10 if chip is UNO else 5):
        with armed(chip) as host:
            host.drive(chip.full // 10)
            host.wait(rng.uniform(0.0, 0.02))
            host.board.rewire(sensor="jumped")
            off_at_zero_within(host, 2 * TICK_S)
            assert host.arm() == Code.ENCODER_LOST
            assert not host.state().status & STATUS_ZERO
            host.board.rewire()
            host.board.place(0.0)
            host.wait(0.1)
            arm(chip, host, LIMITED)


def test_a_dead_clock_looks_like_too_many_edges_and_the_watchdog_resets_the_chip_all_the_same() -> None:
    """Why `hang: clock, encoder` of docs/evidence/safety-table.md is shorter than the hardware watchdog's time."""
    with armed(UNO) as host:
        host.drive(40)
        host.wait(0.09)  # 2,000 edges a second by then
        host.drive(40)
        hung_s = host.board.now_s()
        hang(host, "clock")
        while host.board.now_s() < hung_s + 0.05:
            host.wait(0.01)
            state = host.state()
        assert state.fault == Code.ENCODER_RATE and host.pin_V() == 0.0
        assert host.truth().resets == 0
        host.board.sleep_until(hung_s + 0.15)
        assert host.truth().resets == 1 and host.pin_V() == 0.0


@pytest.mark.parametrize(
    ("chip", "units"),
    [(UNO, 40), (UNO, 200), (UNO, -200), (PICO, 625), *evidence((PICO, -3125))],
    ids=name_of,
)
def test_a_channel_that_stands_still_ends_the_drive_after_its_bound(chip: Chip, units: int) -> None:
    """In counts of travel, whatever the speed."""
    rng = random.Random(units)
    for _ in range(10 if chip is UNO else 1):
        with armed(chip, setup=FAR) as host:
            host.drive(units)
            for _ in range(5):
                host.wait(rng.uniform(0.005, 0.02))
                host.drive(units)
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


@pytest.mark.parametrize(("chip", "cause"), [(UNO, 1), (UNO, 2), (UNO, 4), (PICO, 2)], ids=name_of)
def test_a_reset_ends_the_zero(chip: Chip, cause: int) -> None:
    with armed(chip) as host:
        host.board.place(0.5)
        host.wait(0.05)
        host.board.reset(cause)
        host.wait(0.01)
        assert host.arm_anew() == Code.NO_SETUP
        set_up(chip, host, LIMITED)
        assert host.arm() == Code.NO_ZERO
        host.drive(chip.drive)
        assert host.pin_V() == 0.0
        assert zero(host, 250).counts == 250 and host.arm() == Code.NONE


def hang(host: ChipsHost, what: Any) -> None:
    """Each chip has words of its own for it."""
    host.board.hang(what)


@pytest.mark.parametrize(
    ("chip", "what"),
    [
        *((UNO, what) for what in ("clock", "tick", "main loop", "everything")),
        (PICO, "everything"),
        *evidence((PICO, "counter"), (PICO, "tick"), (PICO, "main loop")),
    ],
    ids=name_of,
)
def test_a_hung_program_loses_its_zero_and_the_drive(chip: Chip, what: str) -> None:
    with armed(chip, setup=FAR._replace(watchdog_ms=1000)) as host:
        host.drive(chip.drive)
        hang(host, what)
        off_at_zero_within(host, chip.hang_s)
        assert host.truth().resets == 1
        assert host.arm_anew() == Code.NO_SETUP
        set_up(chip, host, FAR)
        assert host.arm() == Code.NO_ZERO


@BOTH
def test_a_limit_is_kept_in_counts_from_the_zero(chip: Chip) -> None:
    with armed(chip, setup=LIMITED._replace(hard_lo=-100, hard_hi=100)) as host:
        while host.pin_V() != 0.0 or host.board.now_s() < 0.1:
            host.drive(chip.drive)
            host.wait(0.01)
        assert host.state().fault == Code.TRAVEL
        assert 100 < host.state().counts < 200


@BOTH
def test_without_limits_the_e_stop_is_tried_first(chip: Chip) -> None:
    with chip.powered(MOTOR, WIRED) as host:
        try_estop(chip, host)
        assert host.arm_anew() == Code.NONE
        host.board.contact("e_stop", is_open=True)
        host.wait(SETTLE_S)
        assert host.pin_V() == 0.0 and host.state().fault == Code.E_STOP


def try_estop(chip: Chip, host: ChipsHost, zero_counts: int = 0) -> None:
    """Without limits nothing arms before."""
    host.acknowledge(Code.RESET)
    set_up(chip, host, ENDLESS)
    zero(host, zero_counts)
    assert host.arm() == Code.E_STOP_UNTRIED
    for is_open in (True, False):
        host.board.contact("e_stop", is_open=is_open)
        host.wait(0.05)


@BOTH
def test_the_relay_in_the_chip_swings_about_any_centre_of_counts(chip: Chip) -> None:
    centre = 1_000_000
    low, high = (20, 70) if chip is UNO else (310, 1100)
    with chip.powered(MOTOR, WIRED) as host:
        try_estop(chip, host, centre)
        assert host.arm_anew() == Code.NONE
        relay = RelaySetup((-high, -low, low, high), 16 * centre, 2**24, 1, 10)
        assert host.ask(Kind.RELAY, relay.pack()).kind == Kind.RELAY_REPLY
        told = Told()
        for _ in range(200 if chip is UNO else 100):
            host.send(Kind.KEEP)
            host.wait(0.02)
            told.take(host.board.read(0.0))
        assert all(block.status & STATUS_LAW for block in told.blocks)
        away = [counts - centre for _, counts, _ in told.rows()]
        assert len(away) > (3900 if chip is UNO else 1900)
        settled = away[len(away) // 2 :]
        assert min(settled) < -20 and max(settled) > 20 and max(map(abs, away)) < 2000
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
