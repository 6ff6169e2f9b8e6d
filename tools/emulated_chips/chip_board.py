"""The emulated chips in real time."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from emulated_chips import build
from emulated_chips.virtual_chip import VirtualChip, uno
from rig.backends.emulated.bench_of_config import bench_parameters
from rig.backends.links.usb_adapters import Adapter
from rig.backends.serial.emulated.serial_board import SerialBoard
from rig.config.schema import Emulated


class ChipBoard(SerialBoard):
    """The very file that is flashed, on the emulated chip, with the bench behind it."""

    def start(
        self, emulated: Emulated, seed: int, link: Path | None = None, trace: Path | None = None, baud: int = 115200
    ) -> str:
        """As of ``HostBoard``; ``baud`` of firmware and wire, 115200 or 1000000."""
        return self.start_uno(uno(bench_parameters(emulated), seed, emulated.clock_error_ppm, baud, None), link, trace)

    def start_uno(
        self, make: partial[VirtualChip], link: Path | None, trace: Path | None, adapter: Adapter = "none"
    ) -> str:
        """The chip that ``make`` makes; built here, since the process is not waited for so long."""
        build.build_chip(make.keywords["options"])
        return self.run(make, "emulated-chip", link, trace, adapter)
