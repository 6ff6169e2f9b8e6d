"""How an emulated chip opens: with the bench of a config behind it, in virtual or in real time; or bare."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from emulated_chips.chip_board import ChipBoard
from emulated_chips.pico_parameters import pico_parameters
from emulated_chips.virtual_chip import VirtualChip, uno, variant_of
from emulated_chips.virtual_pico import VirtualPico
from rig.backends.backend import emulated_of
from rig.backends.emulated.bench_of_config import bench_parameters
from rig.backends.links.usb_adapters import Adapter
from rig.backends.serial.emulated.firmware_build import Variant
from rig.backends.serial.emulated.serial_board import SerialBoard
from rig.backends.serial.ports import PICO_PORTS
from rig.config.schema import DeviceSetup
from rig.model.bench import BenchParameters
from rig.model.friction import coulomb
from rig.model.motor import Motor

if TYPE_CHECKING:
    from rig.core.strict_json import JsonObject


def emulated_chip(d: DeviceSetup) -> VirtualChip:
    """The Uno's emulated chip with the config's bench behind it: port and clock in one, in virtual time.

    Raises EmulationError where it cannot be built, ValueError without section ``emulated``.
    """
    return _uno(d)()


def _uno(d: DeviceSetup) -> partial[VirtualChip]:
    emulated = emulated_of(d)
    bench = bench_parameters(emulated, d.tachometer)
    return uno(bench, d.seed, emulated.clock_error_ppm, d.daq.baud, d.drive.bridge)


def emulated_pico(d: DeviceSetup) -> VirtualPico:
    """The Pico's emulated chip, as ``emulated_chip``."""
    return VirtualPico(parameters_of(d))


def parameters_of(d: DeviceSetup) -> JsonObject:
    """What the config's emulated Pico is made of."""
    emulated = emulated_of(d)
    bench = bench_parameters(emulated, d.tachometer)
    options = variant_of(bench, d.daq.baud, d.drive.bridge)
    return pico_parameters(bench, d.seed, clock_error_ppm=emulated.clock_error_ppm, options=options)


def virtual_chip(d: DeviceSetup) -> VirtualChip | VirtualPico:
    """The chip that daq.port names, in virtual time. Raises as ``emulated_chip``."""
    return emulated_pico(d) if d.daq.port in PICO_PORTS else emulated_chip(d)


@contextmanager
def chip_process(d: DeviceSetup, link: Path | None, trace: Path | None, adapter: Adapter) -> Iterator[SerialBoard]:
    """The Pico's chip where daq.port names it, else the Uno's, running in real time for the block.

    link, trace, adapter  as of ``SerialBoard``
    Raises as ``emulated_chip``.
    """
    with ChipBoard() as board:
        if d.daq.port in PICO_PORTS:
            board.run(partial(VirtualPico, parameters_of(d)), "emulated-pico", link, trace, adapter)
        else:
            board.start_uno(_uno(d), link, trace, adapter)
        yield board


def bare_chip(port: str, options: Variant, wires: int = 7) -> VirtualChip | VirtualPico:
    """A board without a bench. ``port``: emulated-chip or emulated-pico; ``wires`` as of ``VirtualChip``."""
    nobody = BenchParameters(Motor(0.1, 1.0, coulomb(1.0)), encoder=options.encoder)
    if port in PICO_PORTS:
        nobody = replace(nobody, counts_max=4095, centre_counts=2048)
        return VirtualPico(pico_parameters(nobody, options=options, wires=wires))
    return VirtualChip(nobody, options=options, wires=wires)
