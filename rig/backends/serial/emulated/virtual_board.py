"""The emulated board in virtual time."""

from __future__ import annotations

import ctypes
from array import array
from dataclasses import dataclass
from functools import lru_cache

from typing_extensions import override

from rig.backends.emulated.plug import Until
from rig.backends.emulated.shaft import ShaftPath
from rig.backends.serial.emulated import firmware_build
from rig.backends.serial.emulated.device_options import device_options
from rig.backends.serial.emulated.virtual_device import Truth, VirtualDevice, load
from rig.model.bench import BenchParameters

_SHAFT_NS = 500_000  # between two points of its path


@dataclass(frozen=True)
class BoardTruth(Truth):
    """Of the host board.

    armed, latched, hung
    fault       code of the fault, 0 for none
    recovering  +1 armed above the hard limits, -1 below, 0 neither
    dropped     damaged frames that the device has dropped
    """

    armed: bool
    latched: bool
    fault: int
    recovering: int
    dropped: int
    hung: bool


class VirtualBoard(VirtualDevice[BoardTruth]):
    """One emulated board, powered on at virtual time 0. Any number may live side by side.

    bench            what is behind the board
    seed             of the noise, 0 to 2**32 - 1
    clock_error_ppm  of the device's clock against virtual time
    clock_start_us   reading of the device's clock at a reset, 0 to 2**32 - 1
    baud, bits_per_byte  of the wire, both ways; a real byte takes 10 to 11 bit times
    Raises EmulationError if the firmware cannot be built or a parameter is out of range.
    """

    def __init__(
        self,
        bench: BenchParameters,
        seed: int = 1,
        *,
        clock_error_ppm: float = 0.0,
        clock_start_us: int = 0,
        baud: int = 115200,
        bits_per_byte: int = 11,
    ) -> None:
        options = device_options(bench, seed, clock_error_ppm, clock_start_us)
        super().__init__(BoardTruth, _load(), options, round(1e9 * bits_per_byte / baud))
        self.keeps_shaft = False  # the path, for ``shaft``
        self._shaft_t_s, self._shaft_rad = array("d"), array("d")

    @override
    def _run(self, until_ns: int, until: Until) -> None:
        now_ns = self._now_ns() if self.keeps_shaft and until != Until.TIME else until_ns
        while (stop_ns := now_ns + _SHAFT_NS) < until_ns:
            super()._run(stop_ns, until)
            self._keep_shaft()
            now_ns = self._now_ns()
            if now_ns < stop_ns:
                return  # it has come
        super()._run(until_ns, until)
        if self.keeps_shaft:
            self._keep_shaft()

    def _keep_shaft(self) -> None:
        view = self._look()
        self._shaft_t_s.append(view.t_s)
        self._shaft_rad.append(view.y_rad)

    def shaft(self) -> ShaftPath:
        """Where the shaft really was while it was kept: after each wait of the host, each 0.5 ms of an exchange."""
        return ShaftPath(self._shaft_t_s, self._shaft_rad)

    @override
    def reset(self, cause: int) -> None:
        self._library.virtual_reset(self._board, cause)

    def hang(self) -> None:
        """Hang the firmware, drive as it is; the hardware watchdog resets the chip 0.12 s after its last tick."""
        self._library.virtual_hang(self._board)


@lru_cache
def _load() -> ctypes.CDLL:
    """The library, built once for this process, with its signatures (firmware/boards/host/virtual.c)."""
    return load(
        str(firmware_build.build()),
        {
            "virtual_reset": (None, [ctypes.c_uint8]),
            "virtual_hang": (None, []),
        },
    )
