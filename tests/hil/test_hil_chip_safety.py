"""Every safety promise of the chips, measured at the pins of the emulated ones, at random phases, in virtual time."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import product
from typing import Any

import pytest
from both_chips import PICO, UNO, Chip, name_of
from chip_host import BENCH, HELD, QUIET, SETTLE_S, SETUP, ChipHost, armed_chip
from evidence import evidence
from pico_host import PicoHost
from simulated_bench import LIMITS, SCALING
from virtual_host import LSB_RAD, TICK_S

from emulated_chips.truth import Contact
from emulated_chips.virtual_chip import VirtualChip
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.frames import STATUS_FAULT, STATUS_RECOVERING, Code, Kind, encode, pack_ack, pack_drive
from rig.core.faults import Fault
from rig.model.bench import SensorWiring

ENDS = Variant(end_switches=True)
IN1_IN2 = Variant(bridge="IN1_IN2")
FAST = Variant(baud=1_000_000)
BOTH = pytest.mark.parametrize("chip", [UNO, PICO], ids=name_of)


def latched_at_zero(chip: Chip, host: ChipHost | PicoHost, code: Code) -> None:
    """The fault holds 0 V whatever is sent, STOP and ARM too."""
    for units in (chip.drive, -chip.drive):
        host.drive(units)
        host.wait(0.003)
        assert host.pin_V() == 0.0
    host.ask(Kind.STOP)
    assert host.arm() == code
    host.drive(chip.drive)
    assert host.pin_V() == 0.0
    state = host.state()
    assert (state.fault, state.status, state.drive) == (code, STATUS_FAULT, 0)


def off_after_s(host: ChipHost | PicoHost, event_s: float, longest_s: float) -> float:
    """How long after the event the pins went to 0; they stay there."""
    host.board.sleep_until(event_s + longest_s)
    assert host.pin_V() == 0.0
    off_s = host.truth().pin_changed_s - event_s
    host.wait(0.02)
    assert host.pin_V() == 0.0
    return off_s


@pytest.mark.parametrize(
    ("chip", "watchdog_ms", "options"),
    [
        *product((UNO,), (20, 100), (Variant(), IN1_IN2)),
        (PICO, 20, Variant()),
        *evidence((PICO, 100, IN1_IN2)),
    ],
    ids=name_of,
)
def test_a_silent_host_means_0_V_within_the_watchdog_time_and_a_tick(
    chip: Chip, watchdog_ms: int, options: Variant
) -> None:
    rng = random.Random(watchdog_ms)
    with chip.armed(HELD, options, watchdog_ms) as host:
        for _ in range(chip.phases):
            for _ in range(3):
                host.wait(rng.uniform(0.0, 0.4e-3 * watchdog_ms))
                host.drive(chip.drive)
            heard_s = host.heard_s
            host.board.sleep_until(heard_s + 1e-3 * watchdog_ms - TICK_S)
            assert host.pin_V() > 0.0
            off_after_s(host, heard_s, 1e-3 * watchdog_ms + TICK_S)
            latched_at_zero(chip, host, Code.WATCHDOG)
            chip.arm_anew(host, watchdog_ms)
        assert host.pin_V() == 0.0


@pytest.mark.parametrize(
    ("chip", "what"),
    [
        *((UNO, what) for what in ("main loop", "everything", "clock", "tick", "converter")),
        (PICO, "tick"),
        *evidence((PICO, "main loop"), (PICO, "everything"), (PICO, "converter")),
    ],
    ids=name_of,
)
def test_a_hung_program_is_reset_by_the_hardware_watchdog(chip: Chip, what: Any) -> None:
    rng = random.Random(len(what))
    with chip.armed(HELD, watchdog_ms=1000) as host:
        for k in range(chip.resets):
            host.drive(chip.drive)
            host.wait(rng.uniform(0.0, 0.01))
            host.board.hang(what)
            off_after_s(host, host.board.now_s(), chip.hang_s)
            assert host.truth().resets == k + 1
            assert host.hello().reset_words == "watchdog"
            assert host.arm() == Code.RESET
            assert host.arm_anew() == Code.NO_SETUP
            host.drive(chip.drive)
            assert host.pin_V() == 0.0
            chip.arm_anew(host, watchdog_ms=1000)


@pytest.mark.parametrize(("chip", "side"), [(UNO, 1), (UNO, -1), (PICO, 1), *evidence((PICO, -1))], ids=name_of)
def test_a_shaft_beyond_a_hard_limit_means_0_V_within_two_ticks(chip: Chip, side: int) -> None:
    rng = random.Random(side)
    limit_rad = ((SETUP.hard_hi if side > 0 else SETUP.hard_lo) - 512) * LSB_RAD
    with chip.armed(BENCH) as host:
        for _ in range(chip.phases):
            host.drive(chip.drive * side)
            host.wait(rng.uniform(0.0, 0.02))
            host.board.place(limit_rad + side * 6 * LSB_RAD)  # six of the Uno's counts: well outside the noise
            off_after_s(host, host.board.now_s(), 2 * TICK_S)
            host.board.place(0.0)
            latched_at_zero(chip, host, Code.TRAVEL)
            chip.arm_anew(host)


@pytest.mark.parametrize(
    ("chip", "sensor"),
    [(UNO, "broken_low"), (UNO, "broken_high"), (PICO, "broken_low"), *evidence((PICO, "broken_high"))],
    ids=name_of,
)
def test_a_broken_wire_means_0_V_within_two_ticks(chip: Chip, sensor: SensorWiring) -> None:
    rng = random.Random(len(sensor))
    with chip.armed(BENCH) as host:
        for _ in range(chip.phases):
            host.drive(-chip.drive)
            host.wait(rng.uniform(0.0, 0.02))
            host.board.rewire(sensor=sensor)
            off_after_s(host, host.board.now_s(), 2 * TICK_S)
            assert host.arm() == Code.SENSOR_RAIL
            host.board.rewire()
            host.wait(0.002)
            chip.arm_anew(host)


@BOTH
def test_the_e_stop_means_0_V_within_a_tick_and_before_that_in_its_interrupt(chip: Chip) -> None:
    rng = random.Random(9)
    slowest_s = 0.0
    with chip.armed(HELD) as host:
        for _ in range(chip.phases):
            host.drive(rng.choice([-chip.drive, chip.drive]))
            host.wait(rng.uniform(0.0, 0.01))
            host.board.contact("e_stop", is_open=True)
            slowest_s = max(slowest_s, off_after_s(host, host.board.now_s(), TICK_S))
            latched_at_zero(chip, host, Code.E_STOP)
            assert host.ask(Kind.ACK, pack_ack(Code.E_STOP)).kind == Kind.NACK  # as long as it is open
            host.board.contact("e_stop", is_open=False)
            host.wait(0.002)
            latched_at_zero(chip, host, Code.E_STOP)
            chip.arm_anew(host)
        assert slowest_s < chip.e_stop_s
        host.drive(chip.drive)
        assert host.pin_V() > 0.0


@BOTH
def test_no_drive_passes_between_the_e_stop_and_its_fault(chip: Chip) -> None:
    """A DRIVE that arrives in the same tick, at any phase to the e-stop."""
    frame = encode(Kind.DRIVE, 9, pack_drive(chip.drive))
    step_s, gone_s = (10e-6, 30e-6) if chip is UNO else (2e-6, 5e-6)
    with chip.armed(HELD) as host:
        for k in range(2 * chip.phases):
            host.board.write(frame)
            host.wait(len(frame) * 10 / 115200 + (k - chip.phases) * step_s)
            host.board.contact("e_stop", is_open=True)
            host.wait(gone_s)
            for _ in range(40 if chip is UNO else 10):
                assert host.pin_V() == 0.0
                host.wait(50e-6 if chip is UNO else 200e-6)
            latched_at_zero(chip, host, Code.E_STOP)
            host.board.contact("e_stop", is_open=False)
            host.wait(2e-3)
            chip.arm_anew(host)


@BOTH
def test_the_e_stop_is_seen_if_it_was_open_from_the_start(chip: Chip) -> None:
    with chip.powered(HELD, Variant()) as host:
        host.board.contact("e_stop", is_open=True)
        host.board.reset(1)
        host.wait(0.01)
        host.acknowledge(Code.RESET)
        host.setup(chip.setup)
        assert host.arm() == Code.E_STOP
        host.drive(chip.drive)
        assert host.pin_V() == 0.0


@pytest.mark.parametrize(
    ("chip", "contact", "outward"),
    [(UNO, "end_high", 1), (UNO, "end_low", -1), (PICO, "end_high", 1), *evidence((PICO, "end_low", -1))],
    ids=name_of,
)
def test_an_end_switch_means_0_V_within_two_ticks_and_only_inward_from_there(
    chip: Chip, contact: Contact, outward: int
) -> None:
    rng = random.Random(outward)
    with chip.armed(HELD, ENDS) as host:
        for _ in range(chip.phases):
            host.drive(chip.drive * outward)
            host.wait(rng.uniform(0.0, 0.01))
            host.board.contact(contact, is_open=True)
            off_after_s(host, host.board.now_s(), 2 * TICK_S)
            latched_at_zero(chip, host, Code.END_SWITCH)
            assert host.arm_anew() == Code.NONE and host.state().status & STATUS_RECOVERING
            host.drive(-chip.drive * outward)
            host.wait(0.003)
            assert host.pin_V() * outward < 0.0
            host.drive(chip.drive * outward)
            assert host.pin_V() == 0.0
            host.board.contact(contact, is_open=False)
            host.wait(0.002)
            chip.arm_anew(host)


@pytest.mark.parametrize(
    ("chip", "options"),
    [(UNO, Variant()), (UNO, FAST), (PICO, FAST), *evidence((PICO, Variant()))],
    ids=name_of,
)
def test_garbage_never_moves_the_drive(chip: Chip, options: Variant) -> None:
    """Random bytes, damaged frames and halves of frames, while armed: the pins stay at 0, or go to 0 and stay there."""
    rng = random.Random(options.baud)
    good = encode(Kind.DRIVE, 7, pack_drive(2 * chip.drive))
    with chip.armed(HELD, options, watchdog_ms=1000) as host:
        before = host.truth().pin_changed_s
        for k in range(chip.damaged):
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
        truth = host.truth()
        assert (truth.pin_changed_s, truth.overruns, truth.resets) == (before, 0, 0)
        assert host.state().drive == 0


@BOTH
def test_a_flood_of_garbage_neither_feeds_the_watchdog_nor_hangs_the_program(chip: Chip) -> None:
    rng = random.Random(2)
    with chip.armed(HELD, FAST) as host:
        host.drive(chip.drive)
        heard_s = host.heard_s
        while host.board.now_s() < heard_s + (0.3 if chip is UNO else 0.2):
            host.board.write(rng.randbytes(200))
            host.wait(0.002)  # without a pause
        truth = host.truth()
        assert truth.pin_V == 0.0 and truth.pin_changed_s - heard_s <= 0.100 + TICK_S
        assert truth.resets == 0 and (chip is UNO or truth.overruns == 0)
        host.send_raw(b"\0")
        host.wait(0.005)
        host.board.read(0.0)
        latched_at_zero(chip, host, Code.WATCHDOG)


@BOTH
def test_no_drive_before_arming_nor_beyond_the_largest(chip: Chip) -> None:
    with chip.powered(HELD, Variant()) as host:
        host.drive(chip.drive)
        assert host.pin_V() == 0.0 and host.state().fault == Code.RESET
        host.acknowledge(Code.RESET)
        host.drive(chip.drive)
        assert host.pin_V() == 0.0 and host.state().fault == Code.NOT_ARMED
        host.setup(chip.setup)
        host.drive(chip.drive)
        assert host.pin_V() == 0.0
        assert host.arm() == Code.NONE
        beyond = chip.setup.max_drive + 1
        for units in (beyond, -beyond, 32767, -32768):
            host.drive(chip.drive)
            assert host.pin_V() > 0.0
            host.drive(units)
            latched_at_zero(chip, host, Code.DRIVE_RANGE)
            assert host.arm_anew() == Code.NONE


@pytest.mark.parametrize(
    ("chip", "direction", "starts"),
    [(UNO, 1, 5), (UNO, -1, 5), (PICO, 1, 1), *evidence((PICO, -1, 1))],
    ids=name_of,
)
def test_a_motor_that_runs_into_the_limit_is_cut_within_two_ticks(chip: Chip, direction: int, starts: int) -> None:
    """The real motion from random starts; and where the shaft comes to rest, terminals shorted."""
    rng = random.Random(direction)
    setup = chip.setup
    limit_rad = (setup.hard_hi + 0.5 - setup.centre) / setup.centre * 512 * LSB_RAD
    for _ in range(starts):
        with chip.armed(replace(QUIET, start_rad=rng.uniform(-0.5, 0.5))) as host:
            cut_s = crossed_s = None
            while cut_s is None:
                host.drive(5 * chip.drive // 2 * direction)
                while cut_s is None and host.board.now_s() < host.heard_s + 0.02:
                    host.wait(50e-6 if chip is UNO else 100e-6)
                    truth = host.truth()
                    if crossed_s is None and direction * truth.y_rad > limit_rad:
                        crossed_s = truth.t_s
                    if truth.pin_V == 0.0:
                        cut_s = truth.pin_changed_s
            assert crossed_s is not None and cut_s - crossed_s <= 2 * TICK_S
            if chip is UNO:  # the other one's emulator takes long for a second
                host.wait(1.0)
                assert direction * host.truth().y_rad - limit_rad < 0.7


# ---------------------------------------------------------------------- the Uno


def test_a_short_opening_of_the_e_stop_is_latched() -> None:
    host = armed_chip(HELD)
    host.drive(60)
    host.board.contact("e_stop", is_open=True)
    host.wait(20e-6)
    host.board.contact("e_stop", is_open=False)
    host.wait(0.002)
    latched_at_zero(UNO, host, Code.E_STOP)


@pytest.mark.parametrize("set_up", [False, True])
@pytest.mark.parametrize("open_s", [20e-6, 0.5, *evidence(0.3e-3)])
def test_an_e_stop_opened_and_closed_while_disarmed_is_latched(open_s: float, set_up: bool) -> None:
    """At random phases, while the host asks for states, and while it does nothing."""
    rng = random.Random(set_up)
    for k in range(UNO.phases):
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
    latched_at_zero(UNO, host, Code.E_STOP)
    assert host.arm_anew() == Code.NONE


@pytest.mark.parametrize(("contact", "code"), [("e_stop", "DEVICE_ESTOP"), ("end_high", "DEVICE_END_SWITCH")])
def test_the_driver_says_which_contact_it_was(contact: Contact, code: str) -> None:
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


def test_a_drive_that_waits_behind_garbage_is_of_the_tick_in_which_it_arrived() -> None:
    """A full wire at 1 Mbaud has a byte wait for milliseconds until the main loop comes to it: by so much the drive
    would be off late.
    """
    rng = random.Random(5)
    for _ in range(UNO.phases):
        host = armed_chip(HELD, SETUP._replace(watchdog_ms=20), FAST)
        host.wait(rng.uniform(0.0, TICK_S))
        host.send_raw(bytes(5) * 50)
        host.drive(60)
        host.wait(0.005)
        assert host.pin_V() > 0.0
        off_after_s(host, host.heard_s, 0.020 + TICK_S)
    latched_at_zero(UNO, host, Code.WATCHDOG)


# ---------------------------------------------------------------------- the Pico


@pytest.mark.parametrize("set_up", [True, *evidence(False)])
def test_an_e_stop_opened_for_a_moment_is_latched_armed_or_not(set_up: bool) -> None:
    """The chip keeps the edge: 1 us is enough."""
    rng = random.Random(set_up)
    with PICO.powered(HELD, Variant()) as host:
        host.acknowledge(Code.RESET)
        for open_s in (1e-6, 20e-6, 0.3e-3) * 3:
            host.setup(PICO.setup)
            if set_up:
                assert host.arm_anew() == Code.NONE
                host.drive(PICO.drive)
            host.wait(rng.uniform(0.0, 0.01))
            host.board.contact("e_stop", is_open=True)
            host.wait(open_s)
            host.board.contact("e_stop", is_open=False)
            host.wait(2e-3)
            assert host.arm() == Code.E_STOP
            latched_at_zero(PICO, host, Code.E_STOP)
            assert host.arm_anew() == Code.NONE
            host.ask(Kind.STOP)


@pytest.mark.parametrize("cause", [2, *evidence(1, 4)])
def test_a_reset_means_0_V_at_once_and_voids_the_session(cause: int) -> None:
    """A brown-out is a power-on to this chip."""
    words = {1: "power-on", 2: "external", 4: "power-on"}[cause]
    with PICO.armed(HELD) as host:
        host.drive(PICO.drive)
        host.board.reset(cause, 0.01)
        assert host.pin_V() == 0.0
        host.wait(0.02)
        assert host.pin_V() == 0.0 and host.hello().reset_words == words
        assert host.arm() == Code.RESET
        assert host.arm_anew() == Code.NO_SETUP
        host.drive(PICO.drive)
        assert host.pin_V() == 0.0


def test_a_tick_that_takes_too_long_leaves_out_those_that_come_due_and_goes_on() -> None:
    """An alarm that lies in the past would fire an hour later, and the watchdog would reset the chip."""
    with PICO.armed(HELD, watchdog_ms=1000) as host:
        host.drive(PICO.drive)
        for stall_s in (0.9e-3, 0.998e-3, 1.0e-3, 1.002e-3, 3.3e-3):
            host.board.stall("tick", stall_s)
            host.wait(0.2)
            assert host.truth().resets == 0 and host.pin_V() > 0.0
            host.drive(PICO.drive)
