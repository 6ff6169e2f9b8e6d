"""The emulated board in real time: a process behind a pseudo-terminal."""

from __future__ import annotations

from pathlib import Path

from rig.backends.emulated.bench import bench_parameters
from rig.backends.emulated.board_process import BoardProcess
from rig.backends.serial.emulated import firmware_build
from rig.backends.serial.emulated.device_options import device_options
from rig.config.schema import Emulated, Tachometer


class HostBoard(BoardProcess):
    """The firmware's core, compiled for this machine, with the bench behind it."""

    def __init__(self, build_folder: Path | None = None) -> None:
        super().__init__()
        self._build_folder = build_folder

    def start(
        self,
        emulated: Emulated,
        seed: int,
        link: Path | None = None,
        trace: Path | None = None,
        tachometer: Tachometer | None = None,
    ) -> str:
        """Build what is not up to date, start the process, and return the name of its port.

        emulated, tachometer  sections of the config
        seed   of the emulated noise
        link   symbolic link to the port, made for as long as the process lives
        trace  CSV file of the truth: ``t_s,drive_V,y_rad,v_rad_per_s,fault``, a row at each change of the drive
               at the pin and one every 10 ms; t_s in CLOCK_MONOTONIC
        Raises EmulationError if it cannot be built or does not start.
        """
        self._must_not_run()
        program = firmware_build.build(self._build_folder).program
        options = device_options(bench_parameters(emulated, tachometer), seed, emulated.clock_error_ppm)
        return self._launch(program, options, link, trace)
