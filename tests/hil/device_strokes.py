"""The stroke test of the firmware, called directly in the shared library."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

from rig.backends.serial.emulated import firmware_build
from rig.backends.serial.frames import MAX_STROKES


class _Stroke(ctypes.Structure):
    _fields_ = (("turn", ctypes.c_int32), ("drive", ctypes.c_int16))


class _Setup(ctypes.Structure):
    _fields_ = (
        ("plan", _Stroke * MAX_STROKES),
        ("centre", ctypes.c_int32),
        ("stroke_ticks", ctypes.c_uint16),
        ("still_ticks", ctypes.c_uint16),
        ("still_counts", ctypes.c_uint16),
        ("n", ctypes.c_uint8),
        ("polarity", ctypes.c_int8),
    )


class _Strokes(ctypes.Structure):
    _fields_ = (
        ("setup", _Setup),
        ("low", ctypes.c_int32),
        ("high", ctypes.c_int32),
        ("driven", ctypes.c_uint16),
        ("still", ctypes.c_uint16),
        ("at", ctypes.c_uint8),
        ("failed", ctypes.c_uint8),
        ("is_first", ctypes.c_bool),
        ("is_fresh", ctypes.c_bool),
    )


class DeviceStrokes:
    """One stroke test; strokes of (drive in units, turning point in counts), times in ticks."""

    def __init__(
        self,
        strokes: Sequence[tuple[int, int]],
        centre: int,
        times: tuple[int, int],
        still_counts: int,
        polarity: int,
    ) -> None:
        self._library = ctypes.CDLL(str(firmware_build.build()))
        self._library.strokes_are_valid.restype = ctypes.c_bool
        self._library.strokes_step.restype = ctypes.c_int16
        self._library.strokes_step.argtypes = [ctypes.POINTER(_Strokes), ctypes.c_int32]
        plan = (_Stroke * MAX_STROKES)(*(_Stroke(turn, drive) for drive, turn in strokes))
        self._strokes = _Strokes(_Setup(plan, centre, *times, still_counts, len(strokes), polarity))
        assert self._library.strokes_are_valid(ctypes.byref(self._strokes.setup))
        self._library.strokes_begin(ctypes.byref(self._strokes))

    def step(self, counts: int) -> int:
        drive: int = self._library.strokes_step(ctypes.byref(self._strokes), counts)
        return drive
