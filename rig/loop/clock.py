"""Clocks that a loop can live in."""

from __future__ import annotations

import ctypes
import os
import sys
import time

_CLOCK_MONOTONIC = 1
_TIMER_ABSTIME = 1


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


class MonotonicClock:
    """The machine's monotonic clock, with an absolute sleep where the system has one.

    An absolute sleep does not drift and does not lengthen when the loop is preempted between reading the clock and
    going to sleep. Without one (not Linux) a relative sleep to the same instant is used, and ``absolute`` says so.
    """

    def __init__(self) -> None:
        self.absolute = sys.platform.startswith("linux")
        self._libc = ctypes.CDLL(None, use_errno=True) if self.absolute else None
        self._timespec = _Timespec()

    def now_s(self) -> float:
        """Monotonic time, s."""
        return time.monotonic()

    def sleep_until(self, t_s: float) -> None:
        """Sleep until the absolute time, s; returns early only for a signal, so that its handler runs at once."""
        if self._libc is None:
            time.sleep(max(t_s - time.monotonic(), 0.0))
            return
        seconds = int(t_s)
        self._timespec.tv_sec = seconds
        self._timespec.tv_nsec = int((t_s - seconds) * 1e9)
        error = self._libc.clock_nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, ctypes.byref(self._timespec), None)
        if error not in (0, 4):  # 4: EINTR
            raise OSError(error, f"clock_nanosleep: {os.strerror(error)}")


class VirtualClock:
    """Time that passes only while somebody sleeps."""

    absolute = True

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        """Virtual time, s."""
        return self._now_s

    def sleep_until(self, t_s: float) -> None:
        """Let time pass to ``t_s``; none if that is past."""
        self._now_s = max(self._now_s, t_s)
