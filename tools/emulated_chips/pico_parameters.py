"""What an emulated Pico is made of: its firmware and the bench behind it, as its emulator takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emulated_chips import build
from rig.backends.serial.emulated.device_options import device_options
from rig.backends.serial.emulated.firmware_build import PLAIN_VARIANT, Variant
from rig.model.bench import BenchParameters

if TYPE_CHECKING:
    from rig.core.strict_json import JsonObject

_BITS_PER_BYTE = 10


def pico_parameters(
    bench: BenchParameters,
    seed: int = 1,
    *,
    clock_error_ppm: float = 0.0,
    options: Variant = PLAIN_VARIANT,
    dead_time_s: float = 0.0,
    wires: int | None = None,
) -> JsonObject:
    """What a ``VirtualPico`` is made of; firmware and emulator are built.

    bench            what is behind the board; its ``drive_counts`` is the chip's own business
    seed             of the noise, 0 to 2**32 - 1
    clock_error_ppm  of the chip's clock against virtual time
    options          that the firmware is built with
    dead_time_s      for which the bridge does not conduct, once in a PWM period, 0 to 1e-3
    wires            of a loop-back on a bare board, whose bench is not there: as of ``VirtualChip``
    Raises EmulationError if firmware or emulator is missing or cannot be built.
    """
    firmware = build.build_pico_chip(options)
    of_bench = device_options(bench, seed, clock_error_ppm)
    del of_bench["drive-counts"]
    return {
        "command": [firmware.node, str(firmware.program)],
        "uf2": str(firmware.uf2),
        "addon": str(firmware.bench),
        "byte_ns": round(1e9 * _BITS_PER_BYTE / options.baud),
        "options": [list(option) for option in of_bench.items()],
        "bridge": options.bridge,
        "dead_time_s": dead_time_s,
        "clock_error_ppm": clock_error_ppm,
        "wires": wires,
    }
