"""The emulated board in real time: a process behind a pseudo-terminal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.backends.emulated.board_process import BoardProcess
from rig.backends.serial.emulated import firmware_build
from rig.backends.serial.emulated.device_options import options_from_mapping


class HostBoard(BoardProcess):
    """The firmware's core, compiled for this machine, with the bench behind it."""

    def __init__(self, build_folder: Path | None = None) -> None:
        super().__init__()
        self._build_folder = build_folder

    def start(
        self,
        emulated: Mapping[str, Any],
        seed: int,
        link: Path | None = None,
        trace: Path | None = None,
        tachometer: Mapping[str, Any] | None = None,
    ) -> str:
        """Build what is not up to date, start the process, and return the name of its port.

        emulated, tachometer  plain values of the config's sections
        seed   of the emulated noise
        link   symbolic link to the port, made for as long as the process lives
        trace  CSV file of the truth: ``t_s,drive_V,y_rad,v_rad_per_s,fault``, a row at each change of the drive
               at the pin and one every 10 ms; t_s in CLOCK_MONOTONIC
        Raises EmulationError if it cannot be built or does not start.
        """
        self._must_not_run()
        program = firmware_build.build(self._build_folder).program
        return self._launch(program, options_from_mapping(emulated, seed, tachometer), link, trace)
