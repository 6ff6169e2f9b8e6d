"""Sets the loop's process up for real time, as far as the machine allows; notes what it refuses."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

from rig.control.loop.kernel_workers import raised_workers

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK = 29
_SYSTEMS = {"win32": "Windows", "darwin": "macOS"}
_LIMITS_CONF = (
    "in /etc/security/limits.conf, join that group: `sudo groupadd -f realtime; sudo adduser $USER realtime`, "
    "log in again"
)


@dataclass(frozen=True)
class RealTimeSettings:
    """The measures that the config asks for.

    priority       priority of SCHED_FIFO, 1 to 99; 0: the ordinary scheduler
    cpu            the one core to stay on; None: any
    lock_memory    keep all pages of the process in memory, so that none has to wait for a disk
    raise_workers  give the kernel's worker threads that are bound to no core SCHED_FIFO, one below the loop's priority.
                   They hand what a serial port receives to its reader, and on busy cores they have to wait
    """

    priority: int = 60
    cpu: int | None = None
    lock_memory: bool = True
    raise_workers: bool = False


@dataclass
class RealTime:
    """One line for each measure that is in force, and one for each that the machine refused."""

    granted: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)


AS_USUAL = RealTimeSettings()


@contextmanager
def real_time(settings: RealTimeSettings = AS_USUAL) -> Iterator[RealTime]:
    """Set this process up for real time during the block, as far as the machine allows; then restore it.

    Processes that start within the block are ordinary, but stay on the same core.
    """
    done = RealTime()
    if not sys.platform.startswith("linux"):
        done.refused.append(
            f"{_SYSTEMS.get(sys.platform, sys.platform)} has not been tried in real time: no priority, no locked "
            "memory, no absolute sleep, so ticks may come late by any time; drive a motor from Linux"
        )
        yield done
        return
    libc = ctypes.CDLL(None, use_errno=True)
    scheduler, parameter, cores = os.sched_getscheduler(0), os.sched_getparam(0), os.sched_getaffinity(0)
    until_then = ExitStack()
    try:
        # by default the ordinary scheduler lets a sleep lengthen by 50 us
        libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0)
        if settings.cpu is not None:
            _stay_on(settings.cpu, done)
        if settings.lock_memory:
            _lock_memory(libc, done)
        if settings.priority > 0:
            _go_first(settings.priority, done)
        if settings.raise_workers:
            _raise_workers(max(settings.priority - 1, 1), until_then, done)
        yield done
    finally:
        until_then.close()
        # an ordinary user cannot clear this flag once it is set; an ordinary process does not notice it
        os.sched_setscheduler(0, scheduler | (os.sched_getscheduler(0) & os.SCHED_RESET_ON_FORK), parameter)
        libc.munlockall()
        os.sched_setaffinity(0, cores)
        libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(0), 0, 0, 0)


def _stay_on(cpu: int, done: RealTime) -> None:
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError as error:
        cores = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
        done.refused.append(f"core {cpu} refused ({error.strerror}): set loop.cpu to one of {cores}, or leave it out")
    else:
        done.granted.append(f"on core {cpu}")


def _lock_memory(libc: ctypes.CDLL, done: RealTime) -> None:
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0:
        done.granted.append("memory locked")
    else:
        why = os.strerror(ctypes.get_errno())
        done.refused.append(f"locked memory refused ({why}): put `@realtime - memlock unlimited` {_LIMITS_CONF}")


def _go_first(priority: int, done: RealTime) -> None:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as error:
        done.refused.append(f"SCHED_FIFO refused ({error.strerror}): put `@realtime - rtprio 90` {_LIMITS_CONF}")
    else:
        done.granted.append(f"SCHED_FIFO at priority {priority}")


def _raise_workers(priority: int, until_then: ExitStack, done: RealTime) -> None:
    """Raise the workers until ``until_then`` closes, or this process ends."""
    why = os.strerror(errno.EPERM)
    if os.geteuid() == 0:
        try:
            count, why = until_then.enter_context(raised_workers(priority))
        except OSError as error:
            why = error.strerror or str(error)
    if why:
        done.refused.append(f"raised kernel workers refused ({why}): only root may have them")
    else:
        done.granted.append(f"{count} kernel workers at priority {priority}")
