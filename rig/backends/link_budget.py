"""The time that one tick needs on a link, as a sum for people, and the part of the period that it may take."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from rig.config.problems import Problem, wrong
from rig.core.signals import percent

LINK_SHARE = 0.8  # of the period: for the exchange by the sum, or for the whole tick as measured
BAUD_RATES = (9600, 19200, 38400, 57600, 115200, 230400, 250000, 460800, 500000, 921600, 1_000_000, 2_000_000)

_SLACK = 1e-9  # relative: 0.1 s is ten periods of 0.01 s, whatever the binary fractions say
_LONGEST_PERIOD_S = 0.1  # that the config takes


class LinkBudget(NamedTuple):
    """The time of one tick as a sum.

    terms    words and seconds; none where the link is unknown, or there is none
    wire     how the first term is computed, in words
    """

    terms: tuple[tuple[str, float], ...] = ()
    wire: str = ""

    @property
    def total_s(self) -> float:
        """The whole exchange of a tick, s."""
        return sum(s for _, s in self.terms)

    @property
    def written(self) -> str:
        """The sum, for people."""
        (_, wire_s), *others = self.terms
        if not others:
            return f"{self.wire} = {wire_s * 1e3:.2f} ms"
        rest = " ".join(f"+ {_milliseconds(s)} ms ({words})" for words, s in others)
        return f"{self.wire} = {wire_s * 1e3:.2f} ms, {rest} = {self.total_s * 1e3:.2f} ms"

    def fits(self, period_s: float) -> bool:
        """Whether the sum leaves the host its part of the period."""
        return self.total_s <= LINK_SHARE * period_s * (1 + _SLACK)

    def beside(self, period_s: float) -> str:
        """The sum beside its largest allowed value, for people."""
        return (
            f"{self.written}; {percent(LINK_SHARE)} of the period is {LINK_SHARE * period_s * 1e3:.2f} ms "
            "(the host needs the rest to wake, decide and record)"
        )

    def too_slow(self, key: str, period_s: float, ways_out: Iterable[str]) -> Problem:
        """The problem of a link that does not fit, at ``key``. A longer period is added to ``ways_out``."""
        longer_s = _rounded_up(self.total_s / LINK_SHARE)
        longer = [f"period_s of {longer_s:g} and more"] if longer_s <= _LONGEST_PERIOD_S else []
        return wrong(key, f"too slow for the period: {self.beside(period_s)}", ", or ".join([*ways_out, *longer]))


def wire_term(frames: Mapping[str, int], bits: int, baud: int) -> tuple[str, float]:
    """Frames on a serial line, bytes by name, as a term."""
    return "wire", sum(frames.values()) * bits / baud


def wire_words(frames: Mapping[str, int], bits: int, baud: int) -> str:
    """How that term is computed."""
    return f"{added(frames)} = {sum(frames.values())} bytes x {bits} bits / {baud} baud"


def added(frames: Mapping[str, int]) -> str:
    """Frames, bytes by name, as a sum."""
    return " + ".join(f"{name} {count}" for name, count in frames.items())


def _milliseconds(s: float) -> str:
    """With as many digits as it has, two at most."""
    return f"{round(s * 1e3, 2):g}"


def _rounded_up(value: float) -> float:
    """Two digits, rounded up: a value from a hint must pass."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit * (1 - _SLACK)) * unit:.2g}")
