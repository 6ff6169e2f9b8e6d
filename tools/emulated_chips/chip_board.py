"""The Uno's emulated chip in real time: a process behind a pseudo-terminal."""

from __future__ import annotations

from pathlib import Path

from emulated_chips import build
from emulated_chips.virtual_chip import chip_options, variant_of
from rig.backends.emulated.bench import bench_parameters
from rig.backends.emulated.board_process import BoardProcess
from rig.config.schema import Emulated, Tachometer


class ChipBoard(BoardProcess):
    """The very .hex that is flashed, on libsimavr, with the bench behind it. Opening the port does not reset it.

    The chip runs after real time in steps of 0.25 ms. It does not catch up on a stall of more than ten seconds.
    """

    def start(
        self,
        emulated: Emulated,
        seed: int,
        link: Path | None = None,
        trace: Path | None = None,
        tachometer: Tachometer | None = None,
        baud: int = 115200,
        bridge: str | None = None,
    ) -> str:
        """As of HostBoard; the trace has ``led`` (lit: armed) instead of the fault.

        baud    of the firmware and of the wire, 115200 or 1000000
        bridge  as drive.bridge of the config
        Raises EmulationError if it cannot be built or does not start.
        """
        self._must_not_run()
        bench = bench_parameters(emulated, tachometer)
        options = variant_of(bench, baud, bridge)
        firmware = build.build_chip(options)
        wanted = chip_options(firmware, bench, seed, emulated.clock_error_ppm, options)
        return self._launch(firmware.program, {**wanted, "baud": str(baud)}, link, trace)
