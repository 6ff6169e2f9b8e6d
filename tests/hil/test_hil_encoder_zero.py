"""What ends the zero of an encoder while nothing drives: one channel that stands still, and a homing that begins.

At the pins of the Uno's chip, the Pico's chip and the host board, in virtual time.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import pytest
from both_chips import PICO, UNO
from evidence import evidence
from test_hil_encoder import ENDLESS, LIMITED, MOTOR, WIRED, turning
from virtual_host import Host, VirtualHost

from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.frames import STATUS_ZERO, Code, Kind, Setup, pack_ack, pack_zero
from rig.model.bench import BenchParameters, SensorWiring

AnyHost = Host[Any]
Boards = Callable[[BenchParameters], AbstractContextManager[AnyHost]]
HOMING = LIMITED._replace(homing=1)
TURNED_RAD = 1.2
LONE_EDGES = 32  # in a row, of one channel, before it counts as alone: firmware/boards/uno/encoder.h
UNITS = 60  # of a drive; on a Pico it is much weaker


def uno_board(bench: BenchParameters) -> AbstractContextManager[AnyHost]:
    return UNO.powered(bench, WIRED)


def pico_board(bench: BenchParameters) -> AbstractContextManager[AnyHost]:
    return PICO.powered(bench, WIRED)


@contextmanager
def host_board(bench: BenchParameters) -> Iterator[AnyHost]:
    yield VirtualHost(VirtualBoard(bench))


each_board = pytest.mark.parametrize("board", [uno_board, pico_board, host_board], ids=["uno", "pico", "host"])


def zeroed(host: AnyHost, setup: Setup = LIMITED) -> AnyHost:
    """Set up, with a zero where the shaft stands, and no fault."""
    host.acknowledge(Code.RESET)
    host.setup(setup)
    assert host.ask(Kind.ZERO, pack_zero(0)).kind == Kind.ZERO_REPLY
    return host


def turn(host: AnyHost, by_rad: float, rad_s: float) -> None:
    """Turn the shaft by hand, and hold it there."""
    from_rad = host.board.truth().y_rad
    host.board.place(from_rad, rad_s if by_rad > 0.0 else -rad_s)
    host.wait(abs(by_rad) / rad_s)
    host.board.place(from_rad + by_rad, 0.0)
    host.wait(0.005)


def tremble(host: AnyHost, edges: int, edge_rad: float) -> None:
    """Let the shaft go to and fro over one edge, so many times; it ends where it was for an even number."""
    at_rad = host.board.truth().y_rad
    for k in range(edges):
        host.board.place(at_rad if k % 2 else at_rad + edge_rad)
        host.wait(0.001)


def refuses_to_drive(host: AnyHost) -> bool:
    """Whether a command that a person gives now is refused for the zero, and its drive stays at 0."""
    code = host.arm_anew()
    host.drive(UNITS)
    host.wait(0.003)
    return code == Code.NO_ZERO and host.board.truth().pin_V == 0.0


@each_board
@pytest.mark.parametrize("channel", ["still", *evidence("still_a")])
def test_a_channel_that_stands_still_while_disarmed_ends_the_zero(board: Boards, channel: SensorWiring) -> None:
    """However fast the hand, however fine the encoder, wherever it begins, either way."""
    rng = random.Random(f"{board.__name__} {channel}")
    for counts_per_rad, rad_s in ((60.0, 3.0), (510.0, 2.0), (510.0, 40.0), (3000.0, 10.0)):
        with board(turning(counts_per_rad)) as host:
            zeroed(host)
            turn(host, rng.uniform(0.0, 4.0) / counts_per_rad, 1.0)
            assert host.state().status & STATUS_ZERO
            host.board.rewire(sensor=channel)
            turn(host, rng.choice((-1.0, 1.0)) * TURNED_RAD, rad_s)
            host.board.rewire()  # the wire makes contact again
            host.wait(0.005)
            state = host.state()
            assert state.fault == Code.ENCODER_STILL and not state.status & STATUS_ZERO
            assert abs(state.counts) < 10  # it has no idea of the turn
            assert host.arm() == Code.ENCODER_STILL
            assert refuses_to_drive(host)


@each_board
def test_a_hand_that_turns_the_shaft_leaves_the_zero(board: Boards) -> None:
    """To and fro at any speed, over two edges or more; and over one, fewer times than a channel may change alone."""
    rng = random.Random(5)
    with board(turning(500.0)) as host:
        zeroed(host)
        for _ in range(30):
            turn(host, rng.choice((-1.0, 1.0)) * rng.uniform(0.003, 0.3), rng.uniform(1.0, 30.0))
        tremble(host, 100, 2.0 / 500.0)
        turn(host, -host.board.truth().y_rad, 5.0)
        tremble(host, LONE_EDGES - 1, 1.0 / 500.0)
        state = host.state()
        assert state.fault == Code.NONE and state.status & STATUS_ZERO
        assert abs(state.counts - 500.0 * host.board.truth().y_rad) <= 1.0
        assert host.arm() == Code.NONE


@each_board
def test_a_shaft_that_trembles_on_an_edge_loses_its_zero(board: Boards) -> None:
    """The board cannot tell it from a loose wire."""
    with board(turning(500.0)) as host:
        zeroed(host)
        tremble(host, LONE_EDGES + 2, 1.0 / 500.0)
        assert host.state().fault == Code.ENCODER_STILL
        assert refuses_to_drive(host)


@each_board
@pytest.mark.parametrize("moment", ["before SETUP", "in a pause", *evidence("between SETUP and ARM", "after a reset")])
def test_it_is_seen_whenever_nothing_drives(board: Boards, moment: str) -> None:
    with board(turning(500.0)) as host:
        host.acknowledge(Code.RESET)
        assert host.ask(Kind.ZERO, pack_zero(0)).kind == Kind.ZERO_REPLY
        if moment != "before SETUP":
            host.setup(LIMITED)
        if moment == "in a pause":
            assert host.arm() == Code.NONE
            host.drive(UNITS)
            host.ask(Kind.STOP)
        if moment == "after a reset":
            host.board.reset(2)
            host.wait(0.02)
            host.acknowledge(Code.RESET)
        host.board.rewire(sensor="still")
        turn(host, 0.2, 30.0)
        host.board.rewire()
        if moment in ("before SETUP", "after a reset"):
            host.setup(LIMITED)
        assert host.arm() == Code.ENCODER_STILL
        packet = host.ask(Kind.ZERO, pack_zero(100))  # worked out, perhaps, from counts of before
        assert packet.kind == Kind.NACK and packet.body[0] == Code.ENCODER_STILL
        assert refuses_to_drive(host)
        assert host.ask(Kind.ZERO, pack_zero(100)).kind == Kind.ZERO_REPLY
        assert host.arm() == Code.NONE


def test_edges_within_a_tick_are_seen_too() -> None:
    """A Pico counts 2,000 in a tick. The wire that makes contact again is an edge of the other channel."""
    rate = 1_500_000.0
    with pico_board(turning(rate)) as host:
        zeroed(host, LIMITED._replace(hard_lo=-(10**9), hard_hi=10**9))
        host.board.rewire(sensor="still")
        host.board.place(0.0, 1.0)
        host.wait(150.0 / rate)
        host.board.place(host.board.truth().y_rad, 0.0)
        host.wait(1e-5)  # both channels at once would be another fault
        host.board.rewire()
        host.wait(0.003)
        assert host.state().fault == Code.ENCODER_STILL
        assert refuses_to_drive(host)


def _silent(host: AnyHost) -> None:
    host.wait(0.2)  # as after kill -9


def _stopped(host: AnyHost) -> None:
    host.ask(Kind.STOP)


def _reset(host: AnyHost) -> None:
    host.board.reset(2)
    host.wait(0.02)


def _too_far(host: AnyHost) -> None:
    host.board.place(5.0)
    host.wait(0.3)


def _lost(host: AnyHost) -> None:
    host.board.rewire(sensor="jumped")
    host.wait(0.01)
    host.board.rewire()
    host.wait(0.01)


def _another_begins(host: AnyHost) -> None:
    host.ask(Kind.STOP)
    host.setup(ENDLESS._replace(session=99))
    host.setup(LIMITED)


@each_board
@pytest.mark.parametrize("end", [_silent, _reset, _lost, *evidence(_stopped, _too_far, _another_begins)])
@pytest.mark.parametrize("drives", [True, *evidence(False)])
def test_a_homing_that_does_not_end_well_leaves_no_zero(
    board: Boards, end: Callable[[AnyHost], None], drives: bool
) -> None:
    """Not the older one, which may be wrong: that is why somebody homes it."""
    with board(MOTOR) as host:
        zeroed(host)
        host.setup(HOMING)
        assert not host.state().status & STATUS_ZERO
        if drives:
            assert host.arm() == Code.NONE
            host.drive(UNITS)
            host.wait(0.01)
            assert host.board.truth().pin_V != 0.0
        end(host)
        while (state := host.state()).fault != Code.NONE and host.ask(
            Kind.ACK, pack_ack(state.fault)
        ).kind != Kind.NACK:
            pass
        if not host.state().status & STATUS_ZERO:
            host.setup(LIMITED)
        assert refuses_to_drive(host)


@each_board
def test_a_homing_that_is_refused_has_not_begun(board: Boards) -> None:
    """Under drive nothing changes, and without limits nothing can be homed."""
    with board(MOTOR) as host:
        zeroed(host)
        assert host.ask(Kind.SETUP, ENDLESS._replace(homing=1).pack()).kind == Kind.NACK
        assert host.arm() == Code.NONE
        host.drive(UNITS)
        assert host.ask(Kind.SETUP, HOMING.pack()).kind == Kind.NACK
        host.ask(Kind.STOP)
        assert host.state().status & STATUS_ZERO and host.arm() == Code.NONE
