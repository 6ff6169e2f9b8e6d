"""The Uno's emulated chip in virtual time: the very .hex that is flashed, on libsimavr."""

from __future__ import annotations

import ctypes
from functools import lru_cache, partial
from typing import Literal

from typing_extensions import override

from emulated_chips import build
from emulated_chips.truth import Contact, UnoTruth
from rig.backends.emulated.errors import EmulationError
from rig.backends.serial.emulated.device_options import device_options
from rig.backends.serial.emulated.firmware_build import PLAIN_VARIANT, Variant
from rig.backends.serial.emulated.virtual_device import VirtualDevice, load
from rig.model.bench import BenchParameters

_BITS_PER_BYTE = 10
_CONTACT_PIN = {"e_stop": 4, "end_low": 5, "end_high": 6}  # of port D: firmware/boards/uno/wiring.h
_HANG = {"main loop": 0, "everything": 1, "clock": 2, "converter": 3, "tick": 4}
_STALL = {"main loop": 1, "tick": 2}

Hang = Literal["main loop", "everything", "clock", "converter", "tick"]
Stall = Literal["main loop", "tick"]


def variant_of(bench: BenchParameters, baud: int, bridge: str | None) -> Variant:
    """What the firmware is built with for a bench; ``bridge`` as the config names it, None: the plain one."""
    inputs = PLAIN_VARIANT.bridge if bridge is None else bridge.upper().replace("-", "_")
    return Variant(
        inputs,
        baud,
        tachometer=bench.tachometer_rad_s_per_count is not None,
        end_switches=bench.end_rad is not None,
        encoder=bench.encoder,
    )


class VirtualChip(VirtualDevice[UnoTruth]):
    """One emulated Uno, powered on at virtual time 0. Any number may live side by side.

    bench            what is behind the board; its ``drive_counts`` is the chip's own business
    seed             of the noise, 0 to 2**32 - 1
    clock_error_ppm  of the chip's clock against virtual time
    options          that the firmware is built with
    dead_time_s      for which the bridge does not conduct, once in a PWM period, 0 to 1e-3
    wires            of a loop-back on a bare board, whose bench is not there (``rig doctor --loopback``): 1 of PWM or
                     IN1, 2 of direction or IN2, 4 of the e-stop. None: no bare board
    measure          count masked interrupts and time spent in them: 3 to 10 times as slow
    Raises EmulationError if firmware or emulator cannot be built, or a parameter is out of range.
    """

    step_s = 0.00025

    def __init__(
        self,
        bench: BenchParameters,
        seed: int = 1,
        *,
        clock_error_ppm: float = 0.0,
        options: Variant = PLAIN_VARIANT,
        dead_time_s: float = 0.0,
        measure: bool = False,
        wires: int | None = None,
    ) -> None:
        firmware = build.build_chip(options)
        wanted = device_options(bench, seed, clock_error_ppm)
        wanted |= {"hex": str(firmware.hex), "bridge": options.bridge.lower()}
        wanted |= {"dead-time-s": repr(dead_time_s), "measure": f"{measure:d}"}
        if wires is not None:
            wanted["bare"] = str(wires)
        super().__init__(UnoTruth, _load(str(firmware.library)), wanted, round(1e9 * _BITS_PER_BYTE / options.baud))

    @override
    def reset(self, cause: int, boot_s: float = 0.0) -> None:
        """Reset the chip: 1 power-on, 2 external, 4 brown-out; then stay in the boot loader, pins floating."""
        self._library.virtual_boot(self._board, cause, boot_s)

    def contact(self, which: Contact, is_open: bool) -> None:
        """Open or close a contact; all are closed at power on."""
        self._library.virtual_contact(self._board, _CONTACT_PIN[which], is_open)

    def hang(self, what: Hang = "main loop") -> None:
        """Stop the main loop, that and all interrupts, or one interrupt: the clock's, the converter's, the tick's.

        Raises EmulationError where the firmware has no endless loop to send it to.
        """
        if not self._library.virtual_hang(self._board, _HANG[what]):
            raise EmulationError("the firmware has no endless loop to hang it in")

    def stall(self, what: Stall, duration_s: float) -> None:
        """Let the main loop's next round, or the next tick, take so much longer, s; interrupts go on.

        Raises as ``hang``.
        """
        if not self._library.virtual_stall(self._board, _STALL[what], round(1e9 * duration_s)):
            raise EmulationError("the firmware has no endless loop to stall it in")

    def broken_rule(self) -> str:
        """The first rule of the data sheet for writing registers that the program has broken; "" for none so far."""
        return bytes(self._library.virtual_broken_rule(self._board)).decode()

    def longest_pulse_s(self) -> float:
        """Longest time for which the bridge has conducted without a break, edge by edge, since the last call, s."""
        return float(self._library.virtual_longest_pulse_s(self._board))


def uno(
    bench: BenchParameters, seed: int, clock_error_ppm: float, baud: int, bridge: str | None
) -> partial[VirtualChip]:
    """What makes the chip of a config; ``bridge`` as of ``variant_of``."""
    return partial(VirtualChip, bench, seed, clock_error_ppm=clock_error_ppm, options=variant_of(bench, baud, bridge))


@lru_cache
def _load(path: str) -> ctypes.CDLL:
    """The library with its signatures (firmware/emulator/chip.c)."""
    integer = ctypes.c_int32
    return load(
        path,
        {
            "virtual_boot": (None, [ctypes.c_uint8, ctypes.c_double]),
            "virtual_contact": (None, [integer, integer]),
            "virtual_hang": (integer, [integer]),
            "virtual_stall": (integer, [integer, ctypes.c_int64]),
            "virtual_broken_rule": (ctypes.c_char_p, []),
            "virtual_longest_pulse_s": (ctypes.c_double, []),
        },
    )
