"""How soon the drive must be at 0, as a sum of times that the config and the device give."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple


class Times(NamedTuple):
    """What bounds are made of, s; each follows from the config, the device and the guard's own constants.

    tick        of the device
    period      of the loop
    timeout     longest wait for a reply
    watchdog    command watchdog of the device
    frame       on the wire: what says stop
    exchange    on the wire: a reading, question and answer, and the drive that follows
    hardware    hardware watchdog of the chip, with what its own oscillator may be off
    cycle       of the limit cycle
    check       25 ticks, between two looks at the recorder
    ramp        of the breakaway check, to its largest drive: two strokes and two pauses for each pair of them
    window      of the guard's velocity, and half as much for its lag
    fling       that a quarter of the supply takes the shaft from the largest speed the other way to 1.2 times it
    reversal    that relay and guard whose drive is reversed take to have the shaft at 1.2 times the largest speed, at a
                hard limit, or standing for 0.6 of a cycle: from the worst instant of the cycle, in the bench's model
    stuck       for which a drive well above friction may leave the reading where it is: the guard's 0.3 s
    unmoved     until the tracking law has asked a shaft that stands for 1.4 times static friction for twice ``stuck``,
                the worst instant of the reference; nan where nothing is tracked
    crawl       that the shaft takes for 66 counts of its encoder, from the slowest instant of the limit cycle, or of
                the tracking: in the bench's model; nan where there is no encoder
    block       that passes until the rows of a relay in the device are sent together; nan where the host's relay drives
    """

    tick: float
    period: float
    timeout: float
    watchdog: float
    frame: float
    exchange: float
    hardware: float
    cycle: float
    check: float
    ramp: float
    window: float
    fling: float
    reversal: float
    stuck: float
    unmoved: float = math.nan
    block: float = math.nan
    crawl: float = math.nan


_WORDS = {"timeout": "time-out", "hardware": "hardware watchdog"}


@dataclass(frozen=True)
class Bound:
    """A sum of multiples of ``Times``, and why that many.

    terms  (name, how many)
    """

    why: str
    terms: tuple[tuple[str, float], ...]

    def seconds(self, times: Times) -> float:
        """The sum, s."""
        return sum(count * float(getattr(times, name)) for name, count in self.terms)

    def formula(self) -> str:
        """The sum in words."""
        return "0" if not self.terms else " + ".join(_term(name, count) for name, count in self.terms)


def bound(why: str, **terms: float) -> Bound:
    """A bound of so many of each of ``Times``."""
    return Bound(why, tuple(terms.items()))


def _term(name: str, count: float) -> str:
    word = _WORDS.get(name, name)
    if count == 1:
        return word
    number = "half a" if count == 0.5 else f"{count:g}"
    return f"{number} {word}{'s' if count > 1 else ''}"
