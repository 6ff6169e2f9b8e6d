"""An emulated serial device in real time: a process behind a pseudo-terminal."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rig.backends.emulated.bench_of_config import bench_parameters
from rig.backends.emulated.board_process import BoardProcess
from rig.backends.links.usb_adapters import Adapter
from rig.backends.serial.emulated import firmware_build
from rig.backends.serial.emulated.virtual_board import VirtualBoard
from rig.backends.serial.emulated.virtual_device import PortAndClock
from rig.config.schema import Emulated, Tachometer

_NO_WIRE_BAUD = 11 * 10**9  # a byte takes 1 ns: the host board has no wire but the pseudo-terminal


class SerialBoard(BoardProcess):
    """A device that there is in virtual time, whose time follows the clock. Opening the port does not reset it."""

    def run(
        self,
        make: Callable[[], PortAndClock],
        port: str,
        link: Path | None = None,
        trace: Path | None = None,
        adapter: Adapter = "none",
    ) -> str:
        """Start the process and return the name of its port.

        make   makes the device, in the process: a ``partial``
        port   word of daq.port for it
        link   symbolic link to the port, made for as long as the process lives
        trace  CSV file of the truth: ``t_s,drive_V,y_rad,v_rad_per_s,fault``, a row at each change of the drive
               at the pin and one every 10 ms; t_s in CLOCK_MONOTONIC; a chip has ``led`` (lit: armed)
        adapter  between the device and the port
        Raises EmulationError where it does not start.
        """
        from rig.backends.serial.emulated.serial_process import served  # not on Windows

        return self._launch(partial(served, pickle.dumps(make), port, adapter), link, trace)


class HostBoard(SerialBoard):
    """The firmware's core, compiled for this machine, with the bench behind it."""

    def start(
        self,
        emulated: Emulated,
        seed: int,
        link: Path | None = None,
        trace: Path | None = None,
        tachometer: Tachometer | None = None,
        adapter: Adapter = "none",
    ) -> str:
        """Build what is not up to date, start the process, and return the name of its port.

        emulated, tachometer  sections of the config
        seed  of the emulated noise
        The rest as of ``run``. Raises EmulationError if it cannot be built or does not start.
        """
        firmware_build.build()
        make = partial(
            VirtualBoard,
            bench_parameters(emulated, tachometer),
            seed,
            clock_error_ppm=emulated.clock_error_ppm,
            baud=_NO_WIRE_BAUD,
        )
        return self.run(make, "emulated", link, trace, adapter)
