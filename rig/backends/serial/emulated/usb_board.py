"""An emulated device in real time behind a USB adapter: two processes, and the adapter's port."""

from __future__ import annotations

import sys
from pathlib import Path

from rig.backends.emulated.board_process import BoardProcess
from rig.backends.links.usb_adapters import Adapter


class UsbBoard(BoardProcess):
    """The adapter of a device that runs already; its reset button is the device's.

    device   started, and stopped by whoever started it, after this
    adapter  of ``rig.backends.links.usb_adapters.CHIPS``
    """

    def __init__(self, device: BoardProcess, adapter: Adapter) -> None:
        super().__init__()
        self._device = device
        self._adapter = adapter

    def start(self, link: Path | None = None) -> str:
        """Start the process and return the name of its port.

        link  symbolic link to the port, made for as long as the process lives
        Raises EmulationError where it does not start.
        """
        self._must_not_run()
        options = {"device": self._device.port, "adapter": self._adapter}
        return self._launch(
            (sys.executable, "-P", "-m", "rig.backends.serial.emulated.usb_process"), options, link, None
        )

    def reset(self) -> None:
        """Press the device's reset button. Raises EmulationError when it does not run."""
        self._device.reset()
