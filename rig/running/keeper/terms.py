"""What the loop's process and the keeper agree on: how long a law may take, and what they say to each other."""

from __future__ import annotations

import math
import signal
from typing import Final, NamedTuple

END: Final = b"end\n"  # to the keeper: the run needs it no more
READY: Final = b"ready\n"  # from the keeper
_ASKS: Final = 3  # its signal, counted from the first real-time signal


class LawTimes(NamedTuple):
    """What a step of the law may take, s.

    cpu_s    CPU time; infinite in virtual time, where no shaft waits for it
    lease_s  time that it is at work or asleep, until the keeper takes the link; in virtual time since a signal or Stop
    words    what bounds the CPU time, for people
    still_s  time that the loop may stand still between two steps while a drive may be on
    idle_s   the same while it waits for nothing but its tick
    """

    cpu_s: float
    lease_s: float
    words: str
    still_s: float = math.inf
    idle_s: float = math.inf


def asks() -> int:
    """Number of the signal by which the keeper asks a law to end."""
    return signal.SIGRTMIN + _ASKS


def too_long_words(name: str, what: str, cpu_s: float, times: LawTimes) -> str:
    """The law, its time, the bound and the key, for people."""
    slept = "" if cpu_s > times.cpu_s else f", and it slept; it must be back within {1e3 * times.lease_s:.4g} ms"
    return (
        f"the law {name}: {what} {1e3 * cpu_s:.4g} ms of CPU time, bound {1e3 * times.cpu_s:.4g} ms ({times.words})"
        f"{slept}"
    )
