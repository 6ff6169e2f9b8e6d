"""Clocks that a loop can live in."""

from __future__ import annotations

import ctypes
import os
import sys
import time

from rig.backends.driver import Clock

_CLOCK_MONOTONIC = 1
_TIMER_ABSTIME = 1
_EINTR = 4
STALL_S = 0.02  # by which a paced time may be late before it stands


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


class MonotonicClock:
    """The machine's monotonic clock, with an absolute sleep where the system has one.

    An absolute sleep does not drift. It is not longer if the loop is preempted between reading the clock and going to
    sleep. Without one (not on Linux) the clock uses a relative sleep to the same instant, and ``absolute`` is False.

    spin_s  last part of each sleep, spent reading the clock. A wake-up late by less than this does no harm, and the
            tick begins with warm caches. 0: none.
    """

    def __init__(self, spin_s: float = 0.0) -> None:
        self.absolute = sys.platform.startswith("linux")
        self.spin_s = spin_s
        self._libc = ctypes.CDLL(None, use_errno=True) if self.absolute else None
        self._timespec = _Timespec()

    def now_s(self) -> float:
        """Monotonic time, s."""
        return time.monotonic()

    def sleep_until(self, t_s: float) -> float:
        """Sleep until the absolute time, s. Returns the time when the sleep ended, s.

        Returns early only for a signal during the sleep, so that its handler runs at once. A signal during the spin is
        handled there: the spin is Python, and never longer than ``spin_s``.
        """
        now = time.monotonic
        interrupted = self._sleep(t_s - self.spin_s)
        now_s = now()
        if interrupted:
            return now_s
        while now_s < t_s:
            now_s = now()
        return now_s

    def _sleep(self, t_s: float) -> bool:
        """Sleep without a spin; whether a signal ended it."""
        if self._libc is None:
            time.sleep(max(t_s - time.monotonic(), 0.0))
            return False
        seconds = int(t_s)
        self._timespec.tv_sec = seconds
        self._timespec.tv_nsec = int((t_s - seconds) * 1e9)
        error: int = self._libc.clock_nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, ctypes.byref(self._timespec), None)
        if error not in (0, _EINTR):
            raise OSError(error, f"clock_nanosleep: {os.strerror(error)}")
        return error == _EINTR


class VirtualClock:
    """Time that passes only while something sleeps."""

    absolute = True

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        """Virtual time, s."""
        return self._now_s

    def sleep_until(self, t_s: float) -> float:
        """Let time pass to ``t_s``, or none if that is past. Returns the time then, s."""
        self._now_s = max(self._now_s, t_s)
        return self._now_s


class PacedClock:
    """A virtual time that follows this machine's clock, for people who watch. It never runs ahead of it.

    Where the machine stands, so does this time: if it fell behind by more than STALL_S, that was a stall, and nothing
    catches up on it. A time is told, or slept until, only once it has come.

    clock   virtual time
    pace    seconds of it in a second of the machine's
    wall    the machine's clock

    stalls  so far; longest_stall_s: the longest of them, s of the machine's clock
    """

    absolute = True

    def __init__(self, clock: Clock, pace: float, wall: Clock | None = None) -> None:
        self.pace = pace
        self.stalls, self.longest_stall_s = 0, 0.0
        self._clock, self._wall = clock, MonotonicClock() if wall is None else wall
        self._zero_s, self._wall_zero_s = clock.now_s(), self._wall.now_s()

    def now_s(self) -> float:
        """Virtual time, s."""
        now_s = self._clock.now_s()
        self._has_come(now_s)
        return now_s

    def sleep_until(self, t_s: float) -> float:
        """Sleep until ``t_s``, and let virtual time pass to it; the time then, s. Returns early only for a signal."""
        now_s = self._clock.now_s()
        return self._clock.sleep_until(t_s) if self._has_come(max(t_s, now_s)) else now_s

    def _has_come(self, t_s: float) -> bool:
        """Wait for the instant of the machine's clock that belongs to ``t_s``. False: a signal came first."""
        due_s = self._wall_zero_s + (t_s - self._zero_s) / self.pace
        now_s = self._wall.now_s()
        if now_s < due_s:
            now_s = self._wall.sleep_until(due_s)
        late_s = now_s - due_s
        if late_s > STALL_S:
            self.stalls += 1
            self.longest_stall_s = max(self.longest_stall_s, late_s)
            self._wall_zero_s += late_s
        return late_s >= 0.0
