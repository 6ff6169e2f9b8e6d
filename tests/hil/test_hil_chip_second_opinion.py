"""The Uno's firmware on avr8js, an emulator independent of simavr: the same frames, the same limit cycle."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from chip_host import QUIET, SETUP
from second_chip import SecondChip, SecondHost
from virtual_host import LSB_RAD, SESSION, TICK_S

from emulated_chips.virtual_chip import VirtualChip
from rig.backends.serial.frames import (
    Block,
    Code,
    DeviceState,
    FrameReader,
    Hello,
    Kind,
    Packet,
    RelaySetup,
    encode,
    pack_ack,
    pack_arm,
    pack_drive,
)
from rig.model.friction import Friction
from rig.model.motor import Motor

QUICK = replace(QUIET, motor=Motor(0.08, 15.0, Friction(0.50, 0.46, 0.54, 0.50), 0.01), start_rad=0.306)
UNIT_V = 12.0 / 400
PIN_V = 0.05 * UNIT_V  # tolerance of a mean over pulses
PWM_S = 50e-6  # within which a drive comes into force
SLOT_S = 0.02
RELAY = RelaySetup((-50, 16, -16, 50), 512 * 16, 5_000_000, 1, 10)
KEEP_S = 0.05
KEEPS, SETTLED_KEEPS = 10, 64
CYCLES = 3
ALIKE_BLOCKS = 40  # nearly a cycle
TICK_COUNTS = 2  # that a drive which comes a tick sooner moves the shaft by, at most
# tolerances: the clock's 4 us; for a drive an interrupt that comes first on one chip alone; one conversion
TIMES_US = {"now_us": 8, "t_drive_us": 8 + 10, "t_sample_us": 112 + 8}

REQUESTS: list[tuple[int, bytes]] = [
    (Kind.HELLO, b""),
    (Kind.READ, b""),
    (Kind.ARM, pack_arm(SESSION)),  # refused: it was reset
    (Kind.ACK, pack_ack(Code.RESET)),
    (Kind.ARM, pack_arm(SESSION)),  # refused: no limits yet
    (Kind.SETUP, SETUP.pack()),
    (Kind.DRIVE, pack_drive(40)),  # not armed
    (Kind.READ, b""),
    (Kind.ARM, pack_arm(SESSION)),
    (Kind.DRIVE, pack_drive(60)),
    (Kind.READ, b""),
    (Kind.DRIVE, pack_drive(-41)),
    (Kind.READ, b""),
    (Kind.DRIVE, pack_drive(0)),
    (Kind.DRIVE, pack_drive(1)),
    (Kind.READ, b""),
    (Kind.DRIVE, pack_drive(SETUP.max_drive + 1)),  # too much
    (Kind.READ, b""),
    (0x33, b""),  # no such request
    (Kind.STOP, b""),
    (Kind.ARM, pack_arm(SESSION)),  # refused: STOP clears nothing
    (Kind.ACK, pack_ack(Code.DRIVE_RANGE)),
    (Kind.ARM, pack_arm(SESSION)),
    (Kind.RELAY, RELAY.pack()),
]
DRIVES = [0, 0, 0, 0, 0, 0, 0, 0, 0, 60, 60, -41, -41, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0]  # of each slot before the relay's


class Session(NamedTuple):
    """What a chip said and did.

    replies   packets that came in the slot of each request
    drive_V   mean at the pins in the second half of each slot
    y_rad     position of the shaft at its end
    stream    packets that came while the relay ran, and after its STOP
    """

    replies: list[list[Packet]]
    drive_V: list[float]
    y_rad: list[float]
    stream: list[Packet]

    def blocks(self) -> list[Block]:
        """Of the relay, in order."""
        return [Block.unpack(p.body) for p in itertools.chain(self.replies[-1], self.stream) if p.kind == Kind.BLOCK]


def session(board: VirtualChip | SecondChip, keeps: int = KEEPS) -> Session:
    """The same bytes at the same times to any chip: when one is sent does not depend on what was answered before."""
    reader, numbers = FrameReader(), itertools.count(1)
    told = Session([], [], [], [])

    def ask(kind: int, body: bytes, slot_s: float) -> list[Packet]:
        board.write(encode(kind, next(numbers), body))
        from_s = board.now_s()
        board.sleep_until(from_s + 0.5 * slot_s)
        board.sleep_until(from_s + slot_s)
        truth = board.truth()
        told.drive_V.append(truth.pin_V)
        told.y_rad.append(truth.y_rad)
        packets = []
        while data := board.read(0.0):
            packets += reader.feed(data)
        return packets

    board.sleep_until(SLOT_S)
    for kind, body in REQUESTS:
        told.replies.append(ask(kind, body, SLOT_S))
    for _ in range(keeps):
        told.stream.extend(ask(Kind.KEEP, b"", KEEP_S))
    told.stream.extend(ask(Kind.STOP, b"", SLOT_S))
    assert reader.bad_frames == 0
    assert board.truth().overruns == 0
    return told


@pytest.fixture(scope="module")
def simavr() -> Session:
    return session(VirtualChip(QUICK))


@pytest.fixture(scope="module")
def avr8js() -> Session:
    with SecondChip(QUICK) as board:
        told = session(board)
        assert board.truth().resets == 0
        return told


def assert_alike(one: Packet, other: Packet) -> None:
    """All of two packets but times and counts to the bit; those as near as two chips' instants can be."""
    assert one[:2] == other[:2]
    layouts: dict[int, Callable[[bytes], NamedTuple]] = {
        Kind.HELLO_REPLY: Hello.unpack, Kind.STATE: DeviceState.unpack, Kind.STOP_REPLY: DeviceState.unpack,
        Kind.ACK_REPLY: DeviceState.unpack,
    }  # fmt: skip
    unpack = layouts.get(one.kind)
    if unpack is None:
        assert one.body == other.body
        return
    others = unpack(other.body)._asdict()
    for name, value in unpack(one.body)._asdict().items():
        if name in TIMES_US:
            assert abs(value - others[name]) <= TIMES_US[name], name
        elif name == "counts":
            assert abs(value - others[name]) <= 1
        else:
            assert value == others[name], name


def test_every_request_is_answered_alike(simavr: Session, avr8js: Session) -> None:
    answers = [[p for p in packets if p.kind != Kind.BLOCK] for packets in avr8js.replies]
    for (kind, _), ones, others in zip(REQUESTS, simavr.replies, answers, strict=True):
        ones = [p for p in ones if p.kind != Kind.BLOCK]
        assert len(ones) == len(others) == (0 if kind == Kind.DRIVE else 1)
        for one, other in zip(ones, others, strict=True):
            assert_alike(one, other)
    kinds = {packets[0].kind for packets in answers if packets}
    assert kinds == {
        Kind.HELLO_REPLY, Kind.SETUP_REPLY, Kind.ARM_REPLY, Kind.STATE, Kind.STOP_REPLY, Kind.RELAY_REPLY, Kind.NACK,
        Kind.ACK_REPLY,
    }  # fmt: skip
    assert [packets[0].body[0] for packets in answers if packets and packets[0].kind == Kind.ARM_REPLY] == [
        Code.RESET, Code.NO_SETUP, Code.NONE, Code.DRIVE_RANGE, Code.NONE
    ]  # fmt: skip


def test_the_pins_do_what_the_registers_say(simavr: Session, avr8js: Session) -> None:
    """The drive of simavr is read from the timer's registers, that of avr8js is how long the pins are high."""
    for units, by_registers_V, by_pins_V in zip(DRIVES, simavr.drive_V, avr8js.drive_V, strict=False):
        assert by_registers_V == pytest.approx(units * UNIT_V, abs=1e-12)
        assert by_pins_V == pytest.approx(units * UNIT_V, abs=PIN_V)
        assert by_pins_V != 0.0 or units == 0
    moved_rad = np.abs(np.diff(simavr.y_rad[: len(DRIVES)]))
    assert moved_rad.max() > 0.1
    # a motor written in another language, too; a drive that comes later by part of a PWM period
    most_rad = 2 * PWM_S * moved_rad.max() / SLOT_S + 1e-3
    assert avr8js.y_rad[: len(DRIVES)] == pytest.approx(simavr.y_rad[: len(DRIVES)], abs=most_rad)


def test_the_relays_blocks_are_alike(simavr: Session, avr8js: Session) -> None:
    ones, others = simavr.blocks(), avr8js.blocks()
    assert len(ones) == len(others) >= ALIKE_BLOCKS
    for one, other in zip(ones, others, strict=True):
        assert abs(one.t_first_us - other.t_first_us) <= 8
        assert (one.period_us, one.status, one.fault) == (other.period_us, other.status, other.fault)
        assert abs(one.delay_us - other.delay_us) <= 20
        assert len(one.rows) == len(other.rows)
    (state,) = (p for p in simavr.stream if p.kind == Kind.STOP_REPLY)
    (other_state,) = (p for p in avr8js.stream if p.kind == Kind.STOP_REPLY)
    assert (state.seq, len(state.body)) == (other_state.seq, len(other_state.body))
    # A decision may hang on one count, by which the two may differ: then one takes it sooner, and the shaft is
    # some counts ahead from there. Later their phases drift apart, though not their cycles.
    first = np.array([row for block in ones[:ALIKE_BLOCKS] for row in block.rows])
    other_first = np.array([row for block in others[:ALIKE_BLOCKS] for row in block.rows])
    apart = np.abs(first - other_first)[:, 0]
    differ = np.flatnonzero(first[:, 1] != other_first[:, 1])
    until = differ[0] if differ.size else len(first)
    assert until > 60  # a decision at least: 32 rows are the first drive's
    assert apart[:until].max() <= 1
    steps = np.flatnonzero(np.diff(first[:, 1]))
    assert all(np.abs(steps - tick).min() <= 4 for tick in differ)
    assert apart.max() <= 1 + differ.size * TICK_COUNTS


class LimitCycle(NamedTuple):
    """Means of the last cycles; ``spread``: of their periods, relative."""

    period_s: float
    amplitude_counts: float
    spread: float


def limit_cycle(told: Session) -> LimitCycle:
    """A cycle begins where the integral of the position rises through zero."""
    y = np.array([counts for block in told.blocks() for counts, _ in block.rows]) - RELAY.centre / 16
    z = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]))])
    up = np.flatnonzero((z[:-1] < 0.0) & (z[1:] >= 0.0))[-CYCLES - 1 :]
    assert len(up) == CYCLES + 1
    periods_s = TICK_S * np.diff(up - z[up] / (z[up + 1] - z[up]))
    amplitudes = [0.5 * np.ptp(y[i:j]) for i, j in itertools.pairwise(up)]
    mean_s = float(periods_s.mean())
    return LimitCycle(mean_s, float(np.mean(amplitudes)), float(np.ptp(periods_s)) / mean_s)


@pytest.mark.evidence
def test_the_limit_cycle_is_the_same_within_2_percent() -> None:
    with SecondChip(QUICK) as board:
        long, other_long = session(VirtualChip(QUICK), SETTLED_KEEPS), session(board, SETTLED_KEEPS)
    assert len(long.blocks()) == len(other_long.blocks()) >= 300
    one, other = limit_cycle(long), limit_cycle(other_long)
    assert max(one.spread, other.spread) < 0.02  # settled, but for a tick here and there
    assert other.period_s == pytest.approx(one.period_s, rel=0.02)
    assert other.amplitude_counts == pytest.approx(one.amplitude_counts, rel=0.02)
    assert one.amplitude_counts * LSB_RAD > 0.5


def driving(board: SecondChip, watchdog_ms: int = SETUP.watchdog_ms) -> SecondHost:
    host = SecondHost(board)
    host.acknowledge(Code.RESET)
    host.setup(SETUP._replace(watchdog_ms=watchdog_ms))
    assert host.arm() == Code.NONE
    host.drive(50)
    host.wait(20 * PWM_S)
    host.wait(20 * PWM_S)
    assert host.pin_V() == pytest.approx(50 * UNIT_V, abs=PIN_V)
    return host


def test_the_e_stop_ends_the_pulses_within_a_tick_here_too() -> None:
    with SecondChip(QUICK) as board:
        host = driving(board)
        board.contact(is_open=True)
        host.wait(TICK_S)
        host.wait(40 * PWM_S)
        assert host.pin_V() == 0.0
        assert host.state().fault == Code.E_STOP and not host.truth().led


def test_an_e_stop_opened_and_closed_while_disarmed_is_latched_here_too() -> None:
    with SecondChip(QUICK) as board:
        host = driving(board)
        host.ask(Kind.STOP)
        board.contact(is_open=True)
        host.wait(100e-6)
        board.contact(is_open=False)
        host.wait(2 * TICK_S)
        assert host.arm() == Code.E_STOP
        host.drive(50)
        host.wait(40 * PWM_S)
        assert host.pin_V() == 0.0


def test_the_hardware_watchdog_ends_a_hang_here_too() -> None:
    with SecondChip(QUICK) as board:
        host = driving(board, watchdog_ms=1000)
        board.hang()
        host.wait(0.11)
        assert host.pin_V() == pytest.approx(50 * UNIT_V, abs=PIN_V)
        host.wait(0.04)
        host.wait(40 * PWM_S)
        assert host.pin_V() == 0.0 and host.truth().resets == 1
        assert host.hello().reset_words == "watchdog"
        assert host.arm() == Code.RESET and host.arm_anew() == Code.NO_SETUP


def test_the_tick_outlives_the_main_loop_here_too() -> None:
    """The watchdog for the host's silence is the tick's, which interrupts the main loop."""
    with SecondChip(QUICK) as board:
        host = driving(board)
        silent_s = board.now_s() - host.heard_s
        board.hang()
        host.wait(0.098 - silent_s)
        assert host.pin_V() == pytest.approx(50 * UNIT_V, abs=PIN_V)
        host.wait(0.004)
        host.wait(40 * PWM_S)
        assert host.pin_V() == 0.0 and host.truth().resets == 0


def test_a_bench_that_it_does_not_have_is_refused() -> None:
    with pytest.raises(ValueError, match="noise"):
        SecondChip(replace(QUICK, noise_rad=0.003))


def test_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(RuntimeError, match=r"node is missing.*make setup"):
        SecondChip(QUICK)
