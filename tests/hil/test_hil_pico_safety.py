"""Every safety promise of the Pico, measured at the pins of its emulated chip, at random phases, in virtual time."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from evidence import evidence
from pico_host import BENCH, HELD, LSB_RAD, QUIET, SETTLE_S, SETUP, PicoHost, arm_anew, armed_pico, pico
from virtual_host import TICK_S

from chips.virtual_pico import PicoContact, PicoHang
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.frames import STATUS_FAULT, STATUS_RECOVERING, Code, Kind, encode, pack_ack, pack_drive
from rig.model.bench import SensorWiring

PHASES = 8
HANG_S = 0.130  # the watchdog's 120 ms, and a tick
DRIVE = 940  # units, 1.8 V
ENDS = Variant(end_switches=True)
IN1_IN2 = Variant(bridge="IN1_IN2")
FAST = Variant(baud=1_000_000)


def latched_at_zero(host: PicoHost, code: Code) -> None:
    """The fault holds 0 V whatever is sent, STOP and ARM too."""
    for units in (DRIVE, -DRIVE):
        host.drive(units)
        host.wait(0.003)
        assert host.pin_V() == 0.0
    host.ask(Kind.STOP)
    assert host.arm() == code
    host.drive(DRIVE)
    assert host.pin_V() == 0.0
    state = host.state()
    assert (state.fault, state.status, state.drive) == (code, STATUS_FAULT, 0)


def off_after_s(host: PicoHost, event_s: float, longest_s: float) -> float:
    """How long after the event the pins went to 0; they stay there."""
    host.board.sleep_until(event_s + longest_s)
    assert host.pin_V() == 0.0
    off_s = host.truth().pin_changed_s - event_s
    host.wait(0.02)
    assert host.pin_V() == 0.0
    return off_s


@pytest.mark.parametrize(
    ("watchdog_ms", "options"), [(20, Variant()), *evidence((100, IN1_IN2))], ids=["20", "100-in1_in2"]
)
def test_a_silent_host_means_0_V_within_the_watchdog_time_and_a_tick(watchdog_ms: int, options: Variant) -> None:
    rng = random.Random(watchdog_ms)
    setup = SETUP._replace(watchdog_ms=watchdog_ms)
    with armed_pico(HELD, setup, options) as host:
        for _ in range(PHASES):
            for _ in range(3):
                host.wait(rng.uniform(0.0, 0.4e-3 * watchdog_ms))
                host.drive(DRIVE)
            heard_s = host.heard_s
            host.board.sleep_until(heard_s + 1e-3 * watchdog_ms - TICK_S)
            assert host.pin_V() > 0.0
            off_after_s(host, heard_s, 1e-3 * watchdog_ms + TICK_S)
            latched_at_zero(host, Code.WATCHDOG)
            arm_anew(host, setup)
        assert host.pin_V() == 0.0


@pytest.mark.parametrize("what", ["tick", *evidence("main loop", "everything", "converter")])
def test_a_hung_program_is_reset_by_the_hardware_watchdog(what: PicoHang) -> None:
    rng = random.Random(len(what))
    with armed_pico(HELD, SETUP._replace(watchdog_ms=1000)) as host:
        for k in range(2):
            host.drive(DRIVE)
            host.wait(rng.uniform(0.0, 0.01))
            host.board.hang(what)
            off_after_s(host, host.board.now_s(), HANG_S)
            assert host.truth().resets == k + 1
            assert host.hello().reset_words == "watchdog"
            assert host.arm() == Code.RESET
            assert host.arm_anew() == Code.NO_SETUP
            host.drive(DRIVE)
            assert host.pin_V() == 0.0
            arm_anew(host, SETUP._replace(watchdog_ms=1000))


@pytest.mark.parametrize("side", [1, *evidence(-1)])
def test_a_shaft_beyond_a_hard_limit_means_0_V_within_two_ticks(side: int) -> None:
    rng = random.Random(side)
    limit_rad = ((SETUP.hard_hi if side > 0 else SETUP.hard_lo) - 2048) * LSB_RAD
    with armed_pico(BENCH) as host:
        for _ in range(PHASES):
            host.drive(DRIVE * side)
            host.wait(rng.uniform(0.0, 0.02))
            host.board.place(limit_rad + side * 24 * LSB_RAD)  # well outside the noise
            off_after_s(host, host.board.now_s(), 2 * TICK_S)
            host.board.place(0.0)
            latched_at_zero(host, Code.TRAVEL)
            arm_anew(host)


@pytest.mark.parametrize("sensor", ["broken_low", *evidence("broken_high")])
def test_a_broken_wire_means_0_V_within_two_ticks(sensor: SensorWiring) -> None:
    rng = random.Random(len(sensor))
    with armed_pico(BENCH) as host:
        for _ in range(PHASES):
            host.drive(-DRIVE)
            host.wait(rng.uniform(0.0, 0.02))
            host.board.rewire(sensor=sensor)
            off_after_s(host, host.board.now_s(), 2 * TICK_S)
            assert host.arm() == Code.SENSOR_RAIL
            host.board.rewire()
            host.wait(0.002)
            arm_anew(host)


def test_the_e_stop_means_0_V_within_a_tick_and_before_that_in_its_interrupt() -> None:
    rng = random.Random(9)
    slowest_s = 0.0
    with armed_pico(HELD) as host:
        for _ in range(PHASES):
            host.drive(rng.choice([-DRIVE, DRIVE]))
            host.wait(rng.uniform(0.0, 0.01))
            host.board.contact("e_stop", is_open=True)
            slowest_s = max(slowest_s, off_after_s(host, host.board.now_s(), TICK_S))
            latched_at_zero(host, Code.E_STOP)
            assert host.ask(Kind.ACK, pack_ack(Code.E_STOP)).kind == Kind.NACK  # as long as it is open
            host.board.contact("e_stop", is_open=False)
            host.wait(0.002)
            latched_at_zero(host, Code.E_STOP)
            arm_anew(host)
        assert slowest_s < 3e-6
        host.drive(DRIVE)
        assert host.pin_V() > 0.0


@pytest.mark.parametrize("set_up", [True, *evidence(False)])
def test_an_e_stop_opened_for_a_moment_is_latched_armed_or_not(set_up: bool) -> None:
    """The chip keeps the edge: 1 us is enough."""
    rng = random.Random(set_up)
    with pico(HELD) as host:
        host.acknowledge(Code.RESET)
        for open_s in (1e-6, 20e-6, 0.3e-3) * 3:
            host.setup(SETUP)
            if set_up:
                assert host.arm_anew() == Code.NONE
                host.drive(DRIVE)
            host.wait(rng.uniform(0.0, 0.01))
            host.board.contact("e_stop", is_open=True)
            host.wait(open_s)
            host.board.contact("e_stop", is_open=False)
            host.wait(2e-3)
            assert host.arm() == Code.E_STOP
            latched_at_zero(host, Code.E_STOP)
            assert host.arm_anew() == Code.NONE
            host.ask(Kind.STOP)


def test_no_drive_passes_between_the_e_stop_and_its_fault() -> None:
    """A DRIVE that arrives in the same tick, at any phase to the e-stop."""
    frame = encode(Kind.DRIVE, 9, pack_drive(DRIVE))
    with armed_pico(HELD) as host:
        for k in range(16):
            host.board.write(frame)
            host.wait(len(frame) * 10 / 115200 + (k - 8) * 2e-6)
            host.board.contact("e_stop", is_open=True)
            host.wait(5e-6)
            for _ in range(10):
                assert host.pin_V() == 0.0
                host.wait(200e-6)
            latched_at_zero(host, Code.E_STOP)
            host.board.contact("e_stop", is_open=False)
            host.wait(2e-3)
            arm_anew(host)


def test_the_e_stop_is_seen_if_it_was_open_from_the_start() -> None:
    with pico(HELD) as host:
        host.board.contact("e_stop", is_open=True)
        host.board.reset(1)
        host.wait(0.01)
        host.acknowledge(Code.RESET)
        host.setup(SETUP)
        assert host.arm() == Code.E_STOP
        host.drive(DRIVE)
        assert host.pin_V() == 0.0


@pytest.mark.parametrize(("contact", "outward"), [("end_high", 1), *evidence(("end_low", -1))])
def test_an_end_switch_means_0_V_within_two_ticks_and_only_inward_from_there(
    contact: PicoContact, outward: int
) -> None:
    rng = random.Random(outward)
    with armed_pico(HELD, options=ENDS) as host:
        for _ in range(PHASES):
            host.drive(DRIVE * outward)
            host.wait(rng.uniform(0.0, 0.01))
            host.board.contact(contact, is_open=True)
            off_after_s(host, host.board.now_s(), 2 * TICK_S)
            latched_at_zero(host, Code.END_SWITCH)
            assert host.arm_anew() == Code.NONE and host.state().status & STATUS_RECOVERING
            host.drive(-DRIVE * outward)
            host.wait(0.003)
            assert host.pin_V() * outward < 0.0
            host.drive(DRIVE * outward)
            assert host.pin_V() == 0.0
            host.board.contact(contact, is_open=False)
            host.wait(0.002)
            arm_anew(host)


@pytest.mark.parametrize("options", [*evidence((Variant(),)), FAST], ids=["115200", str(FAST.baud)])
def test_garbage_never_moves_the_drive(options: Variant) -> None:
    """Random bytes, damaged frames and halves of frames, while armed: the pins stay at 0, or go to 0 and stay there."""
    rng = random.Random(options.baud)
    good = encode(Kind.DRIVE, 7, pack_drive(3000))
    with armed_pico(HELD, SETUP._replace(watchdog_ms=1000), options) as host:
        before = host.truth().pin_changed_s
        for k in range(90):
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


def test_a_flood_of_garbage_neither_feeds_the_watchdog_nor_hangs_the_program() -> None:
    rng = random.Random(2)
    with armed_pico(HELD, options=FAST) as host:
        host.drive(DRIVE)
        heard_s = host.heard_s
        while host.board.now_s() < heard_s + 0.2:
            host.board.write(rng.randbytes(200))
            host.wait(0.002)  # without a pause
        truth = host.truth()
        assert truth.pin_V == 0.0 and truth.pin_changed_s - heard_s <= 0.100 + TICK_S
        assert (truth.resets, truth.overruns) == (0, 0)
        host.send_raw(b"\0")
        host.wait(0.005)
        host.board.read(0.0)
        latched_at_zero(host, Code.WATCHDOG)


def test_no_drive_before_arming_nor_beyond_the_largest() -> None:
    with pico(HELD) as host:
        host.drive(DRIVE)
        assert host.pin_V() == 0.0 and host.state().fault == Code.RESET
        host.acknowledge(Code.RESET)
        host.drive(DRIVE)
        assert host.pin_V() == 0.0 and host.state().fault == Code.NOT_ARMED
        host.setup(SETUP)
        host.drive(DRIVE)
        assert host.pin_V() == 0.0
        assert host.arm() == Code.NONE
        for units in (3126, -3126, 32767, -32768):
            host.drive(DRIVE)
            assert host.pin_V() > 0.0
            host.drive(units)
            latched_at_zero(host, Code.DRIVE_RANGE)
            assert host.arm_anew() == Code.NONE


@pytest.mark.parametrize("cause", [2, *evidence(1, 4)])
def test_a_reset_means_0_V_at_once_and_voids_the_session(cause: int) -> None:
    """A brown-out is a power-on to this chip."""
    words = {1: "power-on", 2: "external", 4: "power-on"}[cause]
    with armed_pico(HELD) as host:
        host.drive(DRIVE)
        host.board.reset(cause, 0.01)
        assert host.pin_V() == 0.0
        host.wait(0.02)
        assert host.pin_V() == 0.0 and host.hello().reset_words == words
        assert host.arm() == Code.RESET
        assert host.arm_anew() == Code.NO_SETUP
        host.drive(DRIVE)
        assert host.pin_V() == 0.0


@pytest.mark.parametrize(("start_rad", "direction"), [(0.2, 1), *evidence((-0.3, -1))])
def test_a_motor_that_runs_into_the_limit_is_cut_within_two_ticks(start_rad: float, direction: int) -> None:
    """The real motion."""
    limit_rad = (3900.5 - 2048) * LSB_RAD
    with armed_pico(replace(QUIET, start_rad=start_rad)) as host:
        cut_s = crossed_s = None
        while cut_s is None:
            host.drive(2340 * direction)
            while cut_s is None and host.board.now_s() < host.heard_s + 0.02:
                host.wait(100e-6)
                truth = host.truth()
                if crossed_s is None and abs(truth.y_rad) > limit_rad:
                    crossed_s = truth.t_s
                if truth.pin_V == 0.0:
                    cut_s = truth.pin_changed_s
        assert crossed_s is not None and cut_s - crossed_s <= 2 * TICK_S


# ---------------------------------------------------------------------- the tick


def test_a_tick_that_takes_too_long_leaves_out_those_that_come_due_and_goes_on() -> None:
    """An alarm that lies in the past would fire an hour later, and the watchdog would reset the chip."""
    with armed_pico(HELD, SETUP._replace(watchdog_ms=1000)) as host:
        host.drive(DRIVE)
        for stall_s in (0.9e-3, 0.998e-3, 1.0e-3, 1.002e-3, 3.3e-3):
            host.board.stall("tick", stall_s)
            host.wait(0.2)
            assert host.truth().resets == 0 and host.pin_V() > 0.0
            host.drive(DRIVE)
