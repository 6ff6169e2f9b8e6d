"""A device in virtual time: port and clock in one, so that waiting for a byte makes time pass."""

from __future__ import annotations

import ctypes
import math
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, get_type_hints

from typing_extensions import override

from rig.backends.emulated.errors import EmulationError
from rig.backends.emulated.plug import Plug, Until
from rig.core.faults import Fault
from rig.model.bench import DriveWiring, SensorWiring

_READ_BYTES = 512


@dataclass(frozen=True)
class Truth:
    """What is really the case on a device, besides what it says on the wire; each device adds what it knows.

    t_s            virtual time, s
    pin_V          drive at the board's pin, of a chip the mean that the bridge makes of its pins; motor_V: what the
                   wiring makes of it
    y_rad, v_rad_per_s   of the measured shaft
    pin_changed_s  time at which the drive at the pin changed last; negative: never
    """

    t_s: float
    pin_V: float
    motor_V: float
    y_rad: float
    v_rad_per_s: float
    pin_changed_s: float


Seen = TypeVar("Seen", bound=Truth)  # of floats, ints and bools


class PortAndClock(Plug):
    """A device whose time passes while its port is read or its clock is asked to wait; it counts nanoseconds.

    device  what is unplugged, in the fault's words
    """

    absolute = True  # of the clock: it sleeps until an instant, not for a while
    step_s = 0.001  # in real time what it sends may come so much late

    def __init__(self, device: str) -> None:
        super().__init__(device)
        self.reads = Until.FRAME  # what ends a ``read``

    def write(self, data: bytes) -> None:
        """Hand ``data`` to the wire; takes no time. Raises Fault LINK_LOST when unplugged."""
        raise NotImplementedError

    def read(self, timeout_s: float) -> bytes:
        """What has arrived, up to the end of a frame; all there is after ``timeout_s`` of virtual time without one.

        Raises Fault LINK_LOST when unplugged.
        """
        raise NotImplementedError

    def now_s(self) -> float:
        """Virtual time, s."""
        return self._now_ns() / 1e9

    def sleep_until(self, t_s: float) -> float:
        """Let time pass to ``t_s`` (to the next nanosecond), none if that is past; the time then, s."""
        until_ns = math.ceil(1e9 * t_s)
        if until_ns / 1e9 < t_s:  # rounding
            until_ns += 1
        self._run(until_ns, Until.TIME)
        return self.now_s()

    def truth(self) -> Truth:
        """What is really the case now."""
        raise NotImplementedError

    def reset(self, cause: int) -> None:
        """Reset the chip: 1 power-on, 2 external, 4 brown-out, 8 watchdog (bits may be combined)."""
        raise NotImplementedError

    def _now_ns(self) -> int:
        raise NotImplementedError

    def _run(self, until_ns: int, until: Until) -> None:
        """Let time pass to ``until_ns``, or to what arrives at the host before."""
        raise NotImplementedError


class VirtualDevice(PortAndClock, Generic[Seen]):
    """Wire, clock and bench of a device in a shared library whose functions are named virtual_... .

    truth    what it tells of itself: the names of ``virtual_view`` in C, in their order
    library  as ``load`` gives it
    options  of the device, by name
    byte_ns  time in which the host sends a byte
    Raises EmulationError if an option is wrong, MemoryError if there is no room for the device.
    """

    def __init__(self, truth: type[Seen], library: ctypes.CDLL, options: Mapping[str, str], byte_ns: int) -> None:
        super().__init__("virtual board")
        self._truth, self._kinds = truth, get_type_hints(truth)
        fields = [(name, ctypes.c_double if kind is float else ctypes.c_int32) for name, kind in self._kinds.items()]
        self._view: Any = type("View", (ctypes.Structure,), {"_fields_": fields})()
        self._library = library
        self._board = ctypes.c_void_p(library.virtual_new())
        if not self._board:
            raise MemoryError("no memory for a virtual board")
        self._finalizer = weakref.finalize(self, library.virtual_free, self._board)
        self._buffer = ctypes.create_string_buffer(_READ_BYTES)
        for name, value in options.items():
            error = library.virtual_option(self._board, name.encode(), value.encode())
            if error is not None:
                raise EmulationError(f"{name} = {value}: {error.decode()}")
        error = library.virtual_start(self._board, byte_ns)
        if error is not None:
            raise EmulationError(error.decode())

    # ------------------------------------------------------------------ port

    @override
    def write(self, data: bytes) -> None:
        self._check_plug()
        if self._library.virtual_write(self._board, data, len(data)) != len(data):
            raise Fault("LINK_LOST", "the virtual wire takes no more bytes")

    @override
    def read(self, timeout_s: float) -> bytes:
        self._check_plug()
        until_ns = self._now_ns() + math.ceil(1e9 * max(timeout_s, 0.0))
        self._run(until_ns, self.reads)
        n = self._library.virtual_read(self._board, self._buffer, _READ_BYTES)
        return self._buffer.raw[:n]

    # ------------------------------------------------------------------ clock

    @override
    def _now_ns(self) -> int:
        now_ns: int = self._library.virtual_now_ns(self._board)
        return now_ns

    @override
    def _run(self, until_ns: int, until: Until) -> None:
        self._library.virtual_run(self._board, until_ns, until)

    # ------------------------------------------------------------------ what may happen to a bench

    def rewire(self, drive: DriveWiring = "ok", sensor: SensorWiring = "ok") -> None:
        """Change the wiring from now on. Raises ValueError for wiring that there is not."""
        error = self._library.virtual_rewire(self._board, drive.encode(), sensor.encode())
        if error is not None:
            raise ValueError(f"drive {drive!r}, sensor {sensor!r}: {error.decode()}")

    def place(self, y_rad: float, v_rad_per_s: float = 0.0) -> None:
        """Put the shaft somewhere, as a hand would."""
        self._library.virtual_place(self._board, y_rad, v_rad_per_s)

    # ------------------------------------------------------------------ what is true of it

    @override
    def truth(self) -> Seen:
        view = self._look()
        return self._truth(**{name: kind(getattr(view, name)) for name, kind in self._kinds.items()})

    def _look(self) -> Any:
        self._library.virtual_look(self._board, ctypes.byref(self._view))
        return self._view


def load(path: str, more: Mapping[str, tuple[Any, list[Any]]]) -> ctypes.CDLL:
    """The library, with the signatures of what every device has.

    more  further functions: name, type of the result, types of the arguments after the device itself
    """
    library = ctypes.CDLL(path)
    text, number, real, count = ctypes.c_char_p, ctypes.c_int64, ctypes.c_double, ctypes.c_uint32
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "virtual_free": (None, []),
        "virtual_option": (text, [text, text]),
        "virtual_start": (text, [number]),
        "virtual_write": (count, [text, count]),
        "virtual_read": (count, [ctypes.c_char_p, count]),
        "virtual_run": (None, [number, ctypes.c_int32]),
        "virtual_now_ns": (number, []),
        "virtual_rewire": (text, [text, text]),
        "virtual_place": (None, [real, real]),
        "virtual_look": (None, [ctypes.c_void_p]),
        **more,
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = [ctypes.c_void_p, *arguments]
    library.virtual_new.restype = ctypes.c_void_p
    library.virtual_new.argtypes = []
    return library
