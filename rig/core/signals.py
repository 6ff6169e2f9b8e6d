"""The data that all rooms share: a sample of the bench, and the limits that it is armed with.

Any room may import this module; it imports none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

Order = Literal["sample_first", "write_first"]

# Bits of the ``flags`` column and of ``Sample.flags``.
FLAG_GUARD_CLIPPED = 1  # the guard passed less drive than the law asked for
FLAG_GUARD_BRAKED = 2  # the guard drove inward by itself
FLAG_SKIPPED = 4  # at least one tick was skipped just before this row
FLAG_SATURATED = 8  # the device applied less than was commanded: the drive's largest value


class Sample(NamedTuple):
    """One reading of the bench, as a driver returns it.

    t_s        time at which the position was sampled, seconds since the run's start (host seconds)
    y_rad      position of the measured shaft, zero at the centre of travel
    y_counts   the raw reading behind it
    v_rad_per_s  velocity of the measured shaft from a tachometer; nan where there is none
    t_u_s      time at which the *previous* ``write`` took effect at the drive; nan before the first
    u_V        drive that acts since t_u_s, after saturation and quantisation, as the device reports it
    seq        sequence number of the exchange
    """

    t_s: float
    y_rad: float
    y_counts: int
    v_rad_per_s: float = math.nan
    t_u_s: float = math.nan
    u_V: float = 0.0
    seq: int = 0


def plain(text: str) -> str:
    """``text``, safe for a terminal: characters that do not print (escape codes, line breaks) become escapes."""
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def percent(share: float) -> str:
    """A share in whole percent, as the pages write it: ``10 %``."""
    return f"{100.0 * share:.0f} %"


LEAST_SHOWN_S = 0.005  # least lower end of a further delay: play and an electrical lag look like one of some ms


@dataclass(frozen=True)
class BenchDelay:
    """How late a bench acts, as its breakaway check shows it.

    reported_s   from a sample to the effect of the drive that was decided on it, as the device reports it; 0.0 if it
                 does not
    further_s    (low, most likely, high): from there to the motion of the reading, which no device reports; None: the
                 strokes do not show it
    """

    reported_s: float = 0.0
    further_s: tuple[float, float, float] | None = None

    @property
    def shown_s(self) -> tuple[float, float, float]:
        """The further delay if there is one for certain; else three times 0 s."""
        return (0.0, 0.0, 0.0) if self.further_s is None or self.further_s[0] < LEAST_SHOWN_S else self.further_s

    @property
    def range_s(self) -> tuple[float, float]:
        """From a sample to the motion that its drive makes: at least and at most, by what is shown."""
        low_s, _, high_s = self.shown_s
        return self.reported_s + low_s, self.reported_s + high_s

    @property
    def is_shown(self) -> bool:
        """Whether the bench acts later than the device reports, for certain."""
        return self.shown_s[2] > 0.0

    def whole_periods(self, latency_s: float, period_s: float) -> int:
        """Ticks by which the drive that acts ``latency_s`` after a sample was decided before that sample."""
        return max(round((self.reported_s - latency_s) / period_s), 0)


@dataclass(frozen=True)
class Limits:
    """What a device is armed with, and what the guard enforces (docs/safety.md).

    soft_rad, hard_rad   (low, high), rad; hard outside soft
    max_u_V              largest drive, V
    watchdog_s           host silence after which the device goes to 0 V and latches, s
    """

    soft_rad: tuple[float, float]
    hard_rad: tuple[float, float]
    max_u_V: float
    watchdog_s: float
