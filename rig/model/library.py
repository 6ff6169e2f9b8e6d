"""The C library of the motor's physics (firmware/motor), and how arrays and numbers get into it.

An installed rig has it beside this file. In a clone it is compiled where there is none of just its sources: a second.
Each call releases the interpreter's lock, so that two fits run on two cores.

``double`` is the only number of the library; an array goes in as its address. So every array is checked here first.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import POINTER, Structure, c_bool, c_double, c_int64, c_void_p
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.core.arrays import Array, Rows
from rig.core.errors import LibraryError
from rig.core.package import FOLDER
from rig.model.library_build import NAME, CompileError, compiled, sources_in

CLONE = FOLDER.parent / "firmware" / "motor"  # the sources, in a clone


class PlainState(Structure):
    """``plain_state``."""

    _fields_ = (("v", c_double), ("y", c_double), ("z", c_double))


class PlainDrive(Structure):
    """``plain_drive``."""

    _fields_ = (("edge_s", c_void_p), ("u_V", c_void_p), ("edges", c_int64), ("delay_s", c_double))


class RelayPlan(Structure):
    """``relay_plan``."""

    _fields_ = (
        *((name, c_void_p) for name in ("t_s", "t_u_s", "reading_rad", "drive_V")),
        *((name, c_double) for name in ("h1_V", "h2_V", "lsb_rad")),
        ("rows", c_int64),
    )


class TestPlan(Structure):
    """``test_plan``."""

    _fields_ = (
        ("first", c_void_p), ("second", c_void_p), ("period_s", c_double), ("delay_s", c_double), ("strokes", c_int64),
        ("most_strokes", c_int64),
    )  # fmt: skip


class RealRecord(Structure):
    """``real_record``."""

    _fields_ = (
        *((name, c_void_p) for name in ("edge_s", "u_V", "t_s", "first", "starts")),
        *((name, c_int64) for name in ("edges", "rows", "pieces")),
    )


class RealWindow(Structure):
    """``real_window``."""

    _fields_ = (("record", RealRecord), ("frame", c_double * 4))


class RealColumns(Structure):
    """``real_columns``."""

    _fields_ = (
        *((name, c_void_p) for name in ("which", "orders", "work")),
        *((name, c_int64) for name in ("columns", "waves")),
    )


class BorderedRows(Structure):
    """``bordered_rows``."""

    _fields_ = (
        *((name, c_void_p) for name in ("residual", "by_number", "by_start", "first")),
        *((name, c_int64) for name in ("rows", "numbers", "pieces", "number_stride", "start_stride")),
    )


class NoiseRows(Structure):
    """``noise_rows``."""

    _fields_ = (
        ("t_s", c_void_p), ("starts", c_void_p), ("rows", c_int64), ("windows", c_int64), ("memory_s", c_double),
    )  # fmt: skip


class CycleData(Structure):
    """``cycle_data``."""

    _fields_ = (
        ("gains", c_double * 2), ("edges", c_double * 4), ("t_s", c_void_p), ("samples", c_int64),
        ("first_half", c_int64),
    )  # fmt: skip


_P, _D, _I = c_void_p, c_double, c_int64
_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    # plain_motor.h
    "plain_advance": (None, [_P, _P, _D, _D]),
    "plain_glided": (PlainState, [PlainState, _D, _D, _D]),
    # real_motor.h
    "real_start": (None, [_P, _P, _D]),
    "real_put": (None, [_P, _P, _D, _D]),
    "real_advance": (None, [_P, _P, _D, _P, _P]),
    "real_force": (_D, [_P, _D]),
    "real_level": (_D, [_P, _D, _D]),
    "real_reading": (_D, [_P, _D]),
    # real_readings.h
    # windows.h
    "windows_readings": (None, [_P, _P, _I, _P, POINTER(RealColumns), _P, _P]),
    "windows_plain": (None, [_P, _P, _I, _P, POINTER(RealColumns), _P, _P]),
    "windows_filter": (None, [_P, _P, _P, _I, _I, _I, _P]),
    "bordered_sums": (None, [POINTER(BorderedRows), _P, _P]),
    "normal_step": (_D, [_P, _P, _P, _I, _P, _P]),
    "bordered_reduce": (None, [_P, _P, _I, _I, _D, _P, _P, _P]),
    # records.h
    "plain_states": (None, [_P, _P, POINTER(PlainDrive), _P, _I, _P]),
    "plain_positions": (None, [_P, _P, POINTER(PlainDrive), _P, _I, _P]),
    "plain_jacobian": (None, [_P, _P, POINTER(PlainDrive), _P, _I, _P, _P]),
    "relay_test": (None, [_P, POINTER(RelayPlan), _P, _P]),
    "test_drive": (_I, [_P, POINTER(TestPlan), _P, _I, _P, _P, _P]),
    "test_jacobian": (None, [_P, POINTER(TestPlan), _I, _P, _P, _P, _P]),
    "test_known": (None, [_P, _P, _P]),
    "test_variances": (c_bool, [_P, _P]),
    "test_rows": (_D, [_P, _I, _D, _P, _P, _I, _P]),
    "test_bounds": (None, [_P, _I, _D, _P]),
    # coloured_noise.h
    "noise_innovations": (_D, [POINTER(NoiseRows), _D, _P, _I, _P, _P]),
    "noise_deviances": (None, [POINTER(NoiseRows), _P, _I, _P, _P, _P]),
    # steady_cycle.h
    "cycle_conditions": (None, [_P, _P, _P, _P, _P]),
    "cycle_curve": (None, [_P, POINTER(CycleData), _P, _P]),
}


def library_file() -> Path:
    """The library, in a clone compiled where there is none of its sources. Raises LibraryError."""
    if not CLONE.is_dir():
        return Path(__file__).parent / NAME
    try:
        return compiled(sources_in(CLONE), FOLDER.parent / "build" / "motor")
    except CompileError as error:
        raise LibraryError(str(error)) from error


def _loaded() -> ctypes.CDLL:
    file = library_file()
    try:
        loaded = ctypes.CDLL(str(file))
    except OSError as error:
        raise LibraryError(f"the motor's physics cannot be loaded ({error}): install rig again") from error
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


LIBRARY = _loaded()
_START = c_double * 0


def numbers(*values: float) -> ctypes.Array[c_double]:
    """Numbers in a row, as the library takes a struct of doubles."""
    return (c_double * len(values))(*values)


def given(values: Array | Sequence[float]) -> Array:
    """An array that the library reads: contiguous, of doubles."""
    return np.ascontiguousarray(values, dtype=np.float64)


def address(values: NDArray[Any]) -> int:
    """Where ``values``, of any unit, are; they have to live as long as the call."""
    try:  # a quarter of the time that the other way takes
        return ctypes.addressof(_START.from_buffer(values.data))
    except (TypeError, ValueError):  # it is read only, or has gaps
        return int(values.ctypes.data)


def require_size(values: Array | Rows, count: int, what: str) -> None:
    """Raise ValueError on an array of another size, which the library would read beyond."""
    if values.size != count:
        raise ValueError(f"{what}: {values.size} numbers, not {count}")
