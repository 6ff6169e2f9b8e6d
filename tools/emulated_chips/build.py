"""Builds the emulated chips, each with the firmware that is flashed."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

from rig.backends.emulated.errors import EmulationError
from rig.backends.serial.emulated.firmware_build import (
    AVR_PACKAGES,
    PICO_TOOLS,
    PLAIN_VARIANT,
    Variant,
    make,
    source_folder,
)


class ChipFirmware(NamedTuple):
    """What the build gives: the very .hex that is flashed, and the emulated chip."""

    hex: Path
    library: Path


class PicoFirmware(NamedTuple):
    """What the build gives: the very .uf2 that is flashed; node, its emulated chip, and the bench behind that."""

    uf2: Path
    node: str
    program: Path
    bench: Path


def build_chip(options: Variant = PLAIN_VARIANT) -> ChipFirmware:
    """Build the Uno's firmware and its emulated chip, as ``firmware_build.build`` does.

    Raises EmulationError also where avr-gcc is missing.
    """
    tools = {"avr-gcc": f"apt-get install {AVR_PACKAGES} libsimavr-dev"}
    folder = make(["chip", *options.variables()], tools)
    return ChipFirmware(folder / "uno" / f"{options.name}.hex", folder / "chip" / "librig_chip.so")


def build_pico_chip(options: Variant = PLAIN_VARIANT) -> PicoFirmware:
    """Build the Pico's firmware and what its emulated chip needs, as ``firmware_build.build`` does.

    Raises EmulationError also where arm-none-eabi-gcc, node or rp2040js is missing.
    """
    emulator = source_folder() / "emulator" / "pico"
    node = shutil.which("node")
    if node is None or not (emulator / "node_modules" / "rp2040js").is_dir():
        missing = "node" if node is None else "rp2040js"
        raise EmulationError(f"{missing} is missing, on which the emulated Pico runs: run `make setup`")
    folder = make(["pico-chip", *options.variables()], PICO_TOOLS) / "pico"
    return PicoFirmware(folder / f"{options.name_for('pico')}.uf2", node, emulator / "main.js", folder / "bench.node")
