"""The opening of the link, heard by a boot loader: at no moment does it read "program page"."""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple

import pytest
from boot_loader import Line, Outcome, Program, Receiver, atmegaboot, optiboot, outcome
from evidence import evidence

from rig.backends.serial import frames
from rig.backends.serial.frames import Kind
from rig.backends.serial.introduction import _harmless_numbers, await_introduction
from rig.core.faults import Fault

OPEN_S = 5.0
CLOCK_ERRORS = (-0.025, 0.0, 0.025)  # of a ceramic resonator and a USB chip together
PHASES = (0.05, 0.3, 0.55, 0.8)
LONGEST_GAP_S = 40e-6  # that a USB chip leaves between two bytes that it was given together


class Board(NamedTuple):
    """A boot loader and how its receiver is set."""

    program: Callable[[], Program]
    divisor: int
    double_speed: bool


BOARDS = {
    "Uno": Board(optiboot, 17, True),  # 115200 baud
    "old Nano": Board(atmegaboot, 17, False),  # 57600
    "Diecimila": Board(atmegaboot, 52, False),  # 19200
}


class Tap:
    """A transport without a device: keeps what is written, and when."""

    def __init__(self) -> None:
        self.written: list[tuple[float, bytes]] = []
        self._now_s = 0.0

    def write(self, data: bytes) -> None:
        self.written.append((self._now_s, data))

    def read(self, timeout_s: float) -> bytes:
        self._now_s += max(timeout_s, 0.0)
        return b""

    def now_s(self) -> float:
        return self._now_s

    def close(self) -> None:
        pass


def opening() -> list[tuple[float, bytes]]:
    """All that is written until it is given up."""
    tap = Tap()
    with pytest.raises(Fault, match="LINK_HELLO"):
        await_introduction(tap, frames.FrameReader(), OPEN_S)
    return tap.written


def letters(
    writes: list[tuple[float, bytes]], baud: float, together: int = 1, gap_s: Callable[[], float] = lambda: 0.0
) -> Iterator[tuple[float, int]]:
    """Bytes on the line, where the USB chip joins so many writes to one; and what gap it leaves after each byte."""
    free_s = 0.0
    for i in range(0, len(writes), together):
        batch = writes[i : i + together]
        for byte in b"".join(data for _, data in batch):
            start_s = max(free_s, batch[-1][0])
            yield start_s, byte
            free_s = start_s + 10 / baud + gap_s()


def outcomes(board: Board, line: Line) -> Counter[Outcome]:
    """What a boot loader does that begins to listen just before each of the line's edges, at every phase and rate."""
    seen: Counter[Outcome] = Counter()
    for error in CLOCK_ERRORS:
        receiver = Receiver.at(board.divisor, double_speed=board.double_speed, clock_error=error)
        for fall_s in line.falls:
            for phase in PHASES:
                seen[outcome(board.program(), receiver.reads(line, fall_s - receiver.sample_s, phase))] += 1
    return seen


# ---------------------------------------------------------------------- the receiver itself


@pytest.mark.parametrize("error", CLOCK_ERRORS)
@pytest.mark.parametrize(("name", "baud"), [("Uno", 115200), ("old Nano", 57600), ("Diecimila", 19200)])
def test_the_receiver_reads_its_own_baud_rate(name: str, baud: int, error: float) -> None:
    data = bytes(range(256))
    board = BOARDS[name]
    actual = 16e6 / board.divisor / (8 if board.double_speed else 16)
    assert actual == pytest.approx(baud, rel=0.025)
    line = Line(letters([(1e-3, data)], actual), 1 / actual)
    receiver = Receiver.at(board.divisor, double_speed=board.double_speed, clock_error=0.6 * error)
    assert bytes(receiver.reads(line, 0.0, 0.4)) == data


def test_a_page_is_programmed_by_who_means_it() -> None:
    data = b"0 A\x81 U\x00\x00 d\x00\x02Fxy "
    for name in ("Uno", "old Nano"):
        board = BOARDS[name]
        actual = 16e6 / board.divisor / (8 if board.double_speed else 16)
        line = Line(letters([(1e-3, data)], actual), 1 / actual)
        receiver = Receiver.at(board.divisor, double_speed=board.double_speed)
        assert outcome(board.program(), receiver.reads(line, 0.0, 0.4)) == "program page"


def test_what_is_no_start_bit_is_not_read() -> None:
    line = Line([(1e-3, 0xFF), (2e-3, 0xFF)], 1e-6)
    assert list(Receiver.at(17, double_speed=True).reads(line, 0.0, 0.5)) == []


# ---------------------------------------------------------------------- as it was


@pytest.mark.parametrize(("version", "among_them"), [(1, {1, 5, 9, 11, 15}), (frames.VERSION, {1})])
def test_hello_sent_in_one_piece_at_1_Mbaud_can_be_read_as_program_page(version: int, among_them: set[int]) -> None:
    """So each of the first 25 that were sent, 5 s of asking, was a risk that depended on the moment."""
    read_so = set()
    for seq in range(1, 26):
        frame = frames.encode(Kind.HELLO, seq, version=version)
        if outcomes(BOARDS["Uno"], Line(letters([(0.0, frame)], 1e6), 1e-6))["program page"]:
            read_so.add(seq)
    assert read_so >= among_them


# ---------------------------------------------------------------------- as it is


@pytest.mark.parametrize(
    ("name", "baud"),
    [
        ("Uno", 115200),
        ("Uno", 1_000_000),
        ("old Nano", 115200),
        ("Diecimila", 115200),
        *evidence(("old Nano", 1_000_000)),
    ],
)
def test_no_boot_loader_reads_program_page_in_the_whole_opening(name: str, baud: int) -> None:
    seen = outcomes(BOARDS[name], Line(letters(opening(), baud), 1 / baud))
    assert sum(seen.values()) > 5000
    assert seen["program page"] == 0
    assert seen["left"] > 0.9 * sum(seen.values())  # all but those that hear the last few bytes only


def test_the_slowest_boot_loader_hears_nothing_at_1_Mbaud() -> None:
    line = Line(letters(opening(), 1e6), 1e-6)
    for phase in PHASES:
        assert list(Receiver.at(52, double_speed=False).reads(line, 0.0, phase)) == []


@pytest.mark.parametrize("together", [2, 3])
@pytest.mark.parametrize(("name", "baud"), [("Uno", 115200), ("Uno", 1_000_000), ("old Nano", 1_000_000)])
def test_nor_where_a_usb_chip_joins_what_was_written_apart(name: str, baud: int, together: int) -> None:
    """Up to three, and with any gaps between them."""
    rng = random.Random(together)
    gaps: list[Callable[[], float]] = [lambda: 0.0, lambda: rng.uniform(0.0, LONGEST_GAP_S)]
    for gap_s in gaps:
        line = Line(letters(opening()[:90], baud, together, gap_s), 1 / baud)
        assert outcomes(BOARDS[name], line)["program page"] == 0


def test_the_opening_is_spelled_until_it_is_given_up() -> None:
    written = opening()
    assert all(len(data) == 1 for _, data in written)
    assert min(b[0] - a[0] for a, b in pairwise(written)) >= 0.004 - 1e-9
    reader = frames.FrameReader()
    packets = reader.feed(b"".join(data for _, data in written))
    assert [packet.kind for packet in packets] == [Kind.HELLO] * 25
    assert reader.bad_frames == 0


def test_numbers_whose_frame_can_be_read_so_at_its_own_baud_rate_are_left_out() -> None:
    """In one piece, too; else they are the natural numbers."""
    numbers = list(itertools.islice(_harmless_numbers(), 2000))
    left_out = set(range(1, numbers[-1])) - set(numbers)
    assert {seq for seq in range(1, numbers[-1]) if 0x64 in frames.encode(Kind.HELLO, seq)} <= left_out
    assert len(left_out) < 0.1 * len(numbers)
    board = BOARDS["Uno"]
    actual = 16e6 / board.divisor / 8
    for seq in numbers[:25]:
        line = Line(letters([(0.0, frames.encode(Kind.HELLO, seq))], actual), 1 / actual)
        assert outcomes(board, line)["program page"] == 0
    for seq in sorted(left_out)[:5]:
        line = Line(letters([(0.0, frames.encode(Kind.HELLO, seq))], actual), 1 / actual)
        assert outcomes(board, line)["program page"] > 0
