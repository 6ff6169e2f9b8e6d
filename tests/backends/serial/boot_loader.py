"""An Arduino's boot loader at the other end of a serial line, bit by bit: what it reads, and what it then does.

The receiver is the ATmega328P's (data sheet, sections 20.8.1 and 20.8.2). The boot loaders take a byte with a framing
error like any other. ``optiboot`` is what an Uno comes with; ``atmegaboot`` what older boards have.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Generator, Iterable, Iterator
from itertools import pairwise
from typing import Literal, NamedTuple

PROGRAM_PAGE = 0x64
END_OF_COMMAND = 0x20
LEAVE = 0x51
ERRORS = 5  # after which the older one leaves

Outcome = Literal["left", "listens", "program page"]
Program = Generator[None, int, Outcome]


class Line:
    """Levels of a serial line, which idles high.

    letters  when the start bit of each byte begins, s, and the byte; in order, none before the end of the last
    bit_s    duration of a bit
    """

    def __init__(self, letters: Iterable[tuple[float, int]], bit_s: float) -> None:
        self.edges: list[float] = []  # falling, rising, falling, ...
        for start_s, byte in letters:
            levels = [1, 0, *(byte >> i & 1 for i in range(8)), 1]
            self.edges += [start_s + i * bit_s for i, (a, b) in enumerate(pairwise(levels)) if a != b]

    def is_high(self, t_s: float) -> bool:
        return bisect_right(self.edges, t_s) % 2 == 0

    def falls_after(self, t_s: float) -> int | None:
        """Number of the first falling edge at or after a time; None: the line idles."""
        i = bisect_left(self.edges, t_s)
        i += i % 2
        return i if i < len(self.edges) else None

    @property
    def falls(self) -> list[float]:
        """Times at which it falls, s."""
        return self.edges[::2]


class Receiver(NamedTuple):
    """What reads the line: the chip takes a sample each ``sample_s``, of which the majority of three tell a bit."""

    sample_s: float
    per_bit: int = 8
    votes: tuple[int, int, int] = (4, 5, 6)  # of a bit's samples, counted from 1

    @classmethod
    def at(cls, divisor: int, *, double_speed: bool, clock_error: float = 0.0) -> Receiver:
        """For UBRR0 = divisor - 1 of a 16 MHz clock that is wrong by a share."""
        sample_s = divisor / (16e6 * (1.0 + clock_error))
        return cls(sample_s) if double_speed else cls(sample_s, 16, (8, 9, 10))

    def reads(self, line: Line, from_s: float, phase: float) -> Iterator[int]:
        """Bytes as they are read by who listens from some time on; ``phase`` of the sampling, 0 to 1 sample."""
        first = math.ceil(from_s / self.sample_s - phase)  # number of a sample

        def bit(start: int) -> bool:
            return sum(line.is_high((start + vote - 1 + phase) * self.sample_s) for vote in self.votes) >= 2

        while (fall := line.falls_after((first + phase) * self.sample_s)) is not None:
            start = math.ceil(line.edges[fall] / self.sample_s - phase)
            if line.is_high((start + phase) * self.sample_s) or (
                start > first and not line.is_high((start - 1 + phase) * self.sample_s)
            ):
                first = start + 1  # between two samples
            elif bit(start):
                first = start + self.votes[-1]  # a spike
            else:
                yield sum(bit(start + (1 + i) * self.per_bit) << i for i in range(8))
                first = start + 9 * self.per_bit + self.votes[-1] - 1


def optiboot() -> Program:
    """Leaves at the first command that is not ended as it should be: its watchdog bites 16 ms later."""
    arguments = {0x41: 1, 0x42: 20, 0x45: 5, 0x55: 2, 0x56: 4, 0x74: 3}
    while True:
        command = yield
        if command == PROGRAM_PAGE:
            return "program page"
        for _ in range(arguments.get(command, 0)):
            yield
        if (yield) != END_OF_COMMAND or command == LEAVE:
            return "left"


def atmegaboot() -> Program:
    """Leaves after five errors."""
    arguments = {0x31: 0, 0x40: 1, 0x41: 1, 0x42: 20, 0x45: 5, 0x50: 0, 0x51: 0, 0x52: 0, 0x55: 2, 0x56: 4, 0x30: 0,
                 0x74: 3, 0x75: 0, 0x76: 0}  # fmt: skip
    errors = 0
    while errors < ERRORS:
        command = yield
        if command == PROGRAM_PAGE:
            return "program page"
        for _ in range(arguments.get(command, 0)):
            yield
        errors += command not in arguments or (yield) != END_OF_COMMAND
    return "left"


def outcome(program: Program, read: Iterable[int]) -> Outcome:
    """What it does on these bytes; without its time-out: it would only leave sooner."""
    next(program)
    try:
        for byte in read:
            program.send(byte)
    except StopIteration as end:
        done: Outcome = end.value
        return done
    return "listens"
