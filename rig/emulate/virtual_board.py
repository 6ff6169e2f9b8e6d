"""The emulated board in virtual time: port and clock in one, so that waiting for a byte makes time pass."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Self

from rig.emulate import firmware_build
from rig.emulate.device_options import device_options
from rig.emulate.firmware_build import EmulationError
from rig.faults import Fault
from rig.model.bench import BenchParameters, DriveWiring, SensorWiring

_READ_BYTES = 512


class _View(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_double) for name in ("t_s", "pin_V", "motor_V", "y_rad", "v_rad_per_s", "pin_changed_s")),
        *((name, ctypes.c_int32) for name in ("armed", "latched", "fault", "recovering", "dropped", "hung")),
    )


class Truth(NamedTuple):
    """What is really the case on the device, besides what it says on the wire.

    t_s            virtual time, s
    pin_V          drive at the board's pin; motor_V: what the wiring makes of it
    y_rad, v_rad_per_s   of the measured shaft
    pin_changed_s  time at which the drive at the pin changed last; negative: never
    armed, latched, hung
    fault          code of the fault, 0 for none
    recovering     +1 armed above the hard limits, -1 below, 0 neither
    dropped        damaged frames that the device has dropped
    """

    t_s: float
    pin_V: float
    motor_V: float
    y_rad: float
    v_rad_per_s: float
    pin_changed_s: float
    armed: bool
    latched: bool
    fault: int
    recovering: int
    dropped: int
    hung: bool


class VirtualBoard:
    """One emulated board, powered on at virtual time 0. Any number may live side by side.

    bench            what is behind the board
    seed             of the noise, 0 to 2**32 - 1
    clock_error_ppm  of the device's clock against virtual time
    clock_start_us   reading of the device's clock at a reset, 0 to 2**32 - 1
    baud, bits_per_byte  of the wire, both ways; a real byte takes 10 to 11 bit times
    build_folder     of the firmware; None: the default one
    Raises EmulationError if the firmware cannot be built or a parameter is out of range.
    """

    absolute = True  # of the clock: it sleeps until an instant, not for a while

    def __init__(
        self,
        bench: BenchParameters,
        seed: int = 1,
        *,
        clock_error_ppm: float = 0.0,
        clock_start_us: int = 0,
        baud: int = 115200,
        bits_per_byte: int = 11,
        build_folder: Path | None = None,
    ) -> None:
        self._library = _load(build_folder)
        self._board = ctypes.c_void_p(self._library.virtual_new())
        if not self._board:
            raise MemoryError("no memory for a virtual board")
        self._finalizer = weakref.finalize(self, self._library.virtual_free, self._board)
        self._buffer = ctypes.create_string_buffer(_READ_BYTES)
        self._is_plugged = True
        for name, value in device_options(bench, seed, clock_error_ppm, clock_start_us).items():
            error = self._library.virtual_option(self._board, name.encode(), value.encode())
            if error is not None:
                raise EmulationError(f"{name} = {value}: {error.decode()}")
        error = self._library.virtual_start(self._board, round(1e9 * bits_per_byte / baud))
        if error is not None:
            raise EmulationError(error.decode())

    @classmethod
    def from_mapping(cls, emulated: Mapping[str, Any], seed: int, tachometer: Mapping[str, Any] | None = None) -> Self:
        """From the plain values of a config's sections ``emulated`` and ``tachometer``."""
        bench = BenchParameters.from_mapping(emulated, tachometer)
        return cls(bench, seed, clock_error_ppm=emulated["clock_error_ppm"])

    # ------------------------------------------------------------------ port

    def write(self, data: bytes) -> None:
        """Hand ``data`` to the wire; takes no time. Raises Fault LINK_LOST when unplugged or clogged."""
        self._check_plug()
        if self._library.virtual_write(self._board, data, len(data)) != len(data):
            raise Fault("LINK_LOST", "the virtual wire takes no more bytes")

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, at least one byte; b"" after ``timeout_s`` of virtual time without any.

        Raises Fault LINK_LOST when unplugged.
        """
        self._check_plug()
        until_ns = self._now_ns() + math.ceil(1e9 * max(timeout_s, 0.0))
        self._library.virtual_run(self._board, until_ns, True)
        n = self._library.virtual_read(self._board, self._buffer, _READ_BYTES)
        return self._buffer.raw[:n]

    def close(self) -> None:
        """Close the port. The device lives on, and its clock with it. May be called twice."""
        self._is_plugged = False

    def unplug(self) -> None:
        """Pull the cable: reading and writing fail from now on."""
        self._is_plugged = False

    def _check_plug(self) -> None:
        if not self._is_plugged:
            raise Fault("LINK_LOST", "the virtual board is unplugged")

    # ------------------------------------------------------------------ clock

    def _now_ns(self) -> int:
        now_ns: int = self._library.virtual_now_ns(self._board)
        return now_ns

    def now_s(self) -> float:
        """Virtual time, s."""
        return self._now_ns() / 1e9

    def sleep_until(self, t_s: float) -> None:
        """Let time pass to ``t_s`` (to the next nanosecond); none if that is past."""
        until_ns = math.ceil(1e9 * t_s)
        if until_ns / 1e9 < t_s:  # rounding
            until_ns += 1
        self._library.virtual_run(self._board, until_ns, False)

    # ------------------------------------------------------------------ truth, and what may happen to a device

    def truth(self) -> Truth:
        """What is really the case now."""
        view = _View()
        self._library.virtual_look(self._board, ctypes.byref(view))
        return Truth(
            view.t_s,
            view.pin_V,
            view.motor_V,
            view.y_rad,
            view.v_rad_per_s,
            view.pin_changed_s,
            bool(view.armed),
            bool(view.latched),
            view.fault,
            view.recovering,
            view.dropped,
            bool(view.hung),
        )

    def reset(self, cause: int) -> None:
        """Reset the chip: 1 power-on, 2 external, 4 brown-out, 8 watchdog (bits may be combined)."""
        self._library.virtual_reset(self._board, cause)

    def hang(self) -> None:
        """Hang the firmware, drive as it is; the hardware watchdog resets the chip 0.12 s after its last tick."""
        self._library.virtual_hang(self._board)

    def rewire(self, drive: DriveWiring = "ok", sensor: SensorWiring = "ok") -> None:
        """Change the wiring from now on. Raises ValueError for wiring that there is not."""
        error = self._library.virtual_rewire(self._board, drive.encode(), sensor.encode())
        if error is not None:
            raise ValueError(f"drive {drive!r}, sensor {sensor!r}: {error.decode()}")

    def place(self, y_rad: float, v_rad_per_s: float = 0.0) -> None:
        """Put the shaft somewhere, as a hand would."""
        self._library.virtual_place(self._board, y_rad, v_rad_per_s)

    def motion(self, v_rad_per_s: float, y_rad: float, u_V: float, dt_s: float) -> tuple[float, float]:
        """Velocity and position after ``dt_s`` of constant drive, by the motor alone; the board is untouched."""
        v, y = ctypes.c_double(v_rad_per_s), ctypes.c_double(y_rad)
        error = self._library.virtual_motion(self._board, ctypes.byref(v), ctypes.byref(y), u_V, dt_s)
        if error is not None:
            raise EmulationError(error.decode())
        return v.value, y.value

    def position_counts(self) -> int:
        """One conversion of the position channel now; takes a number from the noise."""
        counts: int = self._library.virtual_position_counts(self._board)
        return counts


@lru_cache
def _load(build_folder: Path | None) -> ctypes.CDLL:
    """The library, built once for this process, with its signatures (firmware/boards/host/virtual.c)."""
    library = ctypes.CDLL(str(firmware_build.build(build_folder).library))
    board, text, number, real = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int64, ctypes.c_double
    count, where = ctypes.c_uint32, ctypes.POINTER(ctypes.c_double)
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "virtual_new": (board, []),
        "virtual_free": (None, [board]),
        "virtual_option": (text, [board, text, text]),
        "virtual_start": (text, [board, number]),
        "virtual_write": (count, [board, text, count]),
        "virtual_read": (count, [board, ctypes.c_char_p, count]),
        "virtual_run": (None, [board, number, ctypes.c_int32]),
        "virtual_now_ns": (number, [board]),
        "virtual_look": (None, [board, ctypes.POINTER(_View)]),
        "virtual_reset": (None, [board, ctypes.c_uint8]),
        "virtual_hang": (None, [board]),
        "virtual_rewire": (text, [board, text, text]),
        "virtual_place": (None, [board, real, real]),
        "virtual_motion": (text, [board, where, where, real, real]),
        "virtual_position_counts": (ctypes.c_int32, [board]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments
    return library
