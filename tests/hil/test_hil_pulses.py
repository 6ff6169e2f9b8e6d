"""A drive that the device ends by itself: at the pins of boards with an encoder, and as it is reported."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest
from test_hil_encoder import LIMITED, turning
from test_hil_encoder_zero import AnyHost, Boards, each_board, zeroed
from virtual_host import HELD, TICK_S

from rig.backends.driver import Timeouts
from rig.backends.serial.driver import SerialDriver
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.frames import (
    FEATURE_PULSE,
    STATUS_ARMED,
    Code,
    Kind,
    encode,
    pack_drive,
    pack_pulse,
    pack_zero,
)
from rig.core.calibration import Calibration, DriveMap, Scaling
from rig.core.signals import Limits
from stalls.hostile_host import HostileHost

LIMITS = Limits((-1.1, 1.1), (-1.9, 1.9), 3.0, 0.25)
SCALING = Scaling(Calibration([(24, -2.0015625), (1000, 2.0015625)]), DriveMap(12.0), (5, 1018))
PULSE_MS, UNITS = 30, 60
LATE_S = 2 * TICK_S  # the pulse ends in a tick, and the frame is some time on its way


def drive_ended_s(host: AnyHost, within_s: float) -> float:
    """When the drive at the pin was 0 for good, s; nothing else is said to the device meanwhile."""
    last_s = host.board.now_s()
    until_s = last_s + within_s
    while host.board.now_s() < until_s:
        host.wait(0.25 * TICK_S)
        if host.pin_V() != 0.0:
            last_s = host.board.now_s()
    return float(last_s)


def pulse(host: AnyHost, units: int = UNITS, longest_ms: int = PULSE_MS) -> float:
    """Send one; when it drives, s."""
    host.send(Kind.PULSE, pack_pulse(units, longest_ms))
    host.board.sleep_until(host.heard_s + 0.5 * TICK_S)
    return float(host.heard_s)


def ready(host: AnyHost) -> None:
    """Armed, and no pulse has come."""
    host.arm_anew()
    host.send(Kind.DRIVE, pack_drive(0))
    host.wait(0.002)


def hostile_pulses(host: AnyHost) -> Iterator[tuple[str, float, float]]:
    """What a host may do with a pulse; when the pulse must end, and when its drive did."""
    ready(host)
    sent_s = pulse(host)
    assert host.pin_V() != 0.0
    yield "and dies", sent_s, drive_ended_s(host, 0.2)
    assert host.state().fault == Code.WATCHDOG  # a pulse that is over keeps no dead host alive

    ready(host)
    frame = encode(Kind.PULSE, 77, pack_pulse(UNITS, PULSE_MS))
    sent_s = pulse(host)
    for _ in range(40):  # one frame, again and again, and readings between
        host.send_raw(frame)
        host.send(Kind.READ)
        host.wait(0.001)
        if host.board.now_s() > sent_s + 1e-3 * PULSE_MS + LATE_S:
            assert host.pin_V() == 0.0
    yield "and repeats it", sent_s, min(drive_ended_s(host, 0.05), sent_s + 1e-3 * PULSE_MS)
    assert host.state().status & STATUS_ARMED

    ready(host)
    sent_s = pulse(host)
    host.wait(0.01)
    pulse(host, -UNITS, 10 * PULSE_MS)  # another one into the first
    yield "and overlaps it", sent_s, drive_ended_s(host, 0.09)

    ready(host)
    pulse(host)
    host.ask(Kind.STOP)
    now_s = host.board.now_s()
    pulse(host)
    yield "and one more after a STOP", now_s - 1e-3 * PULSE_MS, drive_ended_s(host, 0.05)
    assert host.arm() == Code.NONE  # nor does arming bring it back
    yield "and arms", host.board.now_s() - 1e-3 * PULSE_MS, drive_ended_s(host, 0.05)


@each_board
def test_a_pulse_ends_at_the_pin_whatever_the_host_does(board: Boards) -> None:
    with board(replace(turning(500.0), motor=HELD.motor)) as host:
        assert host.hello().features & FEATURE_PULSE
        zeroed(host)
        for what, sent_s, ended_s in hostile_pulses(host):
            assert ended_s <= sent_s + 1e-3 * PULSE_MS + LATE_S, what


@each_board
def test_in_a_recovery_a_pulse_drives_inward_and_no_longer_than_its_time(board: Boards) -> None:
    with board(replace(turning(500.0), motor=HELD.motor)) as host:
        zeroed(host)
        host.ask(Kind.ZERO, pack_zero(LIMITED.hard_hi + 100))
        ready(host)
        sent_s = pulse(host, -UNITS)
        assert host.pin_V() != 0.0
        assert drive_ended_s(host, 0.06) <= sent_s + 1e-3 * PULSE_MS + LATE_S
        assert host.state().status & STATUS_ARMED
        ready(host)
        pulse(host)
        assert host.pin_V() == 0.0 and host.state().fault == Code.TRAVEL


def driver_on(board: VirtualBoard | HostileHost) -> SerialDriver:
    driver = SerialDriver(board, SCALING, Timeouts(0.03), session=4711, emulated=True)
    driver.open()
    driver.arm(LIMITS)
    return driver


@pytest.mark.parametrize("readings", [1, 2, 3])
def test_a_pulse_that_the_device_has_ended_is_reported_as_it_acted(readings: int) -> None:
    """A loop may read twice before it drives again: where the first reading was old."""
    board = VirtualBoard(HELD)
    driver = driver_on(board)
    driver.write(0.0)
    driver.read()
    driver.write_pulse(1.0, 0.02)
    sent_s = board.now_s()
    board.sleep_until(sent_s + 0.2)
    for _ in range(readings):
        began = driver.read()
        assert began.u_V == pytest.approx(1.0, abs=0.02) and 0.0 < began.t_u_s - sent_s < 0.004
    driver.write(0.0)
    board.sleep_until(board.now_s() + 0.01)
    for _ in range(readings):
        ended = driver.read()
        assert ended.u_V == 0.0 and ended.t_u_s - began.t_u_s == pytest.approx(0.02, abs=0.0015)


def test_a_pulse_of_less_than_half_a_step_has_not_begun_before_it_was_sent() -> None:
    board = VirtualBoard(HELD)
    driver = driver_on(board)
    driver.write(0.0)
    before = driver.read()
    for u_V in (0.001, 0.002, 1.0):
        driver.write_pulse(u_V, 0.05)
        board.sleep_until(board.now_s() + 0.01)
        now = driver.read()
        assert 0.0 < now.t_u_s - before.t_s < 0.01 and math.isclose(now.u_V, u_V, abs_tol=0.02)
        before = now
