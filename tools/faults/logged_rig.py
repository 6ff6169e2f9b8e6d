"""`rig`, with a log of every byte that its serial port hands to it: python -m faults.logged_rig LOG ARGUMENT..."""

from __future__ import annotations

import os
import sys
from unittest.mock import patch

import rig.bench
import rig.session
from rig.cli import main
from rig.daq.serial_port import SerialPort


def run(log: str, arguments: list[str]) -> None:
    """Run the command; what the host has received is in the file before the host looks at it."""
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)

    class Logged(SerialPort):
        def read(self, timeout_s: float) -> bytes:
            data = super().read(timeout_s)
            os.write(descriptor, data)
            return data

    no_report = patch.object(rig.session, "write_report", lambda *_: None)
    with patch.object(rig.bench, "SerialPort", Logged), no_report:
        main(arguments)


if __name__ == "__main__":
    run(sys.argv[1], sys.argv[2:])
