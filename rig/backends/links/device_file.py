"""Whether a serial port is there at all, before anything slow is loaded or waited for."""

from __future__ import annotations

import sys
from pathlib import Path

from rig.core.faults import Fault

_DEVICES = Path("/dev")
_NAMES = ("serial/by-id/*", "ttyACM*", "ttyUSB*", "tty.usb*")


def require_device_file(port: str | None, devices: Path = _DEVICES) -> None:
    """Raise Fault LINK_OPEN where ``port`` is the path of a device file, and there is none, nor a link to one.

    devices  the folder that stands for /dev, where those that are there are looked for
    """
    if port is None or sys.platform == "win32" or not port.startswith("/") or Path(port).exists():
        return
    there = [str(path) for pattern in _NAMES for path in sorted(devices.glob(pattern))]
    others = f"there is {', '.join(there)}" if there else "no other serial port is plugged in"
    raise Fault("LINK_OPEN", f"{port}: no such device; {others}")
