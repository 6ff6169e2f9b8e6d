"""How long a law of a user's own may take, and what the loop's process and the keeper say to each other about it."""

from __future__ import annotations

import math
import signal
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from rig.config import Experiment  # the keeper starts without it

END: Final = b"end\n"  # to the keeper: the run needs it no more
READY: Final = b"ready\n"  # from the keeper
_ASKS: Final = 3  # its signal, counted from the first real-time signal
_VIRTUAL_LEASE_S: Final = 2.0
_LEAST_CPU_S: Final = 0.002  # page faults and interrupts have cost a good law up to 0.7 ms in one step
_STILL_S: Final = 1.0  # the loop's, besides its waits for replies: a busy machine
_MOST_WAITS: Final = 12  # for a reply, one after the other: four requests that arm a device, three times each


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


def law_times(e: Experiment, *, virtual: bool) -> LawTimes:
    """The times of the config. The lease is as long as a device's watchdog waits, or twice the CPU time."""
    bound_s, words = e.loop.law_cpu_s, "loop.law_cpu_s"
    if bound_s is None:
        bound_s = max(0.5 * e.period_s, _LEAST_CPU_S)
        words += f", by default half a period, {1e3 * _LEAST_CPU_S:g} ms at least"
    lease_s = max(e.daq.watchdog_s, 2.0 * bound_s)
    still_s = lease_s + _STILL_S + _MOST_WAITS * e.daq.timeout_s
    if virtual:
        return LawTimes(math.inf, _VIRTUAL_LEASE_S, words, still_s, still_s)  # at a slow pace a tick may last seconds
    return LawTimes(bound_s, lease_s, words, still_s, lease_s + e.period_s)  # a period is how long a good loop sleeps


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
