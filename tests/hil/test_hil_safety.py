"""Every safety promise of the device, measured at the pin of the compiled firmware, in virtual time."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace

import pytest
from evidence import evidence
from virtual_host import BENCH, HELD, LSB_RAD, SESSION, SETUP, TICK_S, VirtualHost, armed_host

from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.frames import (
    STATUS_ARMED,
    STATUS_FAULT,
    STATUS_RECOVERING,
    Code,
    DeviceState,
    Kind,
    encode,
    pack_arm,
    pack_drive,
)
from rig.model.bench import SensorWiring

PHASES = 20
SLACK_S = 2e-6  # of microseconds cut off by the device's clock


def latched_at_zero(host: VirtualHost, code: Code) -> None:
    """The fault holds 0 V whatever is sent, STOP and ARM too, until it is acknowledged and the device armed again."""
    assert host.pin_V() == 0.0
    for units in (50, -50, 1):
        host.drive(units)
        host.wait(0.003)
        assert host.pin_V() == 0.0
    state = host.state()
    assert (state.fault, state.status, state.drive) == (code, STATUS_FAULT, 0)
    host.wait(2.0)
    assert host.pin_V() == 0.0 and host.state().fault == code
    assert DeviceState.unpack(host.ask(Kind.STOP).body).status == STATUS_FAULT
    assert host.arm() == code
    host.drive(50)
    assert host.pin_V() == 0.0
    assert host.acknowledge(code).status == 0
    assert host.arm() == Code.NONE
    assert host.state().status & STATUS_ARMED and host.state().fault == Code.NONE
    assert host.pin_V() == 0.0  # arming alone does not drive
    host.drive(20)
    assert host.pin_V() > 0.0


@pytest.mark.parametrize("watchdog_ms", [1, 100, *evidence(30, 1000)])
@pytest.mark.parametrize("clock_error_ppm", [5000.0, *evidence(0.0, -5000.0)])
@pytest.mark.parametrize("last", ["read", "drive"])
def test_a_silent_host_means_0_V_within_the_watchdog_time_and_a_tick(
    watchdog_ms: int, clock_error_ppm: float, last: str
) -> None:
    rng = random.Random(watchdog_ms)
    rate = 1.0 + 1e-6 * clock_error_ppm
    setup = SETUP._replace(watchdog_ms=watchdog_ms)
    for _ in range(12):
        host = VirtualHost(VirtualBoard(HELD, clock_error_ppm=clock_error_ppm, clock_start_us=rng.getrandbits(32)))
        host.setup(setup)
        host.acknowledge(Code.RESET)
        host.send(Kind.ARM, pack_arm(SESSION))
        host.send(Kind.DRIVE, pack_drive(60))  # at once: a watchdog of 1 ms does not wait for the reply
        host.board.sleep_until(host.heard_s)
        if watchdog_ms > 1:
            for _ in range(5):
                host.wait(rng.uniform(0.0, 0.5e-3 * watchdog_ms))
                host.drive(60)
                driven_s = host.heard_s
                if last == "read":
                    host.state()  # while something drives, READ does not count
        else:
            driven_s = host.heard_s
        host.board.sleep_until(host.heard_s)
        assert host.pin_V() > 0.0
        early_s = driven_s + 1e-3 * watchdog_ms / rate - SLACK_S
        latest_s = driven_s + (1e-3 * watchdog_ms + TICK_S) / rate + SLACK_S
        host.board.sleep_until(early_s)
        assert host.pin_V() > 0.0
        host.board.sleep_until(latest_s)
        assert host.pin_V() == 0.0
        assert early_s <= host.board.truth().pin_changed_s <= latest_s
        host.wait(1.0)
        assert host.pin_V() == 0.0
        assert host.state().fault == Code.WATCHDOG


def test_a_host_that_comes_back_finds_the_watchdog_latched() -> None:
    host = armed_host()
    host.drive(60)
    host.wait(0.15)
    latched_at_zero(host, Code.WATCHDOG)


def test_replies_that_nobody_reads_do_not_feed_the_watchdog() -> None:
    host = armed_host()
    host.drive(60)
    for _ in range(12):  # everything but READ and DRIVE
        host.wait(0.01)
        host.send(Kind.HELLO)
        host.send(Kind.SETUP, SETUP.pack())
        host.send(0x33)
        host.send(Kind.DRIVE, b"\x01")
        host.send(Kind.READ, version=1)
    assert host.pin_V() == 0.0


@pytest.mark.parametrize("side", [1, -1])
def test_a_shaft_beyond_a_hard_limit_means_0_V_within_two_ticks(side: int) -> None:
    rng = random.Random(side)
    limit_rad = ((SETUP.hard_hi if side > 0 else SETUP.hard_lo) - 512) * LSB_RAD
    for _ in range(PHASES):
        host = armed_host()
        host.drive(60 * side)
        host.wait(rng.uniform(0.0, 0.02))
        host.board.place(limit_rad + side * (6 * LSB_RAD))  # six counts: well outside the noise
        moved_s = host.board.now_s()
        host.board.sleep_until(moved_s + 2 * TICK_S)
        assert host.pin_V() == 0.0
        assert moved_s <= host.board.truth().pin_changed_s
        host.board.place(0.0)
        latched_at_zero(host, Code.TRAVEL)


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_motor_that_runs_into_the_limit_is_cut_within_two_ticks(polarity: int, direction: int) -> None:
    """The real motion, full speed, from random starts: the pin is 0 two ticks after the crossing at the latest."""
    rng = random.Random(polarity + 10 * direction)
    quiet = replace(BENCH, noise_rad=0.0, rad_per_count=polarity * LSB_RAD)
    limit_rad = (975.5 - 512) * LSB_RAD  # as far to the other side
    for _ in range(10):
        start_rad = rng.uniform(-0.5, 0.5)
        host = armed_host(replace(quiet, start_rad=start_rad), SETUP._replace(polarity=polarity))
        crossed_s = None
        while host.pin_V() != 0.0 or crossed_s is None:
            host.drive(200 * direction)
            while crossed_s is None and host.board.now_s() < host.heard_s + 0.02:
                host.wait(50e-6)
                if direction * host.board.truth().y_rad > limit_rad:
                    crossed_s = host.board.now_s()
                    host.board.sleep_until(crossed_s + 2 * TICK_S)
                    assert host.pin_V() == 0.0
            assert host.board.now_s() < 5.0
        assert host.state().fault == Code.TRAVEL


@pytest.mark.parametrize("sensor", ["broken_low", "broken_high"])
def test_a_broken_wire_means_0_V_within_two_ticks(sensor: SensorWiring) -> None:
    rng = random.Random(3)
    for _ in range(PHASES):
        host = armed_host()
        host.drive(60)
        host.wait(rng.uniform(0.0, 0.02))
        host.board.rewire(sensor=sensor)
        host.wait(2 * TICK_S)
        assert host.pin_V() == 0.0
        assert host.arm() == Code.SENSOR_RAIL  # not before it is mended
        host.drive(60)
        assert host.pin_V() == 0.0
        host.board.rewire()
        latched_at_zero(host, Code.SENSOR_RAIL)


def test_no_drive_before_arming() -> None:
    host = VirtualHost(VirtualBoard(BENCH))
    host.acknowledge(Code.RESET)
    preparations: tuple[Callable[[], None], ...] = (lambda: None, host.setup)
    for prepare in preparations:
        prepare()
        for units in (1, 50, -50, 200, 799, -799, 32767, -32768):
            host.drive(units)
            host.wait(0.002)
            assert host.pin_V() == 0.0
            state = host.state()
            assert (state.fault, state.status, state.drive) == (Code.NOT_ARMED, 0, 0)
    assert host.board.truth().pin_changed_s < 0.0  # never


@pytest.mark.parametrize("cause", [1, 2, 4, 8])
def test_a_reset_at_any_instant_means_0_V_and_a_new_arming(cause: int) -> None:
    rng = random.Random(cause)
    for _ in range(PHASES // 4):
        host = armed_host()
        host.drive(60)
        if rng.random() < 0.5:
            host.send(Kind.READ)  # caught in the middle of a frame
        host.wait(rng.uniform(0.0, 0.01))
        assert host.pin_V() > 0.0
        host.board.reset(cause)
        assert host.pin_V() == 0.0
        host.wait(0.01)
        host.send_raw(b"\0")  # ends what the reset cut in two
        host.drive(60)
        assert host.pin_V() == 0.0
        assert (host.state().fault, host.state().session) == (Code.RESET, 0)
        assert host.arm() == Code.RESET
        assert host.arm_anew() == Code.NO_SETUP
        hello = host.hello()
        assert hello.reset_cause == cause
        assert hello.now_us < 50_000  # its clock has started anew


def test_a_hung_firmware_is_reset_by_the_hardware_watchdog() -> None:
    rng = random.Random(5)
    for _ in range(20):
        host = armed_host()
        host.drive(60)
        host.wait(rng.uniform(0.0, 0.01))
        host.board.hang()
        hung_s = host.board.now_s()
        host.wait(0.05)
        assert host.pin_V() > 0.0  # nobody is there to stop it
        host.wait(0.08)
        assert host.pin_V() == 0.0
        assert host.board.truth().pin_changed_s <= hung_s + 0.12
        assert host.hello().reset_cause == 8
        host.drive(60)
        assert host.pin_V() == 0.0


def test_drive_beyond_the_largest_never_reaches_the_pin() -> None:
    for units in (201, -201, 400, 799, -799, 800, 32767, -32768):
        host = armed_host()
        most_V = 200 / 799 * 12.0
        host.drive(200)
        assert host.pin_V() == pytest.approx(most_V)
        host.drive(-200)
        assert host.pin_V() == pytest.approx(-most_V)
        sent_s = host.heard_s
        host.drive(units)
        assert host.pin_V() == 0.0
        assert sent_s < host.board.truth().pin_changed_s <= host.heard_s + 1e-9
        latched_at_zero(host, Code.DRIVE_RANGE)


def test_garbage_never_moves_the_drive() -> None:
    """Half a megabyte of bytes at random, of frames cut and joined at random, and of frames with bits flipped."""
    rng = random.Random(17)
    host = armed_host(HELD, SETUP._replace(watchdog_ms=1000))
    host.drive(40)
    before = host.board.truth()
    good = [encode(Kind.DRIVE, 7, pack_drive(units)) for units in (-200, 0, 199)]
    good += [encode(Kind.STOP, 8), encode(Kind.ARM, 9, pack_arm(SESSION)), encode(Kind.SETUP, 10, SETUP.pack())]
    for _ in range(1500):
        which = rng.randrange(3)
        if which == 0:
            data = rng.randbytes(rng.randint(1, 300))
        elif which == 1:
            frame = rng.choice(good)
            data = frame[: rng.randint(1, len(frame) - 2)] + bytes([rng.randint(1, 255)]) * rng.randint(1, 90)
            data += b"\0"
        else:
            damaged = bytearray(rng.choice(good))
            for bit in rng.sample(range(8 * (len(damaged) - 1)), rng.randint(1, 3)):
                damaged[bit // 8] ^= 1 << bit % 8
            data = bytes(damaged)
        host.send_raw(data)
        host.board.sleep_until(host.heard_s)
        truth = host.board.truth()
        assert (truth.pin_V, truth.armed) == (before.pin_V, True)
        assert truth.pin_changed_s == before.pin_changed_s  # not even in between
        host.send_raw(b"\0")
        if rng.random() < 0.2:
            state = host.state()  # in step again after the next delimiter
            assert state.status == STATUS_ARMED
            host.drive(40)  # feeds the watchdog
            before = host.board.truth()
    assert host.board.truth().dropped > 1000


def test_a_flood_of_garbage_does_not_keep_the_drive_alive() -> None:
    rng = random.Random(23)
    host = armed_host()
    host.drive(60)
    heard_s = host.heard_s
    while host.board.now_s() < heard_s + 0.102:
        host.send_raw(rng.randbytes(20))
        host.wait(0.001)
    assert host.pin_V() == 0.0


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("polarity", [1, -1])
def test_armed_outside_a_limit_only_inward_drive_passes(side: int, polarity: int) -> None:
    """Above (+1) or below (-1) the hard limits in counts, with the motor wired either way."""
    bench = replace(BENCH, rad_per_count=polarity * LSB_RAD)
    outside_rad = polarity * side * 480 * LSB_RAD
    outward = side * polarity
    for units in (1, 50, 200):
        host = armed_host(replace(bench, start_rad=outside_rad), SETUP._replace(polarity=polarity))
        assert host.state().status == STATUS_ARMED | STATUS_RECOVERING
        host.drive(outward * units)
        assert host.pin_V() == 0.0
        assert host.board.truth().pin_changed_s < 0.0  # not for an instant
        latched = host.state()
        assert (latched.fault, latched.status) == (Code.TRAVEL, STATUS_FAULT)

    host = armed_host(replace(bench, start_rad=outside_rad), SETUP._replace(polarity=polarity))
    while host.state().status & STATUS_RECOVERING:
        host.drive(-outward * 80)
        assert host.pin_V() != 0.0
        assert host.board.now_s() < 3.0
    assert abs(host.board.truth().y_rad) < 464 * LSB_RAD  # really inside
    assert host.state().status == STATUS_ARMED
    host.drive(outward * 30)  # both directions again
    assert host.pin_V() != 0.0


@pytest.mark.parametrize("side", [1, -1])
def test_recovery_that_moves_outward_is_stopped(side: int) -> None:
    """Wired backwards: what is meant inward drives outward. A 32nd of the hard range (28 counts) is allowed."""
    host = armed_host(replace(BENCH, start_rad=side * 470 * LSB_RAD, drive="reversed"))
    start_rad = host.board.truth().y_rad
    while host.state().status & STATUS_RECOVERING:
        host.drive(-side * 80)
        assert host.board.now_s() < 2.0
    assert abs(host.board.truth().y_rad - start_rad) < 36 * LSB_RAD
    assert host.pin_V() == 0.0
    assert host.state().fault == Code.POLARITY


def test_stop_means_0_V_and_disarmed() -> None:
    host = armed_host()
    host.drive(-150)
    packet = host.ask(Kind.STOP)
    state = DeviceState.unpack(packet.body)
    assert (packet.kind, state.drive, state.status, state.fault) == (Kind.STOP_REPLY, 0, 0, Code.NONE)
    assert host.pin_V() == 0.0
    host.drive(-150)
    assert host.pin_V() == 0.0


def test_what_the_state_says_is_what_is_at_the_pin() -> None:
    """Times, drive and position of STATE against the truth, at random phases and with a clock that is off."""
    rng = random.Random(31)
    quiet = replace(BENCH, noise_rad=0.0)
    host = armed_host(quiet, clock_error_ppm=4000.0, clock_start_us=2**32 - 50_000)
    for _ in range(200):
        host.drive(rng.randint(-60, 60))
        drive_s = host.heard_s
        host.wait(rng.uniform(0.0, 0.008))
        state = host.state()
        sampled_s = host.heard_s  # the READ had arrived
        assert state.drive / 799 * 12.0 == pytest.approx(host.pin_V())
        for t_us, true_s in ((state.t_drive_us, drive_s), (state.t_sample_us, sampled_s)):
            late_us = (t_us - (2**32 - 50_000) - true_s * 1e6 * 1.004) % 2**32
            assert min(late_us, 2**32 - late_us) <= 1.01
        truth = host.board.truth()
        then_rad = truth.y_rad - truth.v_rad_per_s * (truth.t_s - sampled_s)
        assert state.counts == pytest.approx(512 + then_rad / LSB_RAD, abs=1.0)
        host.board.place(0.0)


def test_boards_in_one_process_are_independent() -> None:
    one, other = armed_host(), armed_host()
    one.drive(100)
    assert one.pin_V() > 0.0 and other.pin_V() == 0.0
    other.wait(5.0)
    assert one.pin_V() > 0.0 and one.board.now_s() < 1.0
