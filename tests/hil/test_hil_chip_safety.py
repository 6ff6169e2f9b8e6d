"""Every safety promise of the Uno, measured at the pins of its emulated chip, at random phases, in virtual time."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from chip_host import BENCH, HELD, QUIET, SETTLE_S, SETUP, ChipHost, armed_chip
from evidence import evidence
from virtual_host import LSB_RAD, TICK_S

from chips.virtual_chip import Contact, Hang, VirtualChip
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.frames import STATUS_FAULT, STATUS_RECOVERING, Code, Kind, encode, pack_ack, pack_drive
from rig.core.faults import Fault
from rig.model.bench import SensorWiring

PHASES = 20
HANG_S = 0.150
ENDS = Variant(end_switches=True)
IN1_IN2 = Variant(bridge="IN1_IN2")


def latched_at_zero(host: ChipHost, code: Code) -> None:
    """The fault holds 0 V whatever is sent, STOP and ARM too."""
    for units in (50, -50):
        host.drive(units)
        host.wait(0.003)
        assert host.pin_V() == 0.0
    host.ask(Kind.STOP)
    assert host.arm() == code
    host.drive(60)
    assert host.pin_V() == 0.0
    state = host.state()
    assert (state.fault, state.status, state.drive) == (code, STATUS_FAULT, 0)


def off_after_s(host: ChipHost, event_s: float, longest_s: float) -> float:
    """How long after the event the pins went to 0; they stay there."""
    host.board.sleep_until(event_s + longest_s)
    assert host.pin_V() == 0.0
    off_s = host.truth().pin_changed_s - event_s
    host.wait(0.02)
    assert host.pin_V() == 0.0
    return off_s


@pytest.mark.parametrize("watchdog_ms", [20, 100])
@pytest.mark.parametrize("options", [Variant(), IN1_IN2], ids=lambda o: o.bridge)
def test_a_silent_host_means_0_V_within_the_watchdog_time_and_a_tick(watchdog_ms: int, options: Variant) -> None:
    rng = random.Random(watchdog_ms)
    for _ in range(PHASES):
        host = armed_chip(HELD, SETUP._replace(watchdog_ms=watchdog_ms), options)
        for _ in range(3):
            host.wait(rng.uniform(0.0, 0.4e-3 * watchdog_ms))
            host.drive(60)
        heard_s = host.heard_s
        host.board.sleep_until(heard_s + 1e-3 * watchdog_ms - TICK_S)
        assert host.pin_V() > 0.0
        off_after_s(host, heard_s, 1e-3 * watchdog_ms + TICK_S)
    latched_at_zero(host, Code.WATCHDOG)
    assert host.arm_anew() == Code.NONE and host.pin_V() == 0.0


@pytest.mark.parametrize("what", ["main loop", "everything", "clock", "tick", "converter"])
def test_a_hung_program_is_reset_by_the_hardware_watchdog(what: Hang) -> None:
    rng = random.Random(len(what))
    for _ in range(PHASES):
        host = armed_chip(HELD, SETUP._replace(watchdog_ms=1000))
        host.drive(60)
        host.wait(rng.uniform(0.0, 0.01))
        host.board.hang(what)
        off_after_s(host, host.board.now_s(), HANG_S)
        assert host.truth().resets == 1
    assert host.hello().reset_words == "watchdog"
    assert host.arm() == Code.RESET
    assert host.arm_anew() == Code.NO_SETUP
    host.drive(60)
    assert host.pin_V() == 0.0


@pytest.mark.parametrize("side", [1, -1])
def test_a_shaft_beyond_a_hard_limit_means_0_V_within_two_ticks(side: int) -> None:
    rng = random.Random(side)
    limit_rad = ((SETUP.hard_hi if side > 0 else SETUP.hard_lo) - 512) * LSB_RAD
    for _ in range(PHASES):
        host = armed_chip(BENCH)
        host.drive(60 * side)
        host.wait(rng.uniform(0.0, 0.02))
        host.board.place(limit_rad + side * 6 * LSB_RAD)  # six counts: well outside the noise
        off_after_s(host, host.board.now_s(), 2 * TICK_S)
    host.board.place(0.0)
    latched_at_zero(host, Code.TRAVEL)


@pytest.mark.parametrize("sensor", ["broken_low", "broken_high"])
def test_a_broken_wire_means_0_V_within_two_ticks(sensor: SensorWiring) -> None:
    rng = random.Random(len(sensor))
    for _ in range(PHASES):
        host = armed_chip(BENCH)
        host.drive(-60)
        host.wait(rng.uniform(0.0, 0.02))
        host.board.rewire(sensor=sensor)
        off_after_s(host, host.board.now_s(), 2 * TICK_S)
    assert host.arm() == Code.SENSOR_RAIL


def test_the_e_stop_means_0_V_within_a_tick_and_before_that_in_its_interrupt() -> None:
    rng = random.Random(9)
    slowest_s = 0.0
    for _ in range(PHASES):
        host = armed_chip(HELD)
        host.drive(rng.choice([-60, 60]))
        host.wait(rng.uniform(0.0, 0.01))
        host.board.contact("e_stop", is_open=True)
        slowest_s = max(slowest_s, off_after_s(host, host.board.now_s(), TICK_S))
    assert slowest_s < 30e-6
    latched_at_zero(host, Code.E_STOP)
    assert host.ask(Kind.ACK, pack_ack(Code.E_STOP)).kind == Kind.NACK  # as long as it is open
    host.board.contact("e_stop", is_open=False)
    host.wait(0.002)
    latched_at_zero(host, Code.E_STOP)
    assert host.arm_anew() == Code.NONE
    host.drive(60)
    assert host.pin_V() > 0.0


def test_a_short_opening_of_the_e_stop_is_latched() -> None:
    host = armed_chip(HELD)
    host.drive(60)
    host.board.contact("e_stop", is_open=True)
    host.wait(20e-6)
    host.board.contact("e_stop", is_open=False)
    host.wait(0.002)
    latched_at_zero(host, Code.E_STOP)


@pytest.mark.parametrize("set_up", [False, True])
@pytest.mark.parametrize("open_s", [20e-6, 0.5, *evidence(0.3e-3)])
def test_an_e_stop_opened_and_closed_while_disarmed_is_latched(open_s: float, set_up: bool) -> None:
    """At random phases, while the host asks for states, and while it does nothing."""
    rng = random.Random(set_up)
    for k in range(PHASES):
        if set_up:
            host = armed_chip(HELD)
            host.ask(Kind.STOP)
        else:
            host = ChipHost(VirtualChip(HELD))
            host.acknowledge(Code.RESET)
        host.wait(rng.uniform(0.0, 0.01))
        if k % 2:
            host.send(Kind.READ)
            host.wait(rng.uniform(0.0, 2e-3))
        host.board.contact("e_stop", is_open=True)
        host.wait(open_s)
        host.board.contact("e_stop", is_open=False)
        host.wait(3e-3)
        if not set_up:
            host.setup()
        assert host.arm() == Code.E_STOP
        host.drive(60)
        assert host.pin_V() == 0.0
    latched_at_zero(host, Code.E_STOP)
    assert host.arm_anew() == Code.NONE


def test_no_drive_passes_between_the_e_stop_and_its_fault() -> None:
    """A DRIVE that arrives in the same tick, at any phase to the e-stop."""
    frame = encode(Kind.DRIVE, 9, pack_drive(80))
    for k in range(40):
        host = armed_chip(HELD)
        host.board.write(frame)
        host.wait(len(frame) * 10 / 115200 + (k - 20) * 10e-6)
        host.board.contact("e_stop", is_open=True)
        host.wait(30e-6)
        for _ in range(40):
            assert host.pin_V() == 0.0
            host.wait(50e-6)
        latched_at_zero(host, Code.E_STOP)


def test_the_e_stop_is_seen_if_it_was_open_from_the_start() -> None:
    board = VirtualChip(HELD)
    board.contact("e_stop", is_open=True)
    host = ChipHost(board)
    host.acknowledge(Code.RESET)
    host.setup()
    assert host.arm() == Code.E_STOP
    host.drive(60)
    assert host.pin_V() == 0.0


@pytest.mark.parametrize(("contact", "outward"), [("end_high", 1), ("end_low", -1)])
def test_an_end_switch_means_0_V_within_two_ticks_and_only_inward_from_there(contact: Contact, outward: int) -> None:
    rng = random.Random(outward)
    for _ in range(PHASES):
        host = armed_chip(HELD, options=ENDS)
        host.drive(60 * outward)
        host.wait(rng.uniform(0.0, 0.01))
        host.board.contact(contact, is_open=True)
        off_after_s(host, host.board.now_s(), 2 * TICK_S)
    latched_at_zero(host, Code.END_SWITCH)
    assert host.arm_anew() == Code.NONE and host.state().status & STATUS_RECOVERING
    host.drive(-60 * outward)
    host.wait(0.003)
    assert host.pin_V() * outward < 0.0
    host.drive(60 * outward)
    assert host.pin_V() == 0.0


@pytest.mark.parametrize(("contact", "code"), [("e_stop", "DEVICE_ESTOP"), ("end_high", "DEVICE_END_SWITCH")])
def test_the_driver_says_which_contact_it_was(contact: Contact, code: str) -> None:
    from simulated_bench import LIMITS, SCALING

    board = VirtualChip(QUIET, options=ENDS)
    driver = SerialDriver(board, SCALING, emulated=True)
    driver.open()
    driver.arm(LIMITS)
    driver.write(1.0)
    driver.read()
    board.contact(contact, is_open=True)
    board.sleep_until(board.now_s() + 0.005)
    with pytest.raises(Fault) as caught:
        driver.read()
    assert caught.value.code == code


@pytest.mark.parametrize("options", [Variant(), Variant(baud=1_000_000)], ids=lambda o: str(o.baud))
def test_garbage_never_moves_the_drive(options: Variant) -> None:
    """Random bytes, damaged frames and halves of frames, while armed: the pins stay at 0, or go to 0 and stay there."""
    rng = random.Random(options.baud)
    good = encode(Kind.DRIVE, 7, pack_drive(150))
    host = armed_chip(HELD, SETUP._replace(watchdog_ms=1000), options)
    before = host.truth().pin_changed_s
    for k in range(150):
        if k % 3 == 0:
            data = rng.randbytes(rng.randint(1, 90))
        else:
            damaged = bytearray(good)
            damaged[rng.randrange(len(good) - 1)] ^= 1 << rng.randrange(8)
            data = bytes(damaged) if k % 3 == 1 else good[: rng.randrange(1, len(good) - 1)] + b"\0"
        host.send_raw(data + b"\0")
        host.board.sleep_until(host.heard_s + SETTLE_S)
        host.board.read(0.0)
        assert host.pin_V() == 0.0
    assert host.truth().pin_changed_s == before
    assert host.truth().overruns == 0 and host.truth().resets == 0
    assert host.state().drive == 0


def test_a_flood_of_garbage_neither_feeds_the_watchdog_nor_hangs_the_program() -> None:
    rng = random.Random(2)
    host = armed_chip(HELD, options=Variant(baud=1_000_000))
    host.drive(60)
    heard_s = host.heard_s
    while host.board.now_s() < heard_s + 0.3:
        host.board.write(rng.randbytes(200))
        host.wait(0.002)  # without a pause
    truth = host.truth()
    assert truth.pin_V == 0.0 and truth.pin_changed_s - heard_s <= 0.100 + TICK_S
    assert truth.resets == 0
    host.send_raw(b"\0")
    host.wait(0.005)
    host.board.read(0.0)
    latched_at_zero(host, Code.WATCHDOG)


def test_a_drive_that_waits_behind_garbage_is_of_the_tick_in_which_it_arrived() -> None:
    """A full wire at 1 Mbaud has a byte wait for milliseconds until the main loop comes to it: by so much the drive
    would be off late.
    """
    rng = random.Random(5)
    for _ in range(PHASES):
        host = armed_chip(HELD, SETUP._replace(watchdog_ms=20), Variant(baud=1_000_000))
        host.wait(rng.uniform(0.0, TICK_S))
        host.send_raw(bytes(5) * 50)
        host.drive(60)
        host.wait(0.005)
        assert host.pin_V() > 0.0
        off_after_s(host, host.heard_s, 0.020 + TICK_S)
    latched_at_zero(host, Code.WATCHDOG)


def test_no_drive_before_arming_nor_beyond_the_largest() -> None:
    host = ChipHost(VirtualChip(HELD))
    host.drive(60)
    assert host.pin_V() == 0.0 and host.state().fault == Code.RESET
    host.acknowledge(Code.RESET)
    host.drive(60)
    assert host.pin_V() == 0.0 and host.state().fault == Code.NOT_ARMED
    host.setup()
    host.drive(60)
    assert host.pin_V() == 0.0
    assert host.arm() == Code.NONE
    for units in (201, -201, 32767, -32768):
        host.drive(60)
        assert host.pin_V() > 0.0
        host.drive(units)
        latched_at_zero(host, Code.DRIVE_RANGE)
        assert host.arm_anew() == Code.NONE


@pytest.mark.parametrize("direction", [1, -1])
def test_a_motor_that_runs_into_the_limit_is_cut_within_two_ticks(direction: int) -> None:
    """The real motion from random starts; and where the shaft comes to rest, terminals shorted."""
    rng = random.Random(direction)
    limit_rad = (975.5 - 512) * LSB_RAD
    coasts_rad = []
    for _ in range(5):
        host = armed_chip(replace(QUIET, start_rad=rng.uniform(-0.5, 0.5)))
        cut_s = crossed_s = None
        while cut_s is None:
            host.drive(150 * direction)
            while cut_s is None and host.board.now_s() < host.heard_s + 0.02:
                host.wait(50e-6)
                truth = host.truth()
                if crossed_s is None and direction * truth.y_rad > limit_rad:
                    crossed_s = truth.t_s
                if truth.pin_V == 0.0:
                    cut_s = truth.pin_changed_s
        assert crossed_s is not None and cut_s - crossed_s <= 2 * TICK_S
        host.wait(1.0)
        coasts_rad.append(direction * host.truth().y_rad - limit_rad)
    assert max(coasts_rad) < 0.7
